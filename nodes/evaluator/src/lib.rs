//! Scores poses against ground truth and reports what it found.
//!
//! - [`load_dataset`] reads a split of a BOP dataset with its truth; [`EvalDataset::initial_estimates`] gives the
//!   scenes' initial poses, `pseudoflow_metrics::read_results` a result file.
//! - [`evaluate`] scores sets of estimates by the rules of the BOP Challenge 2019 into a [`Report`]
//!   (`report.json`, and with [`overlays`] a self-contained page).
//! - [`Diagnosis`] says what is wrong: depth, rotation, visibility, the gate, confidence and covariance.
//! - [`compare`] sets two reports against each other, with a paired bootstrap interval.
//! - [`live`] says how a graph does beside a camera: rates, latencies, what was right in time.
//! - [`results`] writes what a graph found as a BOP result file.
//! - [`EvaluatorNode`] collects poses from the graph and scores them at the end.

mod compare;
mod dataset;
mod depth;
mod diagnosis;
mod error;
mod evaluate;
mod html;
pub mod live;
mod node;
mod overlay;
mod report;
pub mod results;
mod score;

pub use compare::{Comparison, Difference, compare, compare_sets};
pub use dataset::{EvalDataset, EvalImage, EvalModel, load_dataset};
pub use diagnosis::{
    Changes, ConfidenceBin, ConfidenceCalibration, Coverage, Diagnosis, GateCalibration, VISIBLE_BINS, VisibleBin,
};
pub use error::EvalError;
pub use evaluate::{EstimateDetails, GateStep, NamedEstimates, evaluate};
pub use node::{EvaluatorConfig, EvaluatorNode};
pub use overlay::{OverlayCase, overlays};
pub use report::{GateErrors, InstanceErrors, ObjectInfo, Report, Scores, VsdDepth, Without};
pub use score::vsd_of_pair;
