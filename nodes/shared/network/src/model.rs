//! What weights, checkpoints and training need to know of a network: the flow networks and the initializer's share them.

use crate::error::{NetworkError, Result};
use crate::weights::Weights;

/// How a tensor starts when a network is trained from scratch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Init {
    /// Normal with standard deviation sqrt(2 / fan out).
    KaimingNormal,
    /// Uniform in +-1 / sqrt(fan in), the given number: PyTorch's default for weights and biases.
    Uniform(usize),
    /// A constant.
    Constant(f32),
}

/// One tensor of a network.
#[derive(Debug, Clone, PartialEq)]
pub struct TensorSpec {
    /// Name, unique in the network.
    pub name: String,
    /// Shape, outermost first.
    pub shape: Vec<usize>,
    /// How it starts.
    pub init: Init,
}

/// A configured architecture.
pub trait Model: Clone {
    /// Name, written into the weights.
    fn name(&self) -> &str;

    /// Fingerprint of what decides the weights' meaning.
    fn hash(&self) -> String;

    /// All tensors in a fixed order.
    fn layout(&self) -> Vec<TensorSpec>;

    /// Checks the ranges.
    ///
    /// # Errors
    /// Names the first field out of range.
    fn check(&self) -> Result<()>;

    /// Checks that weights have every tensor of the architecture.
    ///
    /// # Errors
    /// Names the first tensor that is missing or has another shape.
    fn check_weights(&self, weights: &Weights) -> Result<()> {
        for spec in self.layout() {
            let problem = match weights.get(&spec.name) {
                Some(tensor) if tensor.shape == spec.shape => continue,
                Some(tensor) => format!("has {:?}", tensor.shape),
                None => "is missing".into(),
            };
            return Err(NetworkError::WeightsMismatch {
                origin: format!("weights of `{}`", weights.info.network),
                network: self.name().to_owned(),
                tensor: spec.name,
                problem: format!("{problem}, the network needs shape {:?}", spec.shape),
            });
        }
        Ok(())
    }
}

/// Added to stored variances, as PyTorch does.
pub const BATCH_NORM_EPSILON: f32 = 1e-5;

/// Fingerprint (FNV-1a, 64 bit, hex) of a text.
pub(crate) fn fingerprint(text: &str) -> String {
    let hash = text.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3));
    format!("{hash:016x}")
}
