//! The true flow of a synthetic sample.

use super::pose::Placement;
use super::window::Window;
use nalgebra::Point2;
use pseudoflow_imaging::raster::Rendering;

/// True flow of a synthetic pair. It is a type of its own: labels of real images are estimates, and ground truth of
/// real images never reaches training.
#[derive(Debug, Clone, PartialEq)]
pub struct SyntheticFlow {
    /// Side S of the crop, pixels.
    pub size_px: u32,
    /// `flow_ref_to_real`: `S x S` pairs (dx, dy), pixels of the crop, row-major; zero outside the reference's mask.
    pub flow_px: Vec<[f32; 2]>,
    /// `S x S`: whether the pixel shows the object in the reference and so has a flow.
    pub foreground: Vec<bool>,
    /// `S x S`: whether the pixel's surface point is visible in the real-like image; the loss is taken there.
    pub visible: Vec<bool>,
}

/// Two depths of the same surface differ by less than this, in diameters (a slanted surface within a sub-pixel).
const SAME_SURFACE: f64 = 0.02;

impl SyntheticFlow {
    /// Each foreground pixel of the reference is unprojected, moved by the relative pose and projected with K'. It is
    /// visible when it falls into the crop and the image, and the four sub-pixels around it show the object
    /// at its depth (so it is neither behind something else nor behind the object itself).
    pub(super) fn of(
        reference: &Rendering,
        picture: &Rendering,
        placement: &Placement,
        window: &Window,
        diameter_m: f64,
    ) -> Self {
        let crop = &placement.crop;
        let size = crop.size_px as usize;
        let k = crop.intrinsics(&placement.intrinsics);
        let real_from_reference = placement.truth_camera_from_object * placement.reference_camera_from_object.inverse();
        let mut flow_px = vec![[0.0_f32; 2]; size * size];
        let mut visible = vec![false; size * size];
        let mut foreground = vec![false; size * size];
        for index in (0..size * size).filter(|&i| reference.mask[i] != 0) {
            let from = Point2::new((index % size) as f64, (index / size) as f64);
            let point = real_from_reference * k.unproject(&from, f64::from(reference.depth_m[index]));
            let Some(to) = k.project(&point) else { continue };
            flow_px[index] = [(to.x - from.x) as f32, (to.y - from.y) as f32];
            foreground[index] = true;
            let inside = |v: f64| (0.0..=(size - 1) as f64).contains(&v);
            visible[index] = inside(to.x)
                && inside(to.y)
                && is_seen(
                    picture,
                    &window.rendered_from_image(&crop.image_from_crop(&to)),
                    point.z,
                    SAME_SURFACE * diameter_m,
                );
        }
        Self { size_px: crop.size_px, flow_px, foreground, visible }
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

/// Whether a point at a sub-pixel is the object's surface there: its depth lies between those of the object's
/// sub-pixels around it, or near them (a slanted face changes its depth from one to the next).
fn is_seen(picture: &Rendering, at: &Point2<f64>, depth_m: f64, tolerance_m: f64) -> bool {
    let (width, height) = (f64::from(picture.width()), f64::from(picture.height()));
    let corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].map(|(i, j)| (at.x.floor() + i, at.y.floor() + j));
    let depths = corners.iter().filter_map(|&(x, y)| {
        let inside = (0.0..width).contains(&x) && (0.0..height).contains(&y);
        let index = if inside { (y * width + x) as usize } else { return None };
        (picture.mask[index] == 1).then(|| f64::from(picture.depth_m[index]))
    });
    let (near, far) = depths.fold((f64::MAX, f64::MIN), |(near, far), d| (near.min(d), far.max(d)));
    (near - tolerance_m..=far + tolerance_m).contains(&depth_m)
}
