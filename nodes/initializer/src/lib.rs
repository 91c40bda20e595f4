//! The initializer node: objects of a set are found in an image, each with a first pose (docs/method.md, pipeline step 1; Hu et
//! al., "Wide-Depth-Range 6D Object Pose Estimation in Space", CVPR 2021).
//!
//! The network says for every cell which object it shows and where the corners of that object's box are ([`votes`]); cells
//! that mean the same instance vote together, and RANSAC-PnP makes a pose of their votes ([`detect`]). Where a flow network is
//! at hand, the object is also rendered from all sides, and the view whose features resemble the image most takes part
//! ([`Comparer`]): that needs no training, while a network must have seen very many images before it tells how a box is turned.

mod answer;
mod compare;
pub mod detect;
mod error;
mod find;
mod fit;
mod memory;
mod network;
mod node;
mod patience;
mod rectangle_finder;
pub mod track;
pub mod votes;

pub use compare::{CoarseMatch, CompareConfig, Comparer, Match, Photograph, Preparing};
pub use error::InitializerError;
pub use fit::Fit;
pub use network::{Answer, DetectorNetwork};
pub use node::{InitializerConfig, InitializerNode};
pub use patience::SearchConfig;
pub use rectangle_finder::{RectangleFinder, RectangleFinderConfig};
