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
