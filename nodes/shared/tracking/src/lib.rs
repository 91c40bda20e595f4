//! Objects followed from frame to frame at the rate of a camera, without a network.
//!
//! [`Tracker::step`] takes a frame and what others have found in earlier frames ([`Correction`]), and says where each object is
//! ([`Estimate`]). An object is predicted with constant velocity, then its contour (colours on both sides, kept from frame to
//! frame; `pseudoflow-contour`) and its texture (patches of a keyframe, whose depth is that of the object's pose there; Lucas and
//! Kanade 1981, Baker and Matthews 2004) are brought to the picture by one robust Gauss-Newton (M3T: arXiv 2302.11458). What
//! picture and prediction do not agree on is held: objects that have been at rest together move together, others go on as they
//! moved. A correction of frame k is carried to the present by the motion since, and taken where the present picture likes it better.
//!
//! Nothing here knows of clocks, networks or middleware: the same frames and corrections give the same bits. The objects of a frame are
//! measured side by side, by the threads of the rayon pool that the caller runs in; the bits do not hang on their number.
//! Frames, units, tangents: `pseudoflow-geometry`, `pseudoflow-contour`.
//!
//! Begin with [`Tracker`]:
//!
//! ```
//! use nalgebra::Vector3;
//! use pseudoflow_contour::{ContourModel, ModelSettings};
//! use pseudoflow_geometry::{Intrinsics, Pose};
//! use pseudoflow_imaging::raster::{Rasteriser, SoftwareRasteriser, View};
//! use pseudoflow_imaging::shapes::cuboid;
//! use pseudoflow_tracking::{Correction, CorrectionKind, Frame, KnownObject, Tracker, TrackingConfig};
//! use std::sync::Arc;
//!
//! let mesh = Arc::new(cuboid([0.11, 0.08, 0.06], [200, 40, 40])?);
//! let contour = ContourModel::new(&mesh, &ModelSettings::default())?;
//! let object = KnownObject { id: 1, mesh: Arc::clone(&mesh), contour, diameter_m: mesh.diameter_m() };
//! let mut tracker = Tracker::new(vec![object], TrackingConfig::default())?;
//! let mut rasteriser = SoftwareRasteriser::new();
//! rasteriser.add_object(1, &mesh)?;
//! let intrinsics = Intrinsics { fx: 500.0, fy: 500.0, cx: 159.5, cy: 119.5 };
//! // The box moves by two millimetres a frame.
//! let truth = |frame: u64| Pose::new(Vector3::new(0.002 * frame as f64, 0.0, 0.5), Vector3::new(0.5, 0.4, 0.2));
//!
//! // A search has found it in the first frame, roughly.
//! let camera_from_object = Pose::translation(0.003, -0.002, 0.008) * truth(0);
//! let mut news = vec![Correction { object_id: 1, frame: 0, camera_from_object, kind: CorrectionKind::Found }];
//! let mut last = None;
//! for index in 0..6 {
//!     let view = View { object_id: 1, camera_from_object: truth(index), intrinsics, width: 320, height: 240 };
//!     let picture = rasteriser.render(&[view])?.remove(0).rgb;
//!     let stamp_ns = 1_000_000_000 + 33_333_333 * index as i64;
//!     last = tracker.step(&Frame { index, stamp_ns, rgb: &picture, intrinsics }, &news).estimates.pop();
//!     news.clear();
//! }
//! let estimate = last.expect("it is followed");
//! let off_m = (estimate.camera_from_object.translation.vector - truth(5).translation.vector).norm();
//! assert!(off_m < 0.01, "{off_m} m");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod at_rest;
mod carry;
mod compare;
mod config;
mod error;
mod evidence;
mod follow;
mod history;
mod looks;
mod measure;
mod rest;
mod settle;
mod side_by_side;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod texture;
mod track;
mod tracker;
mod turned;
mod types;

pub use config::{TextureConfig, TrackingConfig};
pub use error::TrackingError;
pub use evidence::Evidence;
pub use looks::Look;
pub use track::Phase;
pub use tracker::Tracker;
pub use turned::half_turn;
pub use types::{Correction, CorrectionKind, Estimate, Frame, FrameProblem, KnownObject, Step};
