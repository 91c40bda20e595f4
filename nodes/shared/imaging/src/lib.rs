//! Images, meshes and what turns one into the other: loaders, the software rasteriser, crop resampling, overlays
//! and BOP folders without their ground truth (that lives in `pseudoflow-metrics`).
//!
//! Conventions as in `pseudoflow-geometry`: metres, `a_from_b`, optical camera frames, pixel centres at integers.
//! Images are row-major; an RGB image is `height x width x 3` bytes, sRGB-encoded.

mod bop;
mod crop;
mod error;
mod files;
mod flow_colour;
mod mesh;
mod normals;
mod obj;
mod objects;
mod overlay;
mod ply;
pub mod raster;
pub mod shapes;
mod texture;

pub use bop::{BopFrame, BopScene, InitialPose, list_scenes, read_initial_poses};
pub use crop::{resample, resample_with_border};
pub use error::ImagingError;
pub use files::{
    DepthImage, decode_rgb, encode_gif, encode_jpeg, encode_png, image_size, load_depth, load_rgb, save_png,
};
pub use flow_colour::{flow_to_colour, heat_map};
pub use image::RgbImage;
pub use mesh::{Mesh, MeshParts};
pub use obj::load_obj;
pub use objects::{Object, ObjectSet};
pub use overlay::{INITIAL_COLOUR, REFINED_COLOUR, draw_contour, draw_pose_contour, side_by_side};
pub use ply::load_ply;
pub use texture::{Level, MAX_TAPS, Texture};

/// The grey of what lies outside an object or outside the image, in all three channels.
pub const BACKGROUND_GREY: u8 = 128;
