//! The renderer node: for each initial pose of a frame, the real crop and `n` renderings of the object at and
//! around that pose (method.md, steps 2 and 3; paper, eq. 2).
//!
//! [`views`] is the algorithm: crop, jitter, rendering, resampling. [`device`] chooses the rasteriser; [`node`]
//! is the thin shell around both.

mod device;
mod node;
mod views;

pub use device::{Device, open};
pub use node::{RendererConfig, RendererNode};
pub use views::{Plan, PlannedInstance, ViewSettings, plan};
