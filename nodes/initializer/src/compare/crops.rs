//! An image around a detection, and how well the views of an object fit there.

use super::encoder::Encoder;
use super::turned_camera::{Photograph, TurnedCamera};
use super::views::{View, summit};
use crate::InitializerError;
use nalgebra::{UnitQuaternion, Vector2};
use rayon::prelude::*;

/// Side of a crop over the larger side of the object's projection.
pub(super) const MARGIN: f64 = 1.25;
/// Objects are larger than the network says, in the middle.
const LARGER: f64 = 1.08;
/// Of the several hundred views from all sides, those that are scored after a rough look.
const PROMISING: usize = 192;
/// Weight of the squared logarithms of the ratios of width and height.
const UNLIKE: f64 = 0.5;
/// Their largest sum that counts.
const MOST_UNLIKE: f64 = 0.5;

/// The image around a detection at several sizes.
pub(super) struct Crops {
    /// For objects that fill each crop but for the margin.
    cameras: Vec<TurnedCamera>,
    /// Features of each crop, one behind the other, and cells across each.
    features: Vec<f32>,
    across: usize,
}

/// A view and where in the crops it fits best.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scored {
    /// `turned_from_object`.
    pub(super) rotation: UnitQuaternion<f64>,
    pub(super) similarity: f32,
    /// At the object's projection.
    pub(super) camera: TurnedCamera,
}

impl Crops {
    /// Crops around a projection, for objects of these sizes beside its own.
    pub(super) fn look(
        encoder: &mut Encoder,
        photograph: &Photograph<'_>,
        at: &TurnedCamera,
        sizes: &[f64],
    ) -> Result<Self, InitializerError> {
        let cameras: Vec<TurnedCamera> = sizes.iter().map(|size| at.moved([0.0; 2], size * at.side)).collect();
        let rgb: Vec<u8> = cameras.iter().flat_map(|camera| camera.look(photograph, MARGIN, encoder.size_px)).collect();
        Ok(Self { cameras, features: encoder.encode(&rgb)?, across: encoder.across() })
    }

    /// All views, in their order; where width and height of a detection are given, theirs are held against them.
    pub(super) fn score<'v>(
        &self,
        views: impl IntoParallelIterator<Item = &'v View>,
        detected: Option<&Vector2<f64>>,
    ) -> Vec<Scored> {
        views.into_par_iter().map(|view| self.score_one(view, detected)).collect()
    }

    /// The [`PROMISING`] views that fit best at a rough look, to be scored.
    pub(super) fn promising<'v>(&self, views: &'v [View], detected: &Vector2<f64>) -> Vec<&'v View> {
        let rough = |view: &'v View| {
            let of_crop = |(features, camera): (&[f32], &TurnedCamera)| {
                view.rough_similarity(features) - unlike(view.shape * camera.side, detected)
            };
            (self.each().map(of_crop).fold(f32::NEG_INFINITY, f32::max), view)
        };
        let mut ranked: Vec<(f32, &View)> = views.par_iter().map(rough).collect();
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        ranked.into_iter().take(PROMISING).map(|(_, view)| view).collect()
    }

    /// Features and camera of each crop.
    fn each(&self) -> impl Iterator<Item = (&[f32], &TurnedCamera)> {
        self.features.chunks_exact(self.features.len() / self.cameras.len()).zip(&self.cameras)
    }

    fn score_one(&self, view: &View, detected: Option<&Vector2<f64>>) -> Scored {
        let of_crop = |(features, camera): (&[f32], &TurnedCamera)| {
            let (similarity, shift) = view.similarity(features);
            let cost = detected.map_or(0.0, |d| unlike(view.shape * camera.side, d));
            (similarity - cost, shift)
        };
        let tries: Vec<(f32, [f64; 2])> = self.each().map(of_crop).collect();
        let best = (0..tries.len()).max_by(|a, b| tries[*a].0.total_cmp(&tries[*b].0)).unwrap_or(0);
        // Between the sizes, where it is not the least or the largest.
        let inside = (1..tries.len() - 1).contains(&best);
        let away = if inside { summit([best - 1, best, best + 1].map(|i| tries[i].0)) } else { 0.0 };
        let larger = (self.cameras[2].side / self.cameras[1].side).powf(away);
        let (similarity, shift) = tries[best];
        Scored { rotation: view.rotation, similarity, camera: self.shifted(best, shift, larger) }
    }

    /// At a projection that is shifted by so many cells of a crop, and larger than it would be there.
    fn shifted(&self, crop: usize, shift: [f64; 2], larger: f64) -> TurnedCamera {
        let camera = &self.cameras[crop];
        let cell = MARGIN * camera.side / self.across as f64;
        camera.moved(shift.map(|cells| cells * cell), larger * camera.side)
    }
}

/// What a projection of another width or height than was detected costs, in units of the similarity. The features alone do
/// not tell the size of an object without texture: a smaller one fits anywhere inside.
fn unlike(size: Vector2<f64>, detected: &Vector2<f64>) -> f32 {
    let off = size.component_div(detected).map(|ratio| (ratio / LARGER).ln());
    (UNLIKE * off.norm_squared().min(MOST_UNLIKE)) as f32
}
