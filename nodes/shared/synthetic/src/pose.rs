//! Where the object is, where the reference believes it to be, and the crop that follows from the latter.

use super::config::{JitterConfig, MAX_JITTER_DEG, Spread, SynthConfig};
use super::random::Draw;
use super::rest::draw_down;
use nalgebra::{Point2, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use pseudoflow_geometry::{Crop, Intrinsics, Jitter, Pose};
use pseudoflow_imaging::Object;
use rand::Rng;

/// The camera of a scene and where it sees the object.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stand {
    /// The camera of the whole image.
    pub(super) intrinsics: Intrinsics,
    /// Width and height of the whole image, pixels.
    pub(super) image_px: [u32; 2],
    /// Its resolution in parts of the configured camera's: 1, or less where the crop would be shrunk much.
    pub(super) scale: f64,
    /// Where the object is.
    pub(super) truth_camera_from_object: Pose,
    /// Away from the table, camera axes.
    pub(super) up: Vector3<f64>,
    /// Whether the object lies on a table as it would come to rest.
    pub(super) resting: bool,
}

/// The geometry of one pair.
#[derive(Debug, Clone)]
pub(super) struct Placement {
    /// The camera of the whole image.
    pub(super) intrinsics: Intrinsics,
    /// Where the object is.
    pub(super) truth_camera_from_object: Pose,
    /// Where the reference is rendered.
    pub(super) reference_camera_from_object: Pose,
    /// The crop at the reference pose.
    pub(super) crop: Crop,
}

impl Stand {
    /// Draws a camera and the object's true pose; `size_px` is the side of the network's input.
    pub(super) fn draw(rng: &mut impl Rng, object: &Object, config: &SynthConfig, size_px: u32) -> Self {
        let intrinsics = draw_camera(rng, config);
        let (elevation, roll) = (rng.uniform(8.0, 85.0).to_radians(), rng.uniform(-20.0, 20.0).to_radians());
        let upright = Vector3::new(0.0, -elevation.cos(), -elevation.sin());
        let up = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll) * upright;
        let resting = rng.chance(config.look.resting);
        let rotation = if resting { lying(rng, object, &up) } else { rng.rotation() };
        let truth = draw_truth(rng, object, &intrinsics, rotation, config);
        let (image_px, scale) = (config.image_px, 1.0);
        let stand = Self { intrinsics, image_px, scale, truth_camera_from_object: truth, up, resting };
        let Some(crop) = Crop::around(&object.hull_m, &truth, &intrinsics, 1.1, size_px) else { return stand };
        stand.scaled((config.most_oversampled * f64::from(size_px) / crop.side).clamp(0.1, 1.0))
    }

    /// The same view by a camera of fewer pixels, whose image is the same plane.
    fn scaled(self, factor: f64) -> Self {
        let image_px = self.image_px.map(|px| ((f64::from(px) * factor).ceil() as u32).max(64));
        let k = self.intrinsics;
        let centre = |c: f64| factor * (c + 0.5) - 0.5;
        let intrinsics = Intrinsics { fx: factor * k.fx, fy: factor * k.fy, cx: centre(k.cx), cy: centre(k.cy) };
        Self { intrinsics, image_px, scale: factor, ..self }
    }
}

/// References further from the truth than this (ADD), in diameters, are drawn again.
const FARTHEST_ADD: f64 = 1.0;

impl Placement {
    /// Draws reference and crop. Of the references, those further than one diameter (ADD) from the truth and those with
    /// a crop that makes no sense are drawn again; after 50 tries the truth itself is taken.
    pub(super) fn draw(
        rng: &mut impl Rng,
        object: &Object,
        stand: &Stand,
        jitter: &[JitterConfig],
        config: &SynthConfig,
        size_px: u32,
    ) -> Self {
        let Stand { intrinsics, truth_camera_from_object: truth, .. } = *stand;
        let margin = rng.uniform(config.crop_margin[0], config.crop_margin[1]);
        let kind = draw_kind(rng, jitter);
        for _ in 0..50 {
            let reference = kind.map_or(truth, |kind| draw_reference(rng, object, &truth, kind));
            let near = add_m(object, &truth, &reference) <= FARTHEST_ADD * object.diameter_m;
            let crop = Crop::around(&object.hull_m, &reference, &intrinsics, margin, size_px);
            if let (true, Some(crop)) = (near, crop.filter(|crop| is_sensible(crop, stand, config))) {
                return Self {
                    intrinsics,
                    truth_camera_from_object: truth,
                    reference_camera_from_object: reference,
                    crop,
                };
            }
        }
        let [width, height] = stand.image_px.map(f64::from);
        let whole = Crop { x0: -0.5, y0: -0.5, side: width.min(height), size_px };
        let crop = Crop::around(&object.hull_m, &truth, &intrinsics, margin, size_px).unwrap_or(whole);
        Self { intrinsics, truth_camera_from_object: truth, reference_camera_from_object: truth, crop }
    }

    /// The angle between truth and reference, degrees.
    #[cfg(test)]
    pub(super) fn angle_deg(&self) -> f64 {
        pseudoflow_geometry::rotation_angle_rad(&self.truth_camera_from_object, &self.reference_camera_from_object)
            .to_degrees()
    }
}

/// The centre of an object's bounding box, metres, object frame.
pub(super) fn centre_m(object: &Object) -> Point3<f64> {
    object.low_m + object.extents_m / 2.0
}

/// Mean distance between the same point at two poses, over the hull, metres.
fn add_m(object: &Object, a: &Pose, b: &Pose) -> f64 {
    let sum: f64 = object.hull_m.iter().map(|p| (a * p - b * p).norm()).sum();
    sum / object.hull_m.len().max(1) as f64
}

/// Not larger than what a rough pose can ask for, and with its centre in the image.
fn is_sensible(crop: &Crop, stand: &Stand, config: &SynthConfig) -> bool {
    let [width, height] = stand.image_px.map(f64::from);
    let (x, y) = (crop.x0 + crop.side / 2.0, crop.y0 + crop.side / 2.0);
    crop.side <= 3.0 * stand.scale * config.projected_px[1] && (0.0..width).contains(&x) && (0.0..height).contains(&y)
}

fn draw_camera(rng: &mut impl Rng, config: &SynthConfig) -> Intrinsics {
    let focal = rng.uniform(config.focal_px[0], config.focal_px[1]);
    let [width, height] = config.image_px.map(f64::from);
    Intrinsics {
        fx: focal,
        fy: focal * rng.uniform(0.995, 1.005),
        cx: (width - 1.0) / 2.0 + rng.uniform(-0.02, 0.02) * width,
        cy: (height - 1.0) / 2.0 + rng.uniform(-0.02, 0.02) * height,
    }
}

/// An orientation in which the object lies on a table whose normal is `up`.
fn lying(rng: &mut impl Rng, object: &Object, up: &Vector3<f64>) -> UnitQuaternion<f64> {
    let down = draw_down(rng, object);
    let half_turn = || UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let stand = UnitQuaternion::rotation_between(&-down, up).unwrap_or_else(half_turn);
    UnitQuaternion::from_scaled_axis(up * rng.uniform(0.0, std::f64::consts::TAU)) * stand
}

/// The distance by the projected diameter; the centre anywhere that keeps the object in the
/// image, or (`truncated`) anywhere in the image.
fn draw_truth(
    rng: &mut impl Rng,
    object: &Object,
    k: &Intrinsics,
    rotation: UnitQuaternion<f64>,
    config: &SynthConfig,
) -> Pose {
    let projected_px = rng.log_uniform(config.projected_px[0], config.projected_px[1]);
    let z_m = (k.fx * object.diameter_m / projected_px).max(object.diameter_m);
    let border = if rng.chance(config.truncated) { 0.0 } else { 0.5 };
    let [x, y] = config.image_px.map(|size| {
        let margin = (border * projected_px).min(0.49 * f64::from(size));
        rng.uniform(margin, f64::from(size) - margin)
    });
    let centre = k.unproject(&Point2::new(x, y), z_m);
    Pose::from_parts(Translation3::from(centre - rotation * centre_m(object)), rotation)
}

/// One kind of jitter, by weight.
fn draw_kind<'a>(rng: &mut impl Rng, jitter: &'a [JitterConfig]) -> Option<&'a JitterConfig> {
    let mut left = rng.uniform(0.0, jitter.iter().map(|j| j.weight).sum());
    let chosen = jitter.iter().find(|j| {
        left -= j.weight;
        left < 0.0
    });
    chosen.or(jitter.last())
}

/// The truth, turned and moved. Half of the draws turn about the centre, half about the object's own origin, as
/// noise on a pose's numbers does (scanned meshes may have their origin far from the centre); wide ones about the centre.
fn draw_reference(rng: &mut impl Rng, object: &Object, truth: &Pose, kind: &JitterConfig) -> Pose {
    let about = if kind.spread == Spread::Uniform || rng.chance(0.5) { centre_m(object) } else { Point3::origin() };
    let object_from_centre = Pose::from_parts(Translation3::from(about.coords), UnitQuaternion::identity());
    let camera_from_centre = truth * object_from_centre;
    let (xy_m, z_m) = (kind.xy_diameters * object.diameter_m, kind.z_diameters * object.diameter_m);
    let moved = match kind.spread {
        Spread::Normal => {
            let (angle_rad, max_angle_rad) = (kind.angle_deg.to_radians(), MAX_JITTER_DEG.to_radians());
            Jitter { angle_rad, max_angle_rad, xy_m, z_m }.sample(&camera_from_centre, rng)
        }
        Spread::Uniform => {
            let axis = Unit::new_normalize(rng.direction().map(f64::from));
            let turn = UnitQuaternion::from_axis_angle(&axis, rng.uniform(0.0, kind.angle_deg.to_radians()));
            let offset_m = Vector3::new(rng.uniform(-xy_m, xy_m), rng.uniform(-xy_m, xy_m), rng.uniform(-z_m, z_m));
            let place = Translation3::from(camera_from_centre.translation.vector + offset_m);
            Pose::from_parts(place, turn * camera_from_centre.rotation)
        }
    };
    moved * object_from_centre.inverse()
}
