//! The renderer node: for each initial pose of a frame, the real crop and `n` renderings of the object at and
//! around that pose (docs/method.md, steps 2 and 3; paper, eq. 2).
//!
//! `views` is the algorithm: crop, jitter, rendering, resampling. `device` chooses the rasteriser: `gpu` or
//! the software one. `node` is the thin shell around them.

mod device;
mod gpu;
mod node;
mod partners;
mod views;

pub use device::{Device, open};
pub use gpu::{AdapterChoice, GpuRasteriser, adapters};
pub use node::{RendererConfig, RendererNode};
pub use views::{Plan, PlannedInstance, ViewSettings, plan};
