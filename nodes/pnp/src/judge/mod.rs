//! The judge node: whether a network's weights are better than another's, told by the pictures alone.
//!
//! Both networks compare the same renderings with the same crops; PnP solves each flow from the same initial pose with the same
//! random numbers, and no gate intervenes. What is left to differ are the networks. Each pose is then held against the picture
//! ([`crate::gate::Evidence`]): the correlation of the rendering with the crop, and the contrast across the contour. The inlier
//! ratio is written too but does not count in a [`Verdict`]: it is a network's agreement with itself, and grows when it learns
//! to repeat itself.
//!
//! With one network it says of each initial pose whether flow and pictures confirm it: [`Judged::agreement`].

mod frame;
mod node;
mod verdict;

pub use frame::{Judged, JudgedFrame, JudgedInstance};
pub use node::{JudgeConfig, JudgeNode};
pub use verdict::Verdict;
