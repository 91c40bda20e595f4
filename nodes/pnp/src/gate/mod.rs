//! Whether a refined pose should replace the initial one, judged without ground truth, and how sure that is.
//!
//! RANSAC's success is no safeguard (docs/method.md, "Which wrong answers look right"): a flow network can be wrong in agreement with itself. So
//! the gate looks at the pictures again. [`Gate::evidence`] measures; [`Features`] are what solution and pictures say in
//! numbers; a [`StageModel`] that was fitted on synthetic pairs, whose truth is lawful, says how probable it is that the
//! refined pose is better than the initial one, and that each of them is right; [`GateConfig::decide`] decides.

mod contour;
mod decision;
mod evidence;
mod features;
mod logistic;
mod model;
mod picture;
#[cfg(test)]
mod tests;

pub use contour::ContourScale;
pub use decision::{Decision, GateConfig, GateReason};
pub use evidence::{Evidence, Gate, GateView};
pub(crate) use features::merit;
pub use features::{Feature, Features, Scale};
pub use logistic::{Logistic, Term};
pub use model::{CovarianceScale, GateModel, GateModelError, Stage, StageModel, Verdict};
