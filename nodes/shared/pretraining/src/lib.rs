//! Training on synthetic pictures, without a graph: of flow networks on pairs ([`pretrain`]; docs/method.md, "Synthetic
//! pre-training") and of the network that finds objects ([`initializer`]). One loop runs both, with its log, checkpoints and learning
//! curve ([`offline`]).
//!
//! Begin with [`pretrain::PretrainConfig`].

mod error;
pub mod initializer;
pub mod offline;
pub mod pretrain;

pub use error::PretrainError;
