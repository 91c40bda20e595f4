//! Where the object is, where the reference believes it to be, and the crop that follows from the latter.

use super::config::{MAX_JITTER_DEG, SynthConfig};
use super::random::Draw;
use nalgebra::{Point2, Point3, Translation3, UnitQuaternion};
use pseudoflow_geometry::{Crop, Intrinsics, Jitter, Pose, rotation_angle_rad};
use pseudoflow_imaging::Object;
use rand::Rng;

/// The geometry of one sample.
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

impl Placement {
    /// Draws truth, reference and crop. Of the references, those further than `MAX_JITTER_DEG` or one diameter
    /// (ADD) from the truth are drawn again; after 50 tries the truth itself is taken.
    pub(super) fn draw(rng: &mut impl Rng, object: &Object, config: &SynthConfig, size_px: u32) -> Self {
        let intrinsics = draw_camera(rng, config);
        let truth = draw_truth(rng, object, &intrinsics, config);
        let margin = rng.uniform(config.crop_margin[0], config.crop_margin[1]);
        for _ in 0..50 {
            let reference = draw_reference(rng, object, &truth, config);
            let near = add_m(object, &truth, &reference) <= object.diameter_m
                && rotation_angle_rad(&truth, &reference) <= MAX_JITTER_DEG.to_radians();
            let crop = Crop::around(&object.hull_m, &reference, &intrinsics, margin, size_px);
            if let (true, Some(crop)) = (near, crop.filter(|crop| is_sensible(crop, config))) {
                return Self {
                    intrinsics,
                    truth_camera_from_object: truth,
                    reference_camera_from_object: reference,
                    crop,
                };
            }
        }
        let [width, height] = config.image_px.map(f64::from);
        let whole = Crop { x0: -0.5, y0: -0.5, side: width.min(height), size_px };
        let crop = Crop::around(&object.hull_m, &truth, &intrinsics, margin, size_px).unwrap_or(whole);
        Self { intrinsics, truth_camera_from_object: truth, reference_camera_from_object: truth, crop }
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
fn is_sensible(crop: &Crop, config: &SynthConfig) -> bool {
    let [width, height] = config.image_px.map(f64::from);
    let (x, y) = (crop.x0 + crop.side / 2.0, crop.y0 + crop.side / 2.0);
    crop.side <= 3.0 * config.projected_px[1] && (0.0..width).contains(&x) && (0.0..height).contains(&y)
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

/// Any orientation; the distance by the projected diameter; the centre anywhere that keeps the object in the
/// image, or (`truncated`) anywhere in the image.
fn draw_truth(rng: &mut impl Rng, object: &Object, k: &Intrinsics, config: &SynthConfig) -> Pose {
    let rotation = rng.rotation();
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

/// The truth, turned and moved. Half of the draws turn about the centre, half about the object's own origin, as
/// noise on a pose's numbers does (scanned meshes may have their origin far from the centre).
fn draw_reference(rng: &mut impl Rng, object: &Object, truth: &Pose, config: &SynthConfig) -> Pose {
    let total: f64 = config.jitter.iter().map(|j| j.weight).sum();
    let mut left = rng.uniform(0.0, total);
    let chosen = config.jitter.iter().find(|j| {
        left -= j.weight;
        left < 0.0
    });
    let Some(kind) = chosen.or(config.jitter.last()) else { return *truth };
    let jitter = Jitter {
        angle_rad: kind.angle_deg.to_radians(),
        max_angle_rad: MAX_JITTER_DEG.to_radians(),
        xy_m: kind.xy_diameters * object.diameter_m,
        z_m: kind.z_diameters * object.diameter_m,
    };
    let about = if rng.chance(0.5) { centre_m(object) } else { Point3::origin() };
    let object_from_centre = Pose::from_parts(Translation3::from(about.coords), UnitQuaternion::identity());
    jitter.sample(&(truth * object_from_centre), rng) * object_from_centre.inverse()
}
