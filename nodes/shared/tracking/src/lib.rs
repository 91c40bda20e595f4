//! Objects followed from frame to frame at the rate of a camera, on one core and without a network.
//!
//! [`Tracker::step`] takes a frame and what others have found in earlier frames ([`Correction`]), and says where each object is
//! ([`Estimate`]). An object is predicted with constant velocity, then its contour (colours on both sides, kept from frame to
//! frame; `pseudoflow-contour`) and its texture (patches of a keyframe, whose depth is that of the object's pose there; Lucas and
//! Kanade 1981, Baker and Matthews 2004) are brought to the picture by one robust Gauss-Newton (M3T: arXiv 2302.11458). What
//! picture and prediction do not agree on is held: objects that have been at rest together move together, others go on as they
//! moved. A correction of frame k is carried to the present by the motion since, and taken where the present picture likes it better.
//!
//! Nothing here knows of clocks, threads, networks or middleware: the same frames and corrections give the same bits.
//! Frames, units, tangents: `pseudoflow-geometry`, `pseudoflow-contour`.

mod at_rest;
mod carry;
mod compare;
mod config;
mod error;
mod follow;
mod history;
mod judge;
mod looks;
mod measure;
mod rest;
mod settle;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod texture;
mod track;
mod tracker;
mod types;

pub use config::{TextureConfig, TrackingConfig};
pub use error::TrackingError;
pub use judge::Evidence;
pub use looks::Look;
pub use track::Phase;
pub use tracker::Tracker;
pub use types::{Correction, CorrectionKind, Estimate, Frame, FrameProblem, KnownObject, Step};
