use std::fmt;
use std::path::PathBuf;

/// Why a graph could not be read.
#[derive(Debug, thiserror::Error)]
pub enum GraphError {
    /// The file itself.
    #[error("{}: cannot be read: {source}: check the path of the graph", file.display())]
    Read {
        /// The graph's file.
        file: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// Not YAML.
    #[error("{}: no valid YAML: {source}", file.display())]
    Syntax {
        /// The graph's file.
        file: PathBuf,
        /// Line, column and cause.
        source: serde_yaml::Error,
    },
    /// YAML, but not of a graph's shape.
    #[error("{}: field `{field}`: {source}", file.display())]
    Shape {
        /// The graph's file.
        file: PathBuf,
        /// Path of the field, such as `nodes.flow.inputs`.
        field: String,
        /// Cause, with the keys that are known there.
        source: serde_yaml::Error,
    },
    /// An override from the command line that cannot be applied.
    #[error("override `{key}={value}`: {cause}")]
    Override {
        /// Dotted key.
        key: String,
        /// Value as given.
        value: String,
        /// What is wrong and what to write instead.
        cause: String,
    },
    /// The graph reads well but would not run.
    #[error("{}", list(.0))]
    Problems(Vec<Problem>),
}

fn list(problems: &[Problem]) -> String {
    problems.iter().map(Problem::to_string).collect::<Vec<_>>().join("\n")
}

/// One thing that keeps a graph from running.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// The graph's file.
    pub file: PathBuf,
    /// The node, where it is one node's problem.
    pub node: Option<String>,
    /// The field within the node (or the graph), such as `inputs.views` or `config.bag`.
    pub field: String,
    /// What is wrong.
    pub what: String,
    /// What to do; empty where `what` says it.
    pub remedy: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: ", self.file.display())?;
        if let Some(node) = &self.node {
            write!(f, "node `{node}`: ")?;
        }
        write!(f, "`{}`: {}", self.field, self.what)?;
        if !self.remedy.is_empty() {
            write!(f, ": {}", self.remedy)?;
        }
        Ok(())
    }
}
