//! From a mesh and a pose to what a camera would see: colour, metric depth and mask.
//!
//! [`Rasteriser`] is the interface that the software rasteriser here and the GPU rasteriser of
//! `pseudoflow-renderer` share. Both sample pixel (x, y) exactly at (x, y) in K' coordinates, draw triangles from
//! both sides (those seen from behind on closed meshes are hidden anyway and are skipped), clip at [`NEAR_M`] and
//! shade with [`Headlight`] on [`crate::BACKGROUND_GREY`] (docs/method.md, step 3). Colours are computed in
//! sRGB-encoded values.

mod coverage;
mod hit;
mod normals;
mod openness;
mod software;
mod surface;

#[cfg(test)]
mod tests;

pub use coverage::Scratch;
pub use hit::PLAIN_ALBEDO;
pub use normals::normals_from_depth;
pub use openness::openness;
pub use software::{Background, Item, MAX_ITEMS, Scene, SoftwareRasteriser, render_scene};
pub use surface::{Headlight, Shader, Surface};

use crate::{DepthImage, Mesh, RgbImage};
use pseudoflow_geometry::{Intrinsics, Pose};
use std::sync::Arc;

/// What lies nearer to the camera plane than this is not drawn, metres.
pub const NEAR_M: f64 = 0.01;

/// Widest and highest rendering, pixels.
pub const MAX_SIZE_PX: u32 = 8192;

/// One rendering to make.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Which object ([`Rasteriser::add_object`]).
    pub object_id: u32,
    /// Its pose, metres.
    pub camera_from_object: Pose,
    /// The camera: K' for a crop, K for the whole image.
    pub intrinsics: Intrinsics,
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// What was rendered; all planes row-major, `height x width`.
#[derive(Debug, Clone, PartialEq)]
pub struct Rendering {
    /// Colour, sRGB.
    pub rgb: RgbImage,
    /// Depth along the optical axis, metres; 0 where nothing is.
    pub depth_m: Vec<f32>,
    /// 0 where nothing is, else n for the n-th item of the scene, counted from 1. With one object: 0 or 1.
    pub mask: Vec<u8>,
}

impl Rendering {
    /// An empty rendering, to be drawn into.
    #[must_use]
    pub fn new(width: u32, height: u32) -> Self {
        let pixels = width as usize * height as usize;
        Self { rgb: RgbImage::new(width, height), depth_m: vec![0.0; pixels], mask: vec![0; pixels] }
    }

    /// Pixels in a row.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.rgb.width()
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.rgb.height()
    }

    /// How many pixels show an object.
    #[must_use]
    pub fn foreground_px(&self) -> usize {
        self.mask.iter().filter(|m| **m != 0).count()
    }

    /// A copy of the depth as an image.
    #[must_use]
    pub fn depth_image(&self) -> DepthImage {
        DepthImage { width: self.width(), height: self.height(), data_m: self.depth_m.clone() }
    }
}

/// Renders objects that it was given before.
pub trait Rasteriser: Send + Sync {
    /// The backend and device, for the log and the health topic.
    fn name(&self) -> String;

    /// Makes an object known (on the GPU: uploads it). An object of the same id is replaced.
    ///
    /// # Errors
    /// When the device has no memory for it.
    fn add_object(&mut self, object_id: u32, mesh: &Arc<Mesh>) -> Result<(), RasterError>;

    /// Renders all views, in order. The same views give the same bytes.
    ///
    /// # Errors
    /// An unknown object, a size of zero or over [`MAX_SIZE_PX`], a pose or camera that is not finite, a lost device.
    fn render(&self, views: &[View]) -> Result<Vec<Rendering>, RasterError>;
}

/// Why nothing was rendered.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RasterError {
    /// [`Rasteriser::add_object`] was not called for this id.
    #[error("object {object_id} is not loaded; the rasteriser knows {known:?}: check the object set")]
    UnknownObject {
        /// The id asked for.
        object_id: u32,
        /// The ids there are.
        known: Vec<u32>,
    },
    /// A rendering without pixels, or too large.
    #[error("cannot render {width} x {height} pixels; each side must be 1 to {MAX_SIZE_PX}")]
    Size {
        /// Pixels in a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// A NaN or an infinity in a pose or a camera.
    #[error("view {view}: the {what} is not finite; check where the initial pose and camera come from")]
    NotFinite {
        /// Which of the views.
        view: usize,
        /// Pose or intrinsics.
        what: &'static str,
    },
    /// The GPU failed.
    #[error("{device}: {what}; restart the node, or set `device: cpu`")]
    Device {
        /// The device's name.
        device: String,
        /// What it said.
        what: String,
    },
}

/// Refuses a view that no rasteriser can draw. `index` names it in the error.
///
/// # Errors
/// [`RasterError::Size`] and [`RasterError::NotFinite`].
pub fn check_view(index: usize, view: &View) -> Result<(), RasterError> {
    let View { width, height, intrinsics: k, .. } = *view;
    if !(1..=MAX_SIZE_PX).contains(&width) || !(1..=MAX_SIZE_PX).contains(&height) {
        return Err(RasterError::Size { width, height });
    }
    if [k.fx, k.fy, k.cx, k.cy].iter().any(|v| !v.is_finite()) || k.fx <= 0.0 || k.fy <= 0.0 {
        return Err(RasterError::NotFinite { view: index, what: "camera matrix (or its focal length not positive)" });
    }
    if view.camera_from_object.to_homogeneous().iter().any(|v| !v.is_finite()) {
        return Err(RasterError::NotFinite { view: index, what: "pose" });
    }
    Ok(())
}
