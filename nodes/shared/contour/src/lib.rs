//! Region-based pose refinement: an object's contour, the colours on both sides of it, and what else is known of its pose.
//!
//! A [`ContourModel`] holds where the contour of an object is, seen from each of 642 sides; it is made once from the mesh
//! ([`load_or_make`] keeps it on disk). A [`Refiner`] brings the part of an image around an object to one size of the object,
//! reads along lines across the contour where the colours change from those of the object to those around it (SRT3D, ICG:
//! arXiv 2110.12715, 2203.05334), and takes Gauss-Newton steps from coarse to fine; the last ones on edges, placed to a
//! fraction of a pixel. The rough pose is a prior ([`Prior`]), not only a start; [`Term`] adds whatever else knows of the pose.
//!
//! Three things were measured to matter beyond the published method:
//! - Mixed pixels at the border count as background where the background has many colours: the histograms alone put the
//!   contour 0.02-0.06 diameters too far. The steps on edges, which know that blur mixes both sides, remove it.
//! - Neighbouring lines share errors, and all lines share an offset of some tenths of a pixel; without a variance for both
//!   the contour claims depths that it does not know, and breaks right poses.
//! - Lines inside the silhouette of a nearer known object ([`Hider`]) are not used.
//!
//! Frames, units, tangents: `pseudoflow-geometry` and `pseudoflow-solver`. No middleware, clock or random source.
//!
//! Begin with [`ContourModel`] and [`Refiner`]:
//!
//! ```
//! use nalgebra::Vector3;
//! use pseudoflow_contour::{ContourModel, Image, ModelSettings, Refiner, RegionConfig, Task};
//! use pseudoflow_geometry::{Intrinsics, Pose};
//! use pseudoflow_imaging::raster::{Rasteriser, SoftwareRasteriser, View};
//! use pseudoflow_imaging::shapes::cuboid;
//! use std::sync::Arc;
//!
//! // A picture of a red box, half a metre away.
//! let mesh = Arc::new(cuboid([0.10, 0.06, 0.08], [200, 40, 40])?);
//! let truth = Pose::new(Vector3::new(0.0, 0.0, 0.5), Vector3::new(0.6, 0.5, 0.0));
//! let intrinsics = Intrinsics { fx: 500.0, fy: 500.0, cx: 159.5, cy: 119.5 };
//! let mut rasteriser = SoftwareRasteriser::new();
//! rasteriser.add_object(1, &mesh)?;
//! let view = View { object_id: 1, camera_from_object: truth, intrinsics, width: 320, height: 240 };
//! let picture = rasteriser.render(&[view])?.remove(0).rgb;
//!
//! let model = ContourModel::new(&mesh, &ModelSettings::default())?;
//! let mut refiner = Refiner::new(RegionConfig::default())?;
//! let rough = Pose::translation(0.008, -0.004, 0.02) * truth;
//! let prior = refiner.prior(&rough, &model, mesh.diameter_m());
//! let task = Task { image: Image { rgb: &picture, intrinsics }, model: &model, prior: &prior, hiders: &[] };
//! let found = refiner.refine(&task, &[rough], None);
//!
//! assert!(found.status.is_ok(), "{}", found.status);
//! let off_m = (found.camera_from_object.translation.vector - truth.translation.vector).norm();
//! assert!(off_m < 0.006, "{off_m} m; the rough pose is off by 0.022 m");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod cache;
mod config;
mod error;
mod follow;
mod hiders;
mod histogram;
mod icosphere;
mod lines;
mod model;
mod outline;
mod picture;
mod prior;
mod refine;
mod status;

pub use cache::load_or_make;
pub use config::{PriorConfig, RegionConfig};
pub use error::ContourError;
pub use hiders::Hider;
pub use histogram::Colours;
pub use model::{ContourModel, ContourPoint, ModelSettings};
pub use picture::{Image, image_of_bytes};
pub use prior::{Prior, retract};
pub use refine::{Refiner, Region, Task, Term};
pub use status::RegionStatus;
