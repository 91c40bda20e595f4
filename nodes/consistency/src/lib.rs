//! The consistency node: pseudo-labels for the flow of rendered views (paper, section "Pseudo flow consistency",
//! eqs. 3 to 5; docs/method.md, "Self-supervision").
//!
//! The teacher predicts one flow for each of n views rendered around an initial pose. Every flow says where the surface
//! points of its view lie in the real crop; where the views say the same of a point, the flow is taken as a label.
//! [`votes`] is the algorithm, over plain slices; [`node`] is the thin shell around it.
//!
//! Nothing here knows the true pose or the real mask: neither type is among the dependencies.

mod error;
mod node;
mod picture;
mod rigid;
mod votes;

#[cfg(test)]
mod tests;

pub use error::ConsistencyError;
pub use node::{ConsistencyConfig, ConsistencyNode};
pub use picture::{label_panel, label_pictures};
pub use votes::{Label, Labels, Rule, View, label};
