//! Images, meshes and what turns one into the other: loaders, the software rasteriser, crop resampling, overlays
//! and BOP folders without their ground truth (that lives in `pseudoflow-metrics`).
//!
//! Conventions as in `pseudoflow-geometry`: metres, `a_from_b`, optical camera frames, pixel centres at integers.
//! Images are row-major; an RGB image is `height x width x 3` bytes, sRGB-encoded.
//!
//! Begin with [`ObjectSet`] (meshes of a folder) and [`raster::SoftwareRasteriser`] (what a camera would see of them):
//!
//! ```
//! use pseudoflow_geometry::{Intrinsics, Pose};
//! use pseudoflow_imaging::raster::{Rasteriser, SoftwareRasteriser, View};
//! use pseudoflow_imaging::shapes::cuboid;
//! use std::sync::Arc;
//!
//! let mut rasteriser = SoftwareRasteriser::new();
//! rasteriser.add_object(1, &Arc::new(cuboid([0.1, 0.1, 0.1], [200, 40, 40])?))?;
//! let camera_from_object = Pose::translation(0.0, 0.0, 0.5);
//! let intrinsics = Intrinsics { fx: 100.0, fy: 100.0, cx: 31.5, cy: 31.5 };
//! let view = View { object_id: 1, camera_from_object, intrinsics, width: 64, height: 64 };
//! let rendering = rasteriser.render(&[view])?.remove(0);
//!
//! // The front of the cube is 45 cm away; the corner of the image shows nothing.
//! let depth_m = rendering.depth_image().at(32, 32).expect("the cube is there");
//! assert!((depth_m - 0.45).abs() < 1e-4);
//! assert_eq!(rendering.mask[0], 0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod bop;
mod crop;
mod error;
mod files;
mod flow_colour;
mod mesh;
mod models;
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
pub use models::MeshFile;
pub use obj::load_obj;
pub use objects::{Object, ObjectSet};
pub use overlay::{INITIAL_COLOUR, REFINED_COLOUR, draw_contour, draw_pose_contour, side_by_side};
pub use ply::load_ply;
pub use texture::{Level, MAX_TAPS, Texture};

/// The grey of what lies outside an object or outside the image, in all three channels.
pub const BACKGROUND_GREY: u8 = 128;
