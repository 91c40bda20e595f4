//! Training on synthetic pictures, without a graph: of flow networks on pairs ([`pretrain`]; docs/method.md, "Synthetic
//! pre-training") and of the network that finds objects ([`initializer`]). One loop runs both, with its log, checkpoints and learning
//! curve ([`offline`]).
//!
//! Begin with [`pretrain::PretrainConfig`]:
//!
//! ```
//! use pseudoflow_pretraining::offline::TerminalProgress;
//! use pseudoflow_pretraining::pretrain::{PretrainConfig, pretrain};
//! # fn training() -> Result<(), pseudoflow_pretraining::PretrainError> {
//! let config = PretrainConfig::new(vec!["my/models".into()], "refiner", "my.safetensors".into());
//! pretrain(&config, &mut TerminalProgress::new()?)?; // goes on from its checkpoint where `resume` is set
//! # Ok(())
//! # }
//! ```

mod error;
pub mod initializer;
pub mod offline;
pub mod pretrain;

pub use error::PretrainError;
