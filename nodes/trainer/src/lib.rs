//! Training of the flow network: on synthetic pairs ([`pretrain`]; docs/method.md, "Synthetic pre-training") and, without
//! annotations, on real recordings ([`adapt`]; docs/method.md, "Self-supervision").

pub mod adapt;
mod error;
pub mod initializer;
pub mod offline;
pub mod pretrain;
mod preview;
pub mod synth;

pub use error::TrainerError;
pub use preview::preview_sheet;
