//! What every node stands on: the [`Node`] trait, graphs in YAML, delivery over iceoryx2, the supervisor.
//!
//! Begin with [`Node`]: a kind of node is one type, which declares its ports ([`Port`]) and handles a frame. A [`Registry`] knows the
//! kinds, a [`Graph`] wires them, and [`supervisor::run`] (processes) or [`local::run`] (this process) runs it. `cargo run --release
//! --example write_a_node` is a whole one.
//!
//! ```
//! use pseudoflow_msgs::{AlignedBytes, FrameKey, ObjectPoses};
//! use pseudoflow_runtime::{Context, InMemory, Inputs, Node, NodeError, Outputs, Port, PortSpec, Role};
//!
//! const POSES: Port<ObjectPoses<'static>> = Port::required("poses");
//!
//! /// Its block in a graph.
//! #[derive(serde::Deserialize, schemars::JsonSchema)]
//! #[serde(deny_unknown_fields)]
//! struct CountConfig {}
//!
//! /// Counts poses.
//! struct Count(usize);
//!
//! impl Node for Count {
//!     const KIND: &'static str = "count";
//!     const ROLE: Role = Role::Sink;
//!     type Config = CountConfig;
//!
//!     fn inputs() -> Vec<PortSpec> {
//!         vec![POSES.spec()]
//!     }
//!     fn outputs() -> Vec<PortSpec> {
//!         Vec::new()
//!     }
//!     fn check(_: &CountConfig) -> Result<(), NodeError> {
//!         Ok(())
//!     }
//!     fn create(_: CountConfig, _: &Context) -> Result<Self, NodeError> {
//!         Ok(Self(0))
//!     }
//!     fn process(&mut self, inputs: &dyn Inputs, _: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
//!         self.0 += POSES.read(inputs)?.poses.len();
//!         Ok(())
//!     }
//! }
//!
//! // A node runs by itself, too: so it is tested.
//! let context = Context { name: "count".into(), seed: 1, out_dir: ".".into(), restarts: 0, replay: true };
//! let mut node = Count::create(CountConfig {}, &context)?;
//! let mut frame = InMemory::new(FrameKey { index: 0, stamp_ns: 0 });
//! let two: [pseudoflow_msgs::ObjectPose; 2] = bytemuck::Zeroable::zeroed();
//! let mut bytes = AlignedBytes::zeroed(ObjectPoses::byte_len(2));
//! ObjectPoses::write(&mut bytes, 0, 0, &two);
//! frame.messages.push(("poses".into(), bytes));
//! node.process(&frame, &mut InMemory::default(), &context)?;
//! assert_eq!(node.0, 2);
//! # Ok::<(), NodeError>(())
//! ```

mod bad;
mod board;
mod clock;
mod context;
mod draws;
mod error;
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
