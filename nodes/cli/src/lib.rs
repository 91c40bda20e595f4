//! What the two programs share, `pseudoflow` and `pseudoflow-with-truth`: the options and the graph of a training, how a command
//! runs a graph that it wrote, and where shipped files are.

/// Heading of options that few people need: left out of `-h`, told by `--help`.
pub const RARE: &str = "Rare options";

#[cfg(feature = "embed")]
pub mod carried;
pub mod graphs;
pub mod in_process;
pub mod progress;
#[cfg(feature = "training")]
pub mod training;
