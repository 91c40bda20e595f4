//! What bridge, player and recorder share, so that a live camera and its recording mean the same: the names of an object
//! set ([`Catalogue`]), cameras as their drivers give them ([`camera`]), the pixels of their images ([`pixels`]). No middleware
//! here: messages are plain data.
//!
//! Begin with [`Catalogue`] and [`camera::Lens`]:
//!
//! ```
//! use pseudoflow_edge::Catalogue;
//! use pseudoflow_edge::camera::Lens;
//! use pseudoflow_msgs::ros::{CameraInfo, Header};
//!
//! let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../config/objects/tabletop");
//! let catalogue = Catalogue::load(folder.as_ref())?;
//! assert_eq!(catalogue.naming.class_id(2), "mustard_bottle");
//!
//! // A lens that bends: what the rectified image shows at a corner is elsewhere in the image as it came.
//! let mut info = CameraInfo::pinhole(Header::default(), (640, 480), [600.0, 600.0, 319.5, 239.5]);
//! assert!(!Lens::new(&info, (640, 480), false)?.is_distorted());
//! info.d = vec![-0.2, 0.05, 0.0, 0.0, 0.0];
//! let source = Lens::new(&info, (640, 480), false)?.source([20.0, 20.0]).expect("the lens saw it");
//! assert!(source[0] > 20.0 && source[1] > 20.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod camera;
mod objects;
pub mod pixels;
mod rectangles;

pub use objects::{Catalogue, CatalogueError, naming_of};
pub use pseudoflow_imaging::MeshFile;
pub use rectangles::{RectangleError, rectangle_of};
