//! What every node stands on: the [`Node`] trait, graphs in YAML, delivery over iceoryx2, the supervisor.

mod context;
mod node;

pub use context::Context;
pub use node::{InMemory, Inputs, MissingInput, Node, NodeError, Outputs, PortSpec, Produced, Role, read};
