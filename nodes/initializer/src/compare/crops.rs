//! An image around a detection, and how well the views of an object fit there.

use super::encoder::Encoder;
use super::views::{View, summit};
use crate::InitializerError;
use crate::detect::Rectangle;
use nalgebra::{Point2, UnitQuaternion, Vector2};
use pseudoflow_geometry::Crop;
use pseudoflow_imaging::{RgbImage, resample};
use rayon::prelude::*;

/// Side of a crop over the larger side of the object's projection.
pub(super) const MARGIN: f64 = 1.25;
/// Objects are larger than the network says, in the middle.
const LARGER: f64 = 1.08;
/// Weight of the squared logarithms of the ratios of width and height.
const UNLIKE: f64 = 0.5;
/// Their largest sum that counts.
const MOST_UNLIKE: f64 = 0.5;

/// The image around a detection at several sizes.
pub(super) struct Crops {
    crops: Vec<Crop>,
    /// Features of each crop, one behind the other, and cells across each.
    features: Vec<f32>,
    across: usize,
}

/// A view and where in the crops it fits best.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scored {
    pub(super) rotation: UnitQuaternion<f64>,
    pub(super) similarity: f32,
    /// Middle and larger side of the object's projection, pixels of the image.
    pub(super) place: (Point2<f64>, f64),
}

impl Crops {
    /// Crops around a place (middle and larger side of a projection, pixels of the image), for objects of these sizes.
    pub(super) fn look(
        encoder: &mut Encoder,
        image: &RgbImage,
        (at, side_px): (Point2<f64>, f64),
        sizes: &[f64],
    ) -> Result<Self, InitializerError> {
        let crop = |size: &f64| {
            let side = MARGIN * size * side_px;
            Crop { x0: at.x - side / 2.0, y0: at.y - side / 2.0, side, size_px: encoder.size_px }
        };
        let crops: Vec<Crop> = sizes.iter().map(crop).collect();
        let rgb: Vec<u8> = crops.iter().flat_map(|crop| resample(image, crop).into_raw()).collect();
        Ok(Self { crops, features: encoder.encode(&rgb)?, across: encoder.across() })
    }

    /// All views, in their order; where a detection is given, its rectangle is held against theirs.
    pub(super) fn score(&self, views: &[View], detected: Option<&Rectangle>) -> Vec<Scored> {
        views.par_iter().map(|view| self.score_one(view, detected)).collect()
    }

    fn score_one(&self, view: &View, detected: Option<&Rectangle>) -> Scored {
        let per_crop = self.features.len() / self.crops.len();
        let of_crop = |(features, crop): (&[f32], &Crop)| {
            let (similarity, shift) = view.similarity(features);
            let cost = detected.map_or(0.0, |d| unlike(view.shape * (crop.side / MARGIN), d));
            (similarity - cost, shift)
        };
        let tries: Vec<(f32, [f64; 2])> = self.features.chunks_exact(per_crop).zip(&self.crops).map(of_crop).collect();
        let best = (0..tries.len()).max_by(|a, b| tries[*a].0.total_cmp(&tries[*b].0)).unwrap_or(0);
        // Between the sizes, where it is not the least or the largest.
        let inside = (1..tries.len() - 1).contains(&best);
        let away = if inside { summit([best - 1, best, best + 1].map(|i| tries[i].0)) } else { 0.0 };
        let larger = (self.crops[2].side / self.crops[1].side).powf(away);
        let (similarity, shift) = tries[best];
        Scored { rotation: view.rotation, similarity, place: self.place(best, shift, larger) }
    }

    /// Middle and larger side of a projection that is shifted by so many cells of a crop, and larger than it would be there.
    fn place(&self, crop: usize, shift: [f64; 2], larger: f64) -> (Point2<f64>, f64) {
        let crop = &self.crops[crop];
        let cell_px = crop.side / self.across as f64;
        let along = |k: usize| [crop.x0, crop.y0][k] + crop.side / 2.0 + shift[k] * cell_px;
        (Point2::new(along(0), along(1)), larger * crop.side / MARGIN)
    }
}

/// What a projection of another width or height than was detected costs, in units of the similarity. The features alone do
/// not tell the size of an object without texture: a smaller one fits anywhere inside.
fn unlike(size_px: Vector2<f64>, detected: &Rectangle) -> f32 {
    let off = size_px.component_div(&detected.size_px).map(|ratio| (ratio / LARGER).ln());
    (UNLIKE * off.norm_squared().min(MOST_UNLIKE)) as f32
}
