use crate::local::{self, HeldNode};
use crate::runner::{self, RunError};
use crate::{Node, PortSpec, Role};
use indexmap::IndexMap;
use serde_yaml::Value;
use std::path::Path;

/// The kinds of nodes that graphs may name. The binary fills it: `Registry::new().with::<Player>()`.
#[derive(Debug, Default, Clone)]
pub struct Registry {
    kinds: IndexMap<&'static str, Kind>,
    /// Kinds that this binary could have, and how to get them.
    absent: IndexMap<&'static str, &'static str>,
}

/// A node type without its type.
#[derive(Debug, Clone)]
pub(crate) struct Kind {
    pub(crate) name: &'static str,
    pub(crate) position: usize,
    pub(crate) role: Role,
    pub(crate) inputs: Vec<PortSpec>,
    pub(crate) outputs: Vec<PortSpec>,
    pub(crate) schema: fn() -> serde_json::Value,
    pub(crate) check: fn(&Value) -> Result<(), ConfigError>,
    /// Optional inputs that a configuration needs; none of one that cannot be read.
    pub(crate) needs: fn(&Value) -> Vec<&'static str>,
    pub(crate) run: fn(&runner::Launch) -> Result<(), RunError>,
    /// Makes the node to be held in this process.
    pub(crate) hold: Hold,
}

type Hold = fn(&Value, &crate::Context) -> Result<Box<dyn HeldNode>, (String, String)>;

/// A configuration that a node cannot take.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ConfigError {
    /// Path within the graph's node: `config` or `config.some.key`.
    pub(crate) field: String,
    pub(crate) what: String,
}

impl Registry {
    /// A registry without kinds.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a kind. A kind of the same name is replaced.
    pub fn add<N: Node + 'static>(&mut self) -> &mut Self {
        let position = self.kinds.get_index_of(N::KIND).unwrap_or(self.kinds.len());
        let kind = Kind {
            name: N::KIND,
            position,
            role: N::ROLE,
            inputs: N::inputs(),
            outputs: N::outputs(),
            schema: || schemars::schema_for!(N::Config).to_value(),
            check: |value| check_config::<N>(value),
            needs: |value| read_config::<N>(value).map_or_else(|_| Vec::new(), |config| N::needs(&config)),
            run: runner::run::<N>,
            hold: local::hold::<N>,
        };
        self.kinds.insert(N::KIND, kind);
        self
    }

    /// As [`Registry::add`], to be chained.
    #[must_use]
    pub fn with<N: Node + 'static>(mut self) -> Self {
        self.add::<N>();
        self
    }

    /// Says of a kind that this binary was built without how to get it, for the message about a graph that names it.
    #[must_use]
    pub fn without(mut self, kind: &'static str, remedy: &'static str) -> Self {
        self.absent.insert(kind, remedy);
        self
    }

    /// Names of the kinds, in the order in which they were added.
    pub fn names(&self) -> impl Iterator<Item = &'static str> + '_ {
        self.kinds.keys().copied()
    }

    /// Runs one node of a graph in this process until the run ends: the body of `pseudoflow node`. The supervisor
    /// calls it with the graph and folder of its run.
    ///
    /// # Errors
    /// Whatever ended the node; the supervisor reports it.
    pub fn run_node(&self, name: &str, graph: &Path, run_dir: &Path) -> Result<(), RunError> {
        runner::run_node(self, name, graph, run_dir)
    }

    pub(crate) fn kinds(&self) -> impl Iterator<Item = &Kind> {
        self.kinds.values()
    }

    /// What [`Self::without`] said of a kind.
    pub(crate) fn remedy(&self, kind: &str) -> Option<&'static str> {
        self.absent.get(kind).copied()
    }

    pub(crate) fn kind(&self, name: &str) -> Option<&Kind> {
        self.kinds.get(name)
    }
}

/// Reads a configuration into its type.
pub(crate) fn read_config<N: Node>(value: &Value) -> Result<N::Config, ConfigError> {
    let value = if value.is_null() { &Value::Mapping(serde_yaml::Mapping::new()) } else { value };
    serde_path_to_error::deserialize(value).map_err(|error| {
        let path = error.path().to_string();
        let field = if path == "." { "config".to_owned() } else { format!("config.{path}") };
        ConfigError { field, what: error.into_inner().to_string() }
    })
}

fn check_config<N: Node>(value: &Value) -> Result<(), ConfigError> {
    let config = read_config::<N>(value)?;
    N::check(&config).map_err(|error| ConfigError { field: "config".to_owned(), what: crate::error::chain(&*error) })
}
