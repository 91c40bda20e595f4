//! What a node says of a frame that it cannot use although it can go on.

use crate::NodeError;
use crate::board::{Board, Word};
use crate::plan::Plan;
use serde::Serialize;

/// A frame that cannot be used, where the next one may be: a picture without pixels, a pose of an unknown object.
///
/// In a live graph the runtime drops the frame, counts it, and names port, producer and cause in the log and in the
/// run's summary; nodes further down pass over the frame. A replay ends with it: a recording that is not what its
/// graph takes is to be known, not thinned out. Any other error of [`Node::process`](crate::Node::process) means that
/// the node cannot go on: a live graph starts it again, a replay ends.
#[derive(Debug, thiserror::Error)]
#[error("input `{port}`: {cause}")]
pub struct BadInput {
    /// The input that it came by; of a source what it reads from.
    pub port: &'static str,
    /// What is wrong with it.
    pub cause: NodeError,
}

/// Marks an error as one of this frame alone.
pub fn bad_input(port: &'static str, cause: impl Into<NodeError>) -> NodeError {
    BadInput { port, cause: cause.into() }.into()
}

/// [`bad_input`] for results.
pub trait OrBadInput<T> {
    /// Marks the error as one of the frame that came by `port`.
    ///
    /// # Errors
    /// The error that was there, marked.
    fn or_bad_input(self, port: &'static str) -> Result<T, NodeError>;
}

impl<T, E: Into<NodeError>> OrBadInput<T> for Result<T, E> {
    fn or_bad_input(self, port: &'static str) -> Result<T, NodeError> {
        self.map_err(|error| bad_input(port, error))
    }
}

/// Frames that a node of a live run has dropped since the run began, by where they came from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct BadFrames {
    /// The node that dropped them.
    pub node: String,
    /// The input that they came by; `None` for what a source takes from outside.
    pub input: Option<&'static str>,
    /// The node that sent them.
    pub producer: Option<String>,
    /// How many.
    pub frames: u64,
    /// Why the node's last one was dropped, by whatever input it came.
    pub last: String,
}

/// What a live source has refused from outside since it was last asked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refused {
    /// How many messages.
    pub messages: u64,
    /// Where the last one came from, and why it was refused.
    pub last: String,
}

/// All that was dropped in a run.
pub(crate) fn bad_frames(plan: &Plan, board: &Board) -> Vec<BadFrames> {
    (0..plan.nodes.len()).flat_map(|node| bad_frames_of(plan, board, node)).collect()
}

/// What one node has dropped, by input.
pub(crate) fn bad_frames_of(plan: &Plan, board: &Board, node: usize) -> Vec<BadFrames> {
    let last = board.last_bad(node).unwrap_or_default();
    let of = |input, producer, frames| BadFrames {
        node: plan.nodes[node].name.clone(),
        input,
        producer,
        frames,
        last: last.clone(),
    };
    let inputs = plan.nodes[node].inputs.iter().enumerate();
    let mut bad: Vec<BadFrames> = inputs
        .map(|(at, input)| {
            let producer = plan.nodes[input.producer].name.clone();
            of(Some(input.port), Some(producer), board.bad_from(node, at))
        })
        .collect();
    let inside: u64 = bad.iter().map(|of| of.frames).sum();
    bad.push(of(None, None, board.get(node, Word::Bad).saturating_sub(inside)));
    bad.retain(|of| of.frames > 0);
    bad
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_of_a_frame_is_told_from_others_and_keeps_its_cause() {
        let marked = Err::<(), _>("0 x 0 pixels").or_bad_input("frame").expect_err("an error");
        assert_eq!(crate::error::chain(&*marked), "input `frame`: 0 x 0 pixels");
        assert_eq!(marked.downcast_ref::<BadInput>().map(|bad| bad.port), Some("frame"));
        assert!(NodeError::from("the disk is full").downcast_ref::<BadInput>().is_none());
    }
}
