use super::{Graph, Mode, Problem};
use crate::plan::{Edge, Wiring};
use crate::{PortSpec, Registry, Role};

/// Checks everything that can be known before a process starts.
///
/// # Errors
/// All problems that were found, each with file, node, field and remedy.
pub fn check(graph: &Graph, registry: &Registry) -> Result<(), Vec<Problem>> {
    let graph = graph.resolved()?;
    let mut check = Check::of_wiring(&graph, registry);
    check.configurations();
    check.result()
}

/// As [`check`], but leaves the configurations alone: whoever starts one node of a checked graph has no need to
/// look at the files of all others.
pub(crate) fn check_wiring(graph: &Graph, registry: &Registry) -> Result<(), Vec<Problem>> {
    Check::of_wiring(graph, registry).result()
}

struct Check<'a> {
    wiring: Wiring<'a>,
    problems: Vec<Problem>,
}

impl<'a> Check<'a> {
    fn of_wiring(graph: &'a Graph, registry: &'a Registry) -> Self {
        let mut check = Self { wiring: Wiring::new(graph, registry), problems: Vec::new() };
        check.values();
        check.names_and_kinds(registry);
        check.inputs();
        check.message_types();
        check.sources();
        check.ends();
        check.feedback();
        check.cycles();
        check
    }

    fn result(self) -> Result<(), Vec<Problem>> {
        if self.problems.is_empty() { Ok(()) } else { Err(self.problems) }
    }

    fn report(&mut self, node: Option<usize>, field: &str, what: String, remedy: String) {
        self.problems.push(Problem {
            file: self.wiring.graph.file.clone(),
            node: node.map(|node| self.wiring.nodes[node].name.to_owned()),
            field: field.to_owned(),
            what,
            remedy,
        });
    }

    fn values(&mut self) {
        let Graph { window, frame_deadline_s, start_deadline_s, .. } = *self.wiring.graph;
        for (key, value) in [("frame_deadline_s", frame_deadline_s), ("start_deadline_s", start_deadline_s)] {
            if value == Some(0) {
                self.report(None, key, "0 is out of range".into(), "take at least 1, or leave it out".into());
            }
        }
        if !(1..=64).contains(&window) {
            self.report(None, "window", format!("{window} is out of range"), "take 1 to 64 frames in flight".into());
        }
    }

    fn names_and_kinds(&mut self, registry: &Registry) {
        let known: Vec<&str> = registry.names().collect();
        for i in 0..self.wiring.nodes.len() {
            let (name, kind) = (self.wiring.nodes[i].name, &self.wiring.nodes[i].spec.kind);
            let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
            if name.is_empty() || name.len() > 40 || !name.chars().all(plain) {
                let remedy = "take 1 to 40 letters, digits, `_` or `-`".to_owned();
                self.report(Some(i), "name", "not a name that services and folders can carry".into(), remedy);
            }
            if self.wiring.nodes[i].kind.is_none() {
                let remedy = registry.remedy(kind).map_or_else(|| one_of(&known), str::to_owned);
                self.report(Some(i), "kind", format!("no kind of node is called `{kind}`"), remedy);
            }
            let (nice, threads) = (self.wiring.nodes[i].spec.nice, self.wiring.nodes[i].spec.threads);
            if nice > 19 {
                self.report(Some(i), "nice", format!("{nice} is out of range"), "take 0 (not at all) to 19".into());
            }
            if threads.is_some_and(|threads| !(1..=256).contains(&threads)) {
                let remedy = "take 1 to 256, or leave it out for all cores".to_owned();
                self.report(Some(i), "threads", format!("{} is out of range", threads.unwrap_or(0)), remedy);
            }
        }
    }

    fn inputs(&mut self) {
        for i in 0..self.wiring.nodes.len() {
            let Some(kind) = self.wiring.nodes[i].kind else { continue };
            let spec = self.wiring.nodes[i].spec;
            let ports: Vec<&str> = kind.inputs.iter().map(|port| port.name).collect();
            for (port, output) in &spec.inputs {
                if !ports.contains(&port.as_str()) {
                    let what = format!("`{}` has no such input", kind.name);
                    self.report(Some(i), &format!("inputs.{port}"), what, one_of(&ports));
                }
                self.producer(i, port, output);
            }
            let needed = (kind.needs)(&spec.config);
            let needs = |port: &PortSpec| port.required || needed.contains(&port.name);
            for port in kind.inputs.iter().filter(|p| needs(p) && !spec.inputs.contains_key(p.name)) {
                let what = format!("required input ({}) without a producer", port.message);
                let remedy = format!("connect it: `{}: node/port`{}", port.name, self.offers(port.message));
                self.report(Some(i), &format!("inputs.{}", port.name), what, remedy);
            }
            let joins = kind.inputs.iter().any(|p| !p.latest && spec.inputs.contains_key(p.name));
            if !joins && !self.wiring.is_source(i) && kind.inputs.iter().all(|p| p.latest || !p.required) {
                let what = "no input gives it frames".to_owned();
                self.report(Some(i), "inputs", what, format!("connect at least one of: {}", ports.join(", ")));
            }
        }
    }

    fn producer(&mut self, node: usize, port: &str, output: &super::PortRef) {
        let field = format!("inputs.{port}");
        let names: Vec<&str> = self.wiring.nodes.iter().map(|n| n.name).collect();
        let Some(from) = self.wiring.position(&output.node) else {
            let what = format!("producer `{output}`: there is no node `{}`", output.node);
            return self.report(Some(node), &field, what, one_of(&names));
        };
        let Some(kind) = self.wiring.nodes[from].kind else { return };
        if self.wiring.output(from, &output.port).is_none() {
            let outputs: Vec<&str> = kind.outputs.iter().map(|port| port.name).collect();
            let what = format!("producer `{output}`: `{}` has no output `{}`", kind.name, output.port);
            self.report(Some(node), &field, what, one_of(&outputs));
        }
    }

    /// `, such as player/frame`: outputs of the graph that carry a message.
    fn offers(&self, message: &str) -> String {
        let offers = self.wiring.nodes.iter().flat_map(|node| {
            let outputs = node.kind.map(|kind| kind.outputs.as_slice()).unwrap_or_default();
            outputs.iter().filter(|p| p.message == message).map(|p| format!("{}/{}", node.name, p.name))
        });
        let offers: Vec<String> = offers.collect();
        if offers.is_empty() { String::new() } else { format!(", such as {}", offers.join(" or ")) }
    }

    fn message_types(&mut self) {
        for edge in self.wiring.edges() {
            if edge.input.message != edge.sends.message {
                let what = format!("takes {}, but `{}` sends {}", edge.input.message, edge.output, edge.sends.message);
                let offers = self.offers(edge.input.message);
                let remedy = format!("connect an output of {}{offers}", edge.input.message);
                self.report(Some(edge.to), &format!("inputs.{}", edge.input.name), what, remedy);
            }
        }
    }

    fn sources(&mut self) {
        let sources: Vec<usize> = self.wiring.sources().collect();
        if sources.is_empty() && self.wiring.nodes.iter().all(|n| n.kind.is_some()) {
            let remedy = "add a node that makes frames, such as a player or a camera".to_owned();
            self.report(None, "nodes", "no node is a source".into(), remedy);
        }
        for extra in sources.iter().skip(1) {
            let what = format!("a second source beside `{}`", self.wiring.nodes[sources[0]].name);
            self.report(Some(*extra), "kind", what, "keep one: frames are counted by one source".into());
        }
        for i in sources {
            let live_source = self.wiring.nodes[i].kind.is_some_and(|kind| kind.role == Role::LiveSource);
            if live_source && self.wiring.graph.mode == Mode::Replay {
                let what = "a live source cannot repeat a frame, which replay needs".to_owned();
                self.report(Some(i), "kind", what, "set `mode: live`, or take frames from a player".into());
            }
        }
    }

    fn ends(&mut self) {
        if self.wiring.nodes.iter().any(|node| node.kind.is_none()) {
            return;
        }
        if !(0..self.wiring.nodes.len()).any(|i| self.wiring.acknowledges(i)) {
            let remedy = "add a node that keeps or publishes results, such as a recorder".to_owned();
            self.report(None, "nodes", "no node is a sink".into(), remedy);
        }
        for i in 0..self.wiring.nodes.len() {
            let Some(kind) = self.wiring.nodes[i].kind else { continue };
            let sends = kind.role != Role::Sink && !self.wiring.acknowledges(i);
            if sends && !self.wiring.feeds_somebody(i) {
                let outputs: Vec<&str> = kind.outputs.iter().map(|port| port.name).collect();
                let remedy = format!("connect one of its outputs ({}) or remove the node", outputs.join(", "));
                self.report(Some(i), "outputs", "nothing takes what it makes".into(), remedy);
            }
        }
    }

    fn feedback(&mut self) {
        let edges = self.wiring.edges();
        let graph = self.wiring.graph;
        for output in &graph.feedback {
            let taken: Vec<&Edge> = edges.iter().filter(|edge| edge.output == output).collect();
            if taken.is_empty() {
                let what = format!("`{output}` feeds no input");
                self.report(None, "feedback", what, "remove it, or connect the output".into());
            }
            let back: Vec<&&Edge> = taken.iter().filter(|edge| edge.input.latest).collect();
            if back.is_empty() && !taken.is_empty() {
                let what = format!("`{output}` goes only to inputs that wait for its frame");
                let remedy = "feedback can only go to an input that takes the latest message".to_owned();
                self.report(None, "feedback", what, remedy);
            } else if !back.is_empty() && !back.iter().any(|edge| self.reaches(edge.to, edge.from, &edges)) {
                let what = format!("`{output}` closes no cycle");
                self.report(None, "feedback", what, "remove it from `feedback`".into());
            }
        }
    }

    fn reaches(&self, from: usize, to: usize, edges: &[Edge]) -> bool {
        let mut seen = vec![false; self.wiring.nodes.len()];
        let mut open = vec![from];
        while let Some(node) = open.pop() {
            if node == to {
                return true;
            }
            if !std::mem::replace(&mut seen[node], true) {
                open.extend(edges.iter().filter(|e| e.from == node && self.gates(e)).map(|e| e.to));
            }
        }
        false
    }

    /// Whether the consumer's output depends on this edge within a frame. What a source takes in ends there.
    fn gates(&self, edge: &Edge) -> bool {
        !self.wiring.is_source(edge.to) && !self.wiring.is_feedback(edge)
    }

    /// Takes away nodes that nothing waits for until only cycles are left, then names one.
    fn cycles(&mut self) {
        let edges: Vec<Edge> = self.wiring.edges().into_iter().filter(|edge| self.gates(edge)).collect();
        let mut left: Vec<bool> = vec![true; self.wiring.nodes.len()];
        let waits = |node: usize, left: &[bool]| edges.iter().any(|e| e.to == node && left[e.from]);
        while let Some(free) = (0..left.len()).find(|i| left[*i] && !waits(*i, &left)) {
            left[free] = false;
        }
        let Some(start) = left.iter().position(|left| *left) else { return };
        let mut path = vec![start];
        // Backwards from producer to producer, until a node comes up again.
        loop {
            let here = path[path.len() - 1];
            let Some(back) = edges.iter().find(|e| e.to == here && left[e.from]) else { return };
            if let Some(at) = path.iter().position(|node| *node == back.from) {
                path.drain(..at);
                break;
            }
            path.push(back.from);
        }
        path.reverse();
        path.push(path[0]);
        let names: Vec<&str> = path.iter().map(|node| self.wiring.nodes[*node].name).collect();
        let remedy = "break it, or declare the way back: `feedback: [node/port]` to a `latest` input".to_owned();
        self.report(Some(path[0]), "inputs", format!("waits for itself: {}", names.join(" -> ")), remedy);
    }

    fn configurations(&mut self) {
        for i in 0..self.wiring.nodes.len() {
            let Some(kind) = self.wiring.nodes[i].kind else { continue };
            if let Err(error) = (kind.check)(&self.wiring.nodes[i].spec.config) {
                self.report(Some(i), &error.field, error.what, String::new());
            }
        }
    }
}

fn one_of(names: &[&str]) -> String {
    if names.is_empty() {
        "there is none to choose from".to_owned()
    } else {
        format!("take one of: {}", names.join(", "))
    }
}
