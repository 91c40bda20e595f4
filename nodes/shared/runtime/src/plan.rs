use crate::graph::{Graph, GraphError, Mode, PortRef};
use crate::registry::{Kind, Registry};
use crate::{PortSpec, Role};

/// A checked graph with every name resolved: who feeds whom, who begins, who acknowledges.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    pub(crate) mode: Mode,
    pub(crate) seed: u64,
    pub(crate) window: u64,
    pub(crate) restarts: u32,
    /// Seconds that a node may be silent in a frame, and in its start.
    pub(crate) deadlines_s: [u32; 2],
    /// In the graph's order; the position is the node's id in the run.
    pub(crate) nodes: Vec<PlannedNode>,
    /// Position of the one source.
    pub(crate) source: usize,
}

#[derive(Debug, Clone)]
pub(crate) struct PlannedNode {
    pub(crate) name: String,
    pub(crate) config: serde_yaml::Value,
    pub(crate) kind: Kind,
    /// How much its process stands back.
    pub(crate) nice: u8,
    /// Threads of its own work.
    pub(crate) threads: Option<u16>,
    /// Whether a frame is done only when this node has handled it: the end of a line.
    pub(crate) acknowledges: bool,
    pub(crate) inputs: Vec<PlannedInput>,
    pub(crate) outputs: Vec<PlannedOutput>,
}

#[derive(Debug, Clone)]
pub(crate) struct PlannedInput {
    pub(crate) port: &'static str,
    pub(crate) producer: usize,
    /// The producer's port.
    pub(crate) output: String,
    pub(crate) latest: bool,
    /// As [`PortSpec::queued`].
    pub(crate) queued: bool,
}

#[derive(Debug, Clone)]
pub(crate) struct PlannedOutput {
    pub(crate) port: &'static str,
    /// Nodes that join it by frame.
    pub(crate) joined_by: Vec<usize>,
    /// Nodes that take the newest only.
    pub(crate) latest_of: Vec<usize>,
}

impl PlannedNode {
    /// The producers of its inputs that are joined by frame.
    fn joined_producers(&self) -> impl Iterator<Item = usize> + '_ {
        self.inputs.iter().filter(|input| !input.latest).map(|input| input.producer)
    }
}

impl PlannedOutput {
    pub(crate) fn is_connected(&self) -> bool {
        !(self.joined_by.is_empty() && self.latest_of.is_empty())
    }
}

impl Plan {
    /// Resolves a graph, its parameters too, after checking its wiring (not the nodes' configurations).
    pub(crate) fn new(graph: &Graph, registry: &Registry) -> Result<Self, GraphError> {
        let graph = &graph.resolved().map_err(GraphError::Problems)?;
        crate::graph::check_wiring(graph, registry).map_err(GraphError::Problems)?;
        let wiring = Wiring::new(graph, registry);
        let nodes: Vec<_> = wiring.nodes.iter().enumerate().map(|(i, _)| wiring.plan(i)).collect();
        let source = wiring.sources().next().unwrap_or(0);
        let frame_s = graph.frame_deadline_s.unwrap_or(if graph.mode == Mode::Live { 120 } else { 900 });
        let deadlines_s = [frame_s, graph.start_deadline_s.unwrap_or(1800)];
        let Graph { mode, seed, window, restarts, .. } = *graph;
        Ok(Self { mode, seed, window, restarts, deadlines_s, nodes, source })
    }

    pub(crate) fn position(&self, name: &str) -> Option<usize> {
        self.nodes.iter().position(|node| node.name == name)
    }

    pub(crate) fn replay(&self) -> bool {
        self.mode == Mode::Replay
    }

    /// Positions of the nodes whose acknowledgement a frame needs.
    pub(crate) fn acknowledgers(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.nodes.len()).filter(|i| self.nodes[*i].acknowledges)
    }

    /// Nodes that take anything from this one.
    pub(crate) fn consumers(&self, node: usize) -> Vec<usize> {
        let outputs = self.nodes[node].outputs.iter();
        sorted(outputs.flat_map(|o| o.joined_by.iter().chain(&o.latest_of)).copied().collect())
    }

    /// Whether somebody must hear that this node has given a frame up: who joins its messages, or what was made of them, with those of
    /// others would wait for it, and who acknowledges frames would not. Of frames that nobody else knows of nothing need be said: where
    /// most are left out, the news of them would push aside what is not read at once.
    pub(crate) fn must_tell_voids(&self, node: usize) -> bool {
        let derived = self.derived_from(node);
        self.nodes.iter().any(|other| {
            let joined: Vec<bool> = other.joined_producers().map(|producer| derived[producer]).collect();
            joined.contains(&true) && (other.acknowledges || joined.contains(&false))
        })
    }

    /// A node, and those all of whose joined inputs come from these: they handle no frame of which it has sent nothing.
    fn derived_from(&self, node: usize) -> Vec<bool> {
        let mut derived: Vec<bool> = (0..self.nodes.len()).map(|i| i == node).collect();
        // A node's producers may come after it.
        for _ in &self.nodes {
            for i in (0..self.nodes.len()).filter(|i| *i != self.source && *i != node) {
                let mut joined = self.nodes[i].joined_producers().peekable();
                derived[i] = joined.peek().is_some() && joined.all(|producer| derived[producer]);
            }
        }
        derived
    }

    /// Nodes that this one takes anything from.
    pub(crate) fn producers(&self, node: usize) -> Vec<usize> {
        sorted(self.nodes[node].inputs.iter().map(|input| input.producer).collect())
    }
}

fn sorted(mut nodes: Vec<usize>) -> Vec<usize> {
    nodes.sort_unstable();
    nodes.dedup();
    nodes
}

/// A graph beside its kinds, as far as names resolve: what the check and the plan both look at.
pub(crate) struct Wiring<'a> {
    pub(crate) graph: &'a Graph,
    pub(crate) nodes: Vec<WiredNode<'a>>,
}

pub(crate) struct WiredNode<'a> {
    pub(crate) name: &'a str,
    pub(crate) spec: &'a crate::graph::NodeSpec,
    /// `None` when the kind is unknown.
    pub(crate) kind: Option<&'a Kind>,
}

/// One input line of a graph of which both ends exist.
#[derive(Clone, Copy)]
pub(crate) struct Edge<'a> {
    pub(crate) from: usize,
    pub(crate) to: usize,
    pub(crate) output: &'a PortRef,
    pub(crate) input: &'a PortSpec,
    pub(crate) sends: &'a PortSpec,
}

impl<'a> Wiring<'a> {
    pub(crate) fn new(graph: &'a Graph, registry: &'a Registry) -> Self {
        let wire = |(name, spec): (&'a String, &'a crate::graph::NodeSpec)| WiredNode {
            name,
            spec,
            kind: registry.kind(&spec.kind),
        };
        Self { graph, nodes: graph.nodes.iter().map(wire).collect() }
    }

    pub(crate) fn position(&self, name: &str) -> Option<usize> {
        self.nodes.iter().position(|node| node.name == name)
    }

    /// All edges whose both ends resolve.
    pub(crate) fn edges(&self) -> Vec<Edge<'a>> {
        let mut edges = Vec::new();
        for (to, node) in self.nodes.iter().enumerate() {
            for (port, output) in &node.spec.inputs {
                let input = node.kind.and_then(|kind| kind.inputs.iter().find(|p| p.name == port));
                let from = self.position(&output.node);
                let sends = from.and_then(|from| self.output(from, &output.port));
                if let (Some(input), Some(from), Some(sends)) = (input, from, sends) {
                    edges.push(Edge { from, to, output, input, sends });
                }
            }
        }
        edges
    }

    pub(crate) fn output(&self, node: usize, port: &str) -> Option<&'a PortSpec> {
        self.nodes[node].kind?.outputs.iter().find(|p| p.name == port)
    }

    /// Nodes that begin frames: of a source's role, unless the graph uses only their inputs (a bridge that
    /// publishes what a player began).
    pub(crate) fn sources(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.nodes.len()).filter(|i| self.is_source(*i))
    }

    pub(crate) fn is_source(&self, node: usize) -> bool {
        let has_role = self.nodes[node].kind.is_some_and(|k| matches!(k.role, Role::ReplaySource | Role::LiveSource));
        has_role && (self.nodes[node].spec.inputs.is_empty() || self.feeds_somebody(node))
    }

    pub(crate) fn feeds_somebody(&self, node: usize) -> bool {
        let name = self.nodes[node].name;
        self.nodes.iter().any(|other| other.spec.inputs.values().any(|output| output.node == name))
    }

    /// Whether a node ends a line: a sink, a source that also takes inputs, or a transform all of whose outputs
    /// only go back by feedback edges.
    pub(crate) fn acknowledges(&self, node: usize) -> bool {
        let Some(kind) = self.nodes[node].kind else { return false };
        let edges = self.edges();
        let joins = edges.iter().any(|edge| edge.to == node && !edge.input.latest);
        let ends = match kind.role {
            Role::Sink | Role::ReplaySource | Role::LiveSource => true,
            Role::Transform => {
                let mut out = edges.iter().filter(|edge| edge.from == node).peekable();
                // In live mode nobody waits for what may come at any time.
                let late = |edge: &Edge| edge.input.queued && self.graph.mode == Mode::Live;
                out.peek().is_some() && out.all(|edge| self.is_feedback(edge) && !late(edge))
            }
        };
        joins && ends
    }

    /// Whether an edge is declared to lead back; edges from the same output to joined inputs lead on.
    pub(crate) fn is_feedback(&self, edge: &Edge) -> bool {
        edge.input.latest && self.graph.feedback.contains(edge.output)
    }

    fn plan(&self, node: usize) -> PlannedNode {
        let wired = &self.nodes[node];
        // The check has made sure that the kind exists.
        let kind = wired.kind.cloned().unwrap_or_else(|| unreachable!("checked graphs have known kinds"));
        let edges = self.edges();
        let inputs = edges.iter().filter(|edge| edge.to == node).map(|edge| PlannedInput {
            port: edge.input.name,
            producer: edge.from,
            output: edge.output.port.clone(),
            latest: edge.input.latest,
            queued: edge.input.queued,
        });
        let to = |port: &PortSpec, latest: bool| {
            let goes = |e: &&Edge| e.from == node && e.sends.name == port.name && e.input.latest == latest;
            edges.iter().filter(goes).map(|edge| edge.to).collect()
        };
        let outputs = kind.outputs.iter().map(|port| PlannedOutput {
            port: port.name,
            joined_by: to(port, false),
            latest_of: to(port, true),
        });
        PlannedNode {
            name: wired.name.to_owned(),
            config: wired.spec.config.clone(),
            nice: wired.spec.nice,
            threads: wired.spec.threads,
            acknowledges: self.acknowledges(node),
            inputs: inputs.collect(),
            outputs: outputs.collect(),
            kind,
        }
    }
}
