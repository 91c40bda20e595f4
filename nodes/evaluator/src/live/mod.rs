//! How a graph does beside a camera: when each frame's poses came, and whether they were right.
//!
//! - [`StopwatchNode`] writes down what comes ([`Arrival`]), with its age. It sees no truth.
//! - [`Expectation`] is what should have come: ground truth of a BOP scene, or a reference result file.
//! - [`LiveReport`] sets the two against each other: rates, latencies, recall over all visible instances, how soon an object is
//!   found at first and again.

mod arrivals;
mod expectation;
mod page;
mod report;
mod stopwatch;
mod table;
#[cfg(test)]
mod tests;
mod verdict;

pub use arrivals::{Arrival, Arrivals, ArrivedPose, read_arrivals};
pub use expectation::Expectation;
pub use report::{FirstPose, Latency, LiveReport, LiveRun, NodeCost, ObjectReport, Reacquired, Recall};
pub use stopwatch::{StopwatchConfig, StopwatchNode};

/// A pose that comes later than this after its frame was due is too late to act on, milliseconds.
pub const ON_TIME_MS: f64 = 100.0;
/// An object of which less is visible counts as hidden (as BOP's `VISIB_GT_MIN`).
pub const HIDDEN_BELOW: f64 = pseudoflow_metrics::VISIB_GT_MIN;
/// What is hidden longer must not be published as if it were seen, seconds.
pub const HIDDEN_LONG_S: f64 = 0.5;
