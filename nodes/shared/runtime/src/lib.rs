//! What every node stands on: the [`Node`] trait, graphs in YAML, delivery over iceoryx2, the supervisor.

mod bad;
pub mod bag;
mod board;
mod clock;
mod context;
mod draws;
mod error;
pub mod files;
pub mod graph;
mod histogram;
mod ipc;
mod lines;
pub mod local;
mod node;
mod plan;
mod port;
mod registry;
mod runner;
pub mod shipped;
mod stride;
pub mod supervisor;
pub mod yaml;

pub use bad::{BadFrames, BadInput, OrBadInput, Refused, bad_input};
pub use context::Context;
pub use draws::{Draws, DrawsBy};
pub use graph::{Graph, GraphError, Mode, NodeSpec, Problem};
pub use ipc::IpcError;
pub use lines::{JsonLines, LinesError, read_lines};
pub use node::{InMemory, Inputs, MissingInput, Node, NodeError, Outputs, PortSpec, Produced, Role, read};
pub use port::Port;
pub use registry::Registry;
pub use runner::RunError;
pub use stride::Stride;
