//! The consistency node: pseudo-labels for the flow of rendered views (paper, section "Pseudo flow consistency",
//! eqs. 3 to 5; docs/method.md, "Self-supervision").
//!
//! The teacher predicts one flow for each of n views rendered around an initial pose. Every flow says where the surface
//! points of its view lie in the real crop; where the views say the same of a point, the flow is taken as a label.
//! `votes` is the algorithm, over plain slices; `node` is the thin shell around it.
//!
//! Nothing here knows the true pose or the real mask: neither type is among the dependencies.
//!
//! Begin with [`label`]:
//!
//! ```
//! use pseudoflow_consistency::{Label, Rule, View, label};
//! use pseudoflow_geometry::{Intrinsics, Pose};
//!
//! // Two renderings of a flat thing 1 m away, the second 1 cm further to the right: 4 px in a crop of 32 px.
//! let intrinsics = Intrinsics { fx: 400.0, fy: 400.0, cx: 15.5, cy: 15.5 };
//! let (depth_m, mask) = (vec![1.0; 32 * 32], vec![1; 32 * 32]);
//! // The teacher sees the thing 2 px to the right of the first rendering, hence 2 px to the left of the second.
//! let flows = [2.0, -2.0].map(|dx| [dx, 0.0].repeat(32 * 32));
//! let view = |i: usize| View {
//!     size_px: 32,
//!     camera_from_object: Pose::translation(0.01 * i as f64, 0.0, 1.0),
//!     intrinsics,
//!     depth_m: &depth_m,
//!     mask: &mask,
//!     flow_px: &flows[i],
//! };
//! let rule = Rule { tau_px: 1.0, min_views: 2, label: Label::TeacherFlow, accept_all: false };
//! let diameter_m = 0.1;
//! let labels = label(&[view(0), view(1)], diameter_m, &rule)?;
//! // Both say the same of the middle.
//! let middle = 16 * 32 + 16;
//! assert!(labels[0].valid[middle] == 255 && labels[0].sigma_px[middle] < 1e-3);
//! # Ok::<(), pseudoflow_consistency::ConsistencyError>(())
//! ```

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
