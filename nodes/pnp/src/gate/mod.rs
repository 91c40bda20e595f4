//! Whether a refined pose should replace the initial one, judged without ground truth.
//!
//! RANSAC's success is no safeguard (method.md, last section): a flow network can be wrong in agreement with itself. So
//! the gate looks at the pictures again. [`Gate::evidence`] measures, [`GateConfig::decide`] compares with limits.

mod decision;
mod evidence;
mod picture;
#[cfg(test)]
mod tests;

pub use decision::{Decision, GateConfig, GateReason};
pub use evidence::{Evidence, Gate, GateView};
