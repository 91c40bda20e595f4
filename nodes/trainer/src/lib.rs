//! Training of the flow network: on synthetic pairs ([`pretrain`]; docs/method.md, "Synthetic pre-training") and, without
//! annotations, on real recordings ([`adapt`]; docs/method.md, "Self-supervision").
//!
//! Begin with [`pretrain`] and [`synth::SampleGenerator`]:
//!
//! ```
//! use pseudoflow_trainer::synth::{ObjectPool, SampleGenerator, SynthConfig};
//! use std::sync::Arc;
//!
//! let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../config/objects/tabletop");
//! let objects = Arc::new(ObjectPool::load(&[folder.into()])?);
//! let generator = SampleGenerator::new(objects, SynthConfig::default(), 7)?; // the same seed, the same pairs
//! let pairs = generator.batch(0, 2, 64)?;
//! assert_eq!((pairs.len(), pairs[0].reference.dimensions()), (2, (64, 64)));
//! # Ok::<(), pseudoflow_trainer::TrainerError>(())
//! ```

pub mod adapt;
mod error;
pub mod initializer;
pub mod offline;
pub mod pretrain;
mod preview;
pub mod synth;

pub use error::TrainerError;
pub use preview::preview_sheet;
