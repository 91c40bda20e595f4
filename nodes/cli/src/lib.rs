//! What the two programs share, `pseudoflow` and `pseudoflow-with-truth`: the options and the graph of a training, and how a command
//! runs a graph that it wrote.

/// Heading of options that few people need: left out of `-h`, told by `--help`.
pub const RARE: &str = "Rare options";

pub mod graphs;
pub mod in_process;
pub mod progress;
pub mod training;
