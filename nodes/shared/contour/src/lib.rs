//! Region-based pose refinement.
mod cache;
mod error;
mod hiders;
mod histogram;
mod icosphere;
mod lines;
mod model;
mod outline;
mod picture;
mod prior;
mod refine;

pub use cache::load_or_make;
pub use error::ContourError;
pub use hiders::Hider;
pub use model::{ContourModel, ContourPoint, ModelSettings};
pub use picture::{Image, image_of_bytes};
pub use prior::{Prior, retract};
pub use refine::{Nothing, Refiner, Region, RegionConfig, Term};
