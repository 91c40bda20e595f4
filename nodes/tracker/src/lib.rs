//! The tracker node: follows all objects of a set at the rate of the camera, without a network on the way of a frame.
//!
//! | port | | what |
//! |---|---|---|
//! | `frame` | in, joined | the camera |
//! | `found` | in, late | poses that a search has found, keyed by the frame they were found in, of any age |
//! | `looks` | in, late | poses from pnp for the frame whose look was asked for |
//! | `search` | in, latest | live: what the search says of each object; passed on for those that it cannot look for yet |
//! | `poses` | out | every object that is followed: measured, or predicted (`PoseSource::Tracked`) |
//! | `requests` | out | initial poses for the renderer: the objects for which a look at this frame is asked |
//! | `wanted` | out | which objects should be searched for |
//! | `status` | out | where the tracking of each object stands, and why |
//!
//! The work is that of `pseudoflow-tracking`. In replay a correction of frame k is used in frame k + `look_delay` (`found_delay`),
//! for which the frame waits: the same recording gives the same bytes. Live, what has come is used.

mod config;
mod late;
mod node;

pub use config::TrackerNodeConfig;
pub use node::{TrackerNode, looked, request};
