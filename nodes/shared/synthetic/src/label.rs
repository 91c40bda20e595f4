//! The true flow of a synthetic sample.

use super::picture::Samples;
use super::pose::Placement;
use super::window::Window;
use nalgebra::Point2;

/// True flow of a synthetic pair, and what the rendering of the reference knows. It is a type of its own: labels of real
/// images are estimates, and ground truth of real images never reaches training.
///
/// All planes are `S x S`, row-major, on the pixels of the *reference*.
#[derive(Debug, Clone, PartialEq)]
pub struct SyntheticFlow {
    /// Side S of the crop, pixels.
    pub size_px: u32,
    /// `flow_ref_to_real`: (dx, dy), pixels of the crop, on every foreground pixel, hidden ones too; zero elsewhere.
    pub flow_px: Vec<[f32; 2]>,
    /// Whether the pixel shows the object in the reference and so has a flow.
    pub foreground: Vec<bool>,
    /// Whether the pixel's surface point is seen in the real-like crop: in front of the camera, inside the crop and the
    /// image, hidden neither by something else nor by the object itself. The loss is taken there.
    pub visible: Vec<bool>,
    /// Depth of the reference along the optical axis, metres; 0 in the background.
    pub depth_m: Vec<f32>,
    /// Unit normals of the reference, camera axes, turned to the camera; zero in the background. They are those of
    /// [`pseudoflow_imaging::raster::normals_from_depth`].
    pub normals: Vec<[f32; 3]>,
}

/// Two depths of the same surface differ by less than this, in diameters (a slanted surface within a sub-pixel).
const SAME_SURFACE: f64 = 0.02;

/// What the reference's rendering knows of its surface.
pub(super) struct Geometry {
    pub(super) depth_m: Vec<f32>,
    pub(super) normals: Vec<[f32; 3]>,
}

impl SyntheticFlow {
    /// Each foreground pixel of the reference is unprojected, moved by the relative pose and projected with K'. It is
    /// visible when it falls into the crop and the image, and the four samples around it show the object
    /// at its depth (so it is neither behind something else nor behind the object itself).
    pub(super) fn of(
        reference: Geometry,
        seen: &Samples,
        placement: &Placement,
        window: &Window,
        diameter_m: f64,
    ) -> Self {
        let crop = &placement.crop;
        let size = crop.size_px as usize;
        let k = crop.intrinsics(&placement.intrinsics);
        let real_from_reference =
            (placement.truth_camera_from_object * placement.reference_camera_from_object.inverse()).to_homogeneous();
        let mut flow_px = vec![[0.0_f32; 2]; size * size];
        let mut visible = vec![false; size * size];
        let mut foreground = vec![false; size * size];
        // From a pixel of the crop to a sample of the window: an affine map of one scale.
        let at = |x: f64| window.sample_from_image(&crop.image_from_crop(&Point2::new(x, x)));
        let (origin, scale) = (at(0.0), at(1.0).x - at(0.0).x);
        let inside = 0.0..=(size - 1) as f64;
        for index in (0..size * size).filter(|&i| reference.depth_m[i] > 0.0) {
            let from = Point2::new((index % size) as f64, (index / size) as f64);
            let point = k.unproject(&from, f64::from(reference.depth_m[index]));
            let m = &real_from_reference;
            let [x, y, z] =
                [0, 1, 2].map(|i| m[(i, 0)] * point.x + m[(i, 1)] * point.y + m[(i, 2)] * point.z + m[(i, 3)]);
            if z <= 0.0 {
                continue;
            }
            let (u, v) = (k.fx * x / z + k.cx, k.fy * y / z + k.cy);
            flow_px[index] = [(u - from.x) as f32, (v - from.y) as f32];
            foreground[index] = true;
            visible[index] = inside.contains(&u)
                && inside.contains(&v)
                && is_seen(seen, [origin.x + scale * u, origin.y + scale * v], z, SAME_SURFACE * diameter_m);
        }
        let Geometry { depth_m, normals } = reference;
        Self { size_px: crop.size_px, flow_px, foreground, visible, depth_m, normals }
    }

    /// How many pixels of the reference show the object.
    #[must_use]
    pub fn foreground_px(&self) -> usize {
        self.foreground.iter().filter(|v| **v).count()
    }

    /// How many pixels are visible.
    #[must_use]
    pub fn visible_px(&self) -> usize {
        self.visible.iter().filter(|v| **v).count()
    }
}

/// Whether a point at a place among the samples is the object's surface there: its depth lies between those of the object's
/// samples around it, or near them (a slanted face changes its depth from one to the next).
fn is_seen(seen: &Samples, [x, y]: [f64; 2], depth_m: f64, tolerance_m: f64) -> bool {
    if x < -1.0 || y < -1.0 {
        return false;
    }
    // Whole numbers at or below, shifted by one.
    let (x, y) = ((x + 1.0) as usize, (y + 1.0) as usize);
    let (mut near, mut far) = (f32::MAX, 0.0_f32);
    for (i, j) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let (Some(column), Some(row)) = ((x + i).checked_sub(1), (y + j).checked_sub(1)) else { continue };
        if column < seen.width && row < seen.height {
            let sample = row * seen.width + column;
            if seen.owner[sample] == 1 {
                let inverse = seen.inverse_depth[sample];
                (near, far) = (near.min(inverse), far.max(inverse));
            }
        }
    }
    // 1 / far and 1 / near: the object's samples run from the one depth to the other.
    far > 0.0 && (1.0 / f64::from(far) - tolerance_m..=1.0 / f64::from(near) + tolerance_m).contains(&depth_m)
}
