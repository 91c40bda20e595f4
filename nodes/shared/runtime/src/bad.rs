//! What a node says of a frame that it cannot use although it can go on.

use crate::NodeError;

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
