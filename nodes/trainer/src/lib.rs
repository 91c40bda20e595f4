//! Training of the flow network. Here: pre-training on synthetic pairs (method.md, "Synthetic pre-training").

mod error;
pub mod pretrain;
mod preview;
pub mod synth;

pub use error::TrainerError;
pub use preview::preview_sheet;
