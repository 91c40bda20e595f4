//! The views of an object: directions spread evenly over the sphere, each turned about the line of sight.

use super::CompareConfig;
use super::crops::MARGIN;
use super::encoder::{CELL_PX, Encoder};
use crate::InitializerError;
use crate::detect::Rectangle;
use nalgebra::{Point2, Translation3, UnitQuaternion, Vector2, Vector3};
use pseudoflow_geometry::{Intrinsics, Pose};
use pseudoflow_imaging::Object;
use pseudoflow_imaging::raster::{Rasteriser, Rendering, View as Rendered};

/// An object seen from one side.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct View {
    /// `turned_from_object`: the object is on the optical axis.
    pub(super) rotation: UnitQuaternion<f64>,
    /// Width and height of the projection, over the larger of them.
    pub(super) shape: Vector2<f64>,
    /// Cells across.
    pub(super) across: i32,
    /// Cells that show the object, and their features one behind the other.
    pub(super) cells: Vec<[i32; 2]>,
    pub(super) features: Vec<f32>,
}

/// Cells with less of the object say nothing, share of their pixels.
const LEAST_COVER: f64 = 0.6;
/// Views are encoded so many at a time.
pub(super) const BATCH: usize = 32;
/// Distance of the camera where it is not known, diameters: objects on a table.
const DISTANCE: f64 = 4.0;
/// Distances that are believed, diameters.
const DISTANCES: (f64, f64) = (1.0, 50.0);

impl View {
    /// As it is read from disk: see [`super::cache::round`].
    pub(super) fn round(&mut self) {
        let channels = self.features.len() / self.cells.len().max(1);
        self.features.chunks_exact_mut(channels.max(1)).for_each(super::cache::round);
    }
}

/// Where the parabola through three values at -1, 0 and 1 is highest; the middle one is the highest of them.
pub(super) fn summit([left, middle, right]: [f32; 3]) -> f64 {
    let bend = left - 2.0 * middle + right;
    if bend < 0.0 { f64::from((left - right) / (2.0 * bend)).clamp(-0.5, 0.5) } else { 0.0 }
}

/// Renders and encodes an object, turned in these ways, from where its projection has this larger side at unit distance: near
/// things show other surfaces. Where it is not known, from [`DISTANCE`].
pub(super) fn views(
    object: &Object,
    rotations: &[UnitQuaternion<f64>],
    side: Option<f64>,
    rasteriser: &dyn Rasteriser,
    encoder: &mut Encoder,
) -> Result<Vec<View>, InitializerError> {
    let failed = |e: pseudoflow_imaging::raster::RasterError| InitializerError::Render(e.to_string());
    let (size_px, across, channels) = (encoder.size_px, encoder.across(), encoder.channels);
    let mut views = Vec::with_capacity(rotations.len());
    for batch in rotations.chunks(BATCH) {
        let (asked, shapes): (Vec<Rendered>, Vec<_>) =
            batch.iter().map(|rotation| seen(object, rotation, side, size_px)).unzip();
        let renderings = rasteriser.render(&asked).map_err(failed)?;
        let renderings: Vec<(Rendering, f64)> =
            renderings.into_iter().zip(asked.iter().map(|view| view.intrinsics.fx)).collect();
        let features = encoder.encode_renderings(&renderings)?;
        let per_view = across * across * channels;
        let each = batch.iter().zip(shapes).zip(&renderings).zip(features.chunks_exact(per_view));
        for (((rotation, shape), (rendering, _)), features) in each {
            let cells = covered(&rendering.mask, across);
            let of_cell = |[x, y]: &[i32; 2]| &features[(*y as usize * across + *x as usize) * channels..][..channels];
            let features = cells.iter().flat_map(of_cell).copied().collect();
            views.push(View { rotation: *rotation, shape, across: across as i32, cells, features });
        }
    }
    Ok(views)
}

/// The object on the optical axis, its projection filling the crop but for the margin, and width and height of the projection
/// over the larger of them.
fn seen(object: &Object, rotation: &UnitQuaternion<f64>, side: Option<f64>, size_px: u32) -> (Rendered, Vector2<f64>) {
    let (mut pose, mut at) = from_distance(object, rotation, DISTANCE);
    if let Some(side) = side {
        let distance = DISTANCE * at.side_px() / side;
        (pose, at) = from_distance(object, rotation, distance.clamp(DISTANCES.0, DISTANCES.1));
    }
    let focal = f64::from(size_px) / MARGIN / at.side_px();
    let half = (f64::from(size_px) - 1.0) / 2.0;
    let [cx, cy] = [half - focal * at.middle_px.x, half - focal * at.middle_px.y];
    let intrinsics = Intrinsics { fx: focal, fy: focal, cx, cy };
    let rendered =
        Rendered { object_id: object.id, camera_from_object: pose, intrinsics, width: size_px, height: size_px };
    (rendered, at.size_px / at.side_px())
}

/// The pose of an object so many diameters away, and its projection at unit distance.
fn from_distance(object: &Object, rotation: &UnitQuaternion<f64>, distance: f64) -> (Pose, Rectangle) {
    let pose = centred(object, rotation, Vector3::new(0.0, 0.0, distance * object.diameter_m));
    let nowhere = || Rectangle { middle_px: Point2::origin(), size_px: Vector2::repeat(0.3) };
    (pose, crate::detect::extent(object, &pose, &UNIT).unwrap_or_else(nowhere))
}

/// The pose of an object so turned, the middle of its box at a place before the camera, metres.
pub(super) fn centred(object: &Object, rotation: &UnitQuaternion<f64>, middle_m: Vector3<f64>) -> Pose {
    Pose::from_parts(Translation3::from(middle_m - (rotation * object.box_centre_m()).coords), *rotation)
}

/// A camera whose pixels are lengths at unit distance.
pub(super) const UNIT: Intrinsics = Intrinsics { fx: 1.0, fy: 1.0, cx: 0.0, cy: 0.0 };

/// Cells that are mostly of the object.
fn covered(mask: &[u8], across: usize) -> Vec<[i32; 2]> {
    let size = across * CELL_PX;
    let cover = |x: usize, y: usize| {
        let inside = (0..CELL_PX * CELL_PX)
            .filter(|i| mask[(CELL_PX * y + i / CELL_PX) * size + CELL_PX * x + i % CELL_PX] != 0)
            .count();
        inside as f64 / (CELL_PX * CELL_PX) as f64
    };
    let all = (0..across).flat_map(|y| (0..across).map(move |x| (x, y)));
    all.filter(|&(x, y)| cover(x, y) >= LEAST_COVER).map(|(x, y)| [x as i32, y as i32]).collect()
}

/// Directions on a Fibonacci spiral, each with all turns; of those that look the same, one.
pub(super) fn rotations(object: &Object, config: &CompareConfig) -> Vec<UnitQuaternion<f64>> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let n = f64::from(config.directions);
    let mut rotations = Vec::new();
    for i in 0..config.directions {
        let z = 1.0 - (2.0 * f64::from(i) + 1.0) / n;
        let (sin, cos) = (golden * f64::from(i)).sin_cos();
        let radius = (1.0 - z * z).sqrt();
        let towards_camera = Vector3::new(radius * cos, radius * sin, z);
        let half_turn = || UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let facing = UnitQuaternion::rotation_between(&towards_camera, &-Vector3::z()).unwrap_or_else(half_turn);
        for turn in 0..config.turns {
            let angle = std::f64::consts::TAU * f64::from(turn) / f64::from(config.turns);
            let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle) * facing;
            let pose = Pose::from_parts(Translation3::new(0.0, 0.0, DISTANCE * object.diameter_m), rotation);
            let canonical = object.symmetries.canonical(&pose);
            // Equal views have one canonical pose; the others would only be compared twice.
            if (canonical.rotation.inverse() * rotation).angle() < 1e-6 {
                rotations.push(rotation);
            }
        }
    }
    rotations
}

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_imaging::ObjectSet;
    use std::path::Path;

    #[test]
    fn views_cover_all_rotations_and_symmetric_objects_need_half_of_them() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/objects/tabletop");
        let objects = ObjectSet::load(&folder).unwrap();
        let config = CompareConfig::new("".into());
        let all = rotations(objects.get(1).unwrap(), &config);
        assert_eq!(all.len(), 64 * 12);
        let mut worst: f64 = 0.0;
        for i in 0..50 {
            let any = UnitQuaternion::from_euler_angles(0.7 * f64::from(i), 1.3 * f64::from(i), 2.1 * f64::from(i));
            worst = worst.max(all.iter().map(|r| r.angle_to(&any)).fold(f64::MAX, f64::min));
        }
        assert!(worst.to_degrees() < 30.0, "{} deg", worst.to_degrees());
        let brick = rotations(objects.get(7).unwrap(), &config).len();
        assert!((64 * 12 * 4 / 10..64 * 12 * 6 / 10).contains(&brick), "{brick}");
    }
}
