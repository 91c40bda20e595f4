//! Graphs: which nodes run, with what configuration, and whose output feeds whose input. Read from YAML into
//! strict types; checked against a [`Registry`](crate::Registry) before anything starts.
//!
//! ```
//! use pseudoflow_runtime::Graph;
//!
//! let mut graph = Graph::parse(
//!     "
//! mode: replay
//! params: {size_px: 256}
//! nodes:
//!   player: {kind: player, config: {source: my_bag}}
//!   renderer: {kind: renderer, inputs: {frame: player/frame}, config: {size_px: $size_px}}
//! ",
//!     "my_graph.yaml".as_ref(),
//! )?;
//! graph.set("size_px", "128")?; // as `--set size_px=128`
//! assert_eq!(graph.nodes["renderer"].inputs["frame"].node, "player");
//! // What is unknown is an error that says so; whether the nodes fit together says `graph::check`.
//! assert!(Graph::parse("mode: replay\nwimdow: 3\nnodes: {}", "typo.yaml".as_ref()).is_err());
//! # Ok::<(), pseudoflow_runtime::GraphError>(())
//! ```

mod check;
mod draw;
mod overrides;
mod params;
mod problem;
mod schema;
#[cfg(test)]
mod tests;

pub use check::check;
pub(crate) use check::check_wiring;
pub use draw::mermaid;
pub use problem::{GraphError, Problem};
pub use schema::schema;

use indexmap::IndexMap;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// How messages are delivered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// Nothing is lost: the source keeps a window of frames in flight and repeats what a death has swallowed.
    Replay,
    /// Newest wins: frames that come while the graph is busy are dropped and counted.
    Live,
}

/// A graph as its YAML file states it.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Graph {
    /// How messages are delivered.
    pub mode: Mode,
    /// Seed of everything random in the run.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// Frames in flight between the source and the slowest sink, 1 to 64.
    #[serde(default = "default_window")]
    #[schemars(range(min = 1, max = 64))]
    pub window: u64,
    /// How often a node that dies is started again before the run gives up. In a live graph the count begins anew when
    /// a node has lived for half a minute, and a node that ends with an error once it was ready is started again, too.
    #[serde(default = "default_restarts")]
    pub restarts: u32,
    /// How many seconds a node may be silent in a frame before it is killed and started again, at least 1; without: 120 in
    /// a live graph, 900 in a replay.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1))]
    pub frame_deadline_s: Option<u32>,
    /// The same for its start, where models are loaded and warmed up; without: 1800.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1))]
    pub start_deadline_s: Option<u32>,
    /// Outputs (`node/port`) whose way back to an earlier node's `latest` input is meant.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub feedback: Vec<PortRef>,
    /// Values that nodes use as `$name`; without a value where a run must give one.
    #[serde(default, skip_serializing_if = "IndexMap::is_empty")]
    #[schemars(with = "serde_json::Map<String, serde_json::Value>")]
    pub params: IndexMap<String, serde_yaml::Value>,
    /// The nodes by name.
    pub nodes: IndexMap<String, NodeSpec>,
    /// Where the graph was read from, for messages.
    #[serde(skip)]
    pub file: PathBuf,
}

/// One node of a graph.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NodeSpec {
    /// Which node it is: `player`, `flow`, ...
    pub kind: String,
    /// Input port: the output (`node/port`) that feeds it.
    #[serde(default, skip_serializing_if = "IndexMap::is_empty")]
    pub inputs: IndexMap<String, PortRef>,
    /// How much it stands back behind other processes of the computer, 0 to 19 (nice): more for what may take its time.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schemars(range(max = 19))]
    pub nice: u8,
    /// Threads of its own work (not of its inference engine, which `engine.threads` counts); without: as many as cores.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1, max = 256))]
    pub threads: Option<u16>,
    /// The kind's own configuration. Paths are relative to the working directory.
    #[serde(default = "empty_config")]
    #[schemars(with = "serde_json::Map<String, serde_json::Value>")]
    pub config: serde_yaml::Value,
}

/// An output of a node, written `node/port`.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String", into = "String")]
#[schemars(with = "String")]
pub struct PortRef {
    /// Name of the node.
    pub node: String,
    /// Name of its output.
    pub port: String,
}

fn is_zero(nice: &u8) -> bool {
    *nice == 0
}

fn default_seed() -> u64 {
    1
}

fn default_window() -> u64 {
    4
}

fn default_restarts() -> u32 {
    3
}

fn empty_config() -> serde_yaml::Value {
    serde_yaml::Value::Mapping(serde_yaml::Mapping::new())
}

impl Graph {
    /// Reads a graph from a file.
    ///
    /// # Errors
    /// When the file cannot be read, is no YAML, has unknown or missing keys, or a parameter that nothing uses.
    pub fn read(path: &Path) -> Result<Self, GraphError> {
        let text =
            std::fs::read_to_string(path).map_err(|source| GraphError::Read { file: path.to_owned(), source })?;
        Self::parse(&text, path)
    }

    /// Reads a graph from a text; `file` is the name that messages give it.
    ///
    /// # Errors
    /// As [`Graph::read`].
    pub fn parse(text: &str, file: &Path) -> Result<Self, GraphError> {
        let syntax = |source| GraphError::Syntax { file: file.to_owned(), source };
        let value: serde_yaml::Value = crate::yaml::from_str(text).map_err(syntax)?;
        let mut graph: Self = serde_path_to_error::deserialize(value).map_err(|error| GraphError::Shape {
            file: file.to_owned(),
            field: error.path().to_string(),
            source: error.into_inner(),
        })?;
        graph.file = file.to_owned();
        match graph.unused_params() {
            unused if unused.is_empty() => Ok(graph),
            unused => Err(GraphError::Problems(unused)),
        }
    }

    /// The graph as YAML, overrides included.
    ///
    /// # Errors
    /// When a configuration holds what YAML cannot.
    pub fn to_yaml(&self) -> Result<String, GraphError> {
        serde_yaml::to_string(self).map_err(|source| GraphError::Syntax { file: self.file.clone(), source })
    }
}

impl FromStr for PortRef {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once('/') {
            Some((node, port)) if !node.is_empty() && !port.is_empty() && !port.contains('/') => {
                Ok(Self { node: node.to_owned(), port: port.to_owned() })
            }
            _ => Err(format!("`{text}` names no output: write `node/port`, such as `player/frame`")),
        }
    }
}

impl TryFrom<String> for PortRef {
    type Error = String;
    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<PortRef> for String {
    fn from(port: PortRef) -> Self {
        port.to_string()
    }
}

impl fmt::Display for PortRef {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.node, self.port)
    }
}
