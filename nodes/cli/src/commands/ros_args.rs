//! `--ros-args ... [--]`, as launch files and `ros2 run` give them: what ROS 2 calls parameters are the graph's `NODE.KEY` settings,
//! the rest concerns the bridge. What matches nothing is one line in the log, and the run goes on.
//!
//! Accepted: `-r FROM:=TO` (also `__ns`, `__node`, `__name`, each with `NODE:` in front), `-p NAME:=VALUE`, `--params-file`,
//! `--log-level [NAME:=]LEVEL`. `--enclave`, `--log-config-file` and the switches of ROS 2's log outputs say that they do nothing.

use anyhow::{Context as _, Result, bail};
use pseudoflow_runtime::Graph;
use serde_yaml::Value;
use std::path::{Path, PathBuf};

/// What stood behind `--ros-args`.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct RosArgs {
    /// Of `-r`, in order; node name in front, if any.
    remap: Vec<Rule>,
    parameters: Vec<(String, String)>,
    files: Vec<PathBuf>,
    /// Levels of `--log-level`, as `env_logger` writes them.
    pub(crate) log_level: Option<String>,
    /// Lines about what does nothing.
    ignored: Vec<String>,
}

#[derive(Debug, Clone, PartialEq)]
struct Rule {
    node: Option<String>,
    from: String,
    to: String,
}

/// Parts the command line: what is ours, and what stands between `--ros-args` and `--` (or the end).
pub(crate) fn split(arguments: impl Iterator<Item = String>) -> (Vec<String>, Vec<String>) {
    let (mut ours, mut ros, mut inside) = (Vec::new(), Vec::new(), false);
    for argument in arguments {
        match argument.as_str() {
            "--ros-args" => inside = true,
            "--" if inside => inside = false,
            _ if inside => ros.push(argument),
            _ => ours.push(argument),
        }
    }
    (ours, ros)
}

impl RosArgs {
    /// Reads what [`split`] found.
    ///
    /// # Errors
    /// When an argument lacks its value or is not written as ROS 2 wants it.
    pub(crate) fn parse(arguments: &[String]) -> Result<Self> {
        let mut args = Self::default();
        let mut rest = arguments.iter();
        while let Some(argument) = rest.next() {
            let mut value = || rest.next().with_context(|| format!("`--ros-args {argument}`: the value is missing"));
            match argument.as_str() {
                "-r" | "--remap" => args.remap.push(rule(value()?)?),
                "-p" | "--param" => args.parameters.push(assignment(argument, value()?)?),
                "--params-file" => args.files.push(value()?.into()),
                "--log-level" => args.log_level = Some(log_level(value()?)?),
                "-e" | "--enclave" | "--log-config-file" | "--log-file-name" => {
                    args.ignored.push(format!("{argument} {}", value()?));
                }
                known if known.ends_with("-logs") && known.starts_with("--") => args.ignored.push(known.to_owned()),
                unknown => bail!(
                    "`--ros-args {unknown}`: unknown; known are -r, -p, --params-file and --log-level (`--` ends them)"
                ),
            }
        }
        Ok(args)
    }

    /// Changes a graph as the arguments ask for.
    ///
    /// # Errors
    /// When a parameter file cannot be read, or a parameter names what the graph does not have.
    pub(crate) fn apply(&self, graph: &mut Graph) -> Result<()> {
        for ignored in &self.ignored {
            log::warn!("--ros-args {ignored}: does nothing here");
        }
        let bridge = graph.nodes.iter().find(|(_, node)| node.kind == "bridge").map(|(name, _)| name.clone());
        let Some(bridge) = bridge else {
            if *self != Self::default() {
                log::warn!("--ros-args: the graph has no bridge, so nothing of it is on ROS 2: only parameters count");
            }
            return self.set_parameters(graph, None, &NodeName::default());
        };
        let name = self.rename(graph, &bridge)?;
        for rule in self.remap.iter().filter(|rule| !rule.from.starts_with("__")) {
            if rule.node.as_ref().is_some_and(|node| *node != name.base) {
                log::warn!("--ros-args -r: no node is called `{}`", rule.node.as_deref().unwrap_or_default());
            } else {
                set(graph, &bridge, &["remap", &rule.from], rule.to.clone().into())?;
            }
        }
        self.set_parameters(graph, Some(&bridge), &name)
    }

    /// `__ns` and `__node`; the names that hold then.
    fn rename(&self, graph: &mut Graph, bridge: &str) -> Result<NodeName> {
        let text =
            |graph: &Graph, key: &str| graph.nodes[bridge].config.get(key).and_then(Value::as_str).map(str::to_owned);
        let mut name = NodeName {
            base: text(graph, "node_name").unwrap_or_else(|| "pseudoflow".to_owned()),
            namespace: text(graph, "namespace").unwrap_or_else(|| "/".to_owned()),
        };
        for rule in self.remap.iter().filter(|rule| rule.from.starts_with("__")) {
            match rule.from.as_str() {
                "__ns" => {
                    name.namespace = rule.to.clone();
                    set(graph, bridge, &["namespace"], rule.to.clone().into())?;
                }
                "__node" | "__name" => {
                    name.base = rule.to.clone();
                    set(graph, bridge, &["node_name"], rule.to.clone().into())?;
                }
                unknown => log::warn!("--ros-args -r {unknown}:={}: matches nothing", rule.to),
            }
        }
        Ok(name)
    }

    fn set_parameters(&self, graph: &mut Graph, bridge: Option<&str>, name: &NodeName) -> Result<()> {
        for file in &self.files {
            let parameters = read_file(file, name)?;
            if parameters.is_empty() {
                log::warn!("{}: no parameters for {}", file.display(), name.full());
            }
            for (key, value) in parameters {
                set_parameter(graph, bridge, &key, value)?;
            }
        }
        for (key, text) in &self.parameters {
            let value = serde_yaml::from_str(text).with_context(|| format!("`-p {key}:={text}`: no YAML"))?;
            set_parameter(graph, bridge, key, value)?;
        }
        Ok(())
    }
}

#[derive(Debug, Default)]
struct NodeName {
    namespace: String,
    base: String,
}

impl NodeName {
    fn full(&self) -> String {
        format!("/{}/{}", self.namespace.trim_matches('/'), self.base).replace("//", "/")
    }

    /// Whether a key of a parameter file means this node: `/**`, `**`, `/*/name`, `name`, `/ns/name`, `/**/name`.
    fn is_meant_by(&self, pattern: &str) -> bool {
        let full = self.full();
        let parts: Vec<&str> = full.split('/').filter(|part| !part.is_empty()).collect();
        let pattern: Vec<&str> = pattern.split('/').filter(|part| !part.is_empty()).collect();
        matches(&pattern, &parts)
    }
}

fn matches(pattern: &[&str], parts: &[&str]) -> bool {
    match (pattern.split_first(), parts.split_first()) {
        (None, rest) => rest.is_none(),
        (Some((&"**", after)), None) => matches(after, &[]),
        (Some((&"**", after)), Some((_, rest))) => matches(after, parts) || matches(pattern, rest),
        (Some((part, after)), Some((own, rest))) => (*part == "*" || part == own) && matches(after, rest),
        (Some(_), None) => false,
    }
}

/// The parameters that a file has for a node, nested keys joined by points: those of `qos_overrides` keep their topic whole.
fn read_file(path: &Path, name: &NodeName) -> Result<Vec<(String, Value)>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("--params-file {}", path.display()))?;
    let file: Value = serde_yaml::from_str(&text).with_context(|| format!("--params-file {}", path.display()))?;
    let nodes = file.as_mapping().with_context(|| format!("{}: no mapping of nodes", path.display()))?;
    let mut found = Vec::new();
    gather_nodes(nodes, "", name, &mut found);
    Ok(found)
}

/// Nodes may be nested by namespace: `/left: {pseudoflow: {ros__parameters: ...}}`.
fn gather_nodes(nodes: &serde_yaml::Mapping, above: &str, name: &NodeName, found: &mut Vec<(String, Value)>) {
    for (key, value) in nodes {
        let (Some(key), Some(inside)) = (key.as_str(), value.as_mapping()) else { continue };
        let pattern = format!("{above}/{}", key.trim_start_matches('/'));
        // A name without a slash means the node in any namespace.
        let anywhere = above.is_empty() && !key.contains('/') && key == name.base;
        match inside.get("ros__parameters") {
            Some(parameters) if anywhere || name.is_meant_by(&pattern) => flatten("", parameters, found),
            Some(_) => {}
            None => gather_nodes(inside, &pattern, name, found),
        }
    }
}

fn flatten(above: &str, value: &Value, found: &mut Vec<(String, Value)>) {
    match value.as_mapping() {
        Some(nested) if !nested.is_empty() => {
            for (key, value) in nested {
                let key = key.as_str().map_or_else(|| serde_yaml::to_string(key).unwrap_or_default(), str::to_owned);
                let joined = if above.is_empty() { key } else { format!("{above}.{key}") };
                flatten(&joined, value, found);
            }
        }
        _ => found.push((above.to_owned(), value.clone())),
    }
}

/// A parameter is a setting of the graph (`renderer.size_px`, `window`); one that names no node of it is the bridge's.
fn set_parameter(graph: &mut Graph, bridge: Option<&str>, key: &str, value: Value) -> Result<()> {
    if key == "use_sim_time" {
        log::warn!("parameter use_sim_time: stamps are those of the images, no clock is read");
        return Ok(());
    }
    if let (Some(rest), Some(bridge)) = (key.strip_prefix("qos_overrides."), bridge) {
        // qos_overrides.TOPIC.publisher.depth: topics have no points.
        let path: Vec<&str> = std::iter::once("qos_overrides").chain(rest.splitn(3, '.')).collect();
        return set(graph, bridge, &path, value);
    }
    let first = key.split('.').next().unwrap_or_default();
    let text = serde_yaml::to_string(&value).unwrap_or_default();
    let of_graph = ["seed", "window", "restarts", "mode"].contains(&key)
        || graph.params.contains_key(key)
        || graph.nodes.contains_key(first);
    match bridge {
        _ if of_graph => Ok(graph.set(key, text.trim_end())?),
        Some(bridge) => set(graph, bridge, &key.split('.').collect::<Vec<_>>(), value),
        None => {
            log::warn!("parameter {key}: the graph has no node `{first}`");
            Ok(())
        }
    }
}

fn set(graph: &mut Graph, node: &str, path: &[&str], value: Value) -> Result<()> {
    let spec = graph.nodes.get_mut(node).with_context(|| format!("the graph has no node `{node}`"))?;
    let mut place = &mut spec.config;
    for part in path {
        if place.is_null() {
            *place = Value::Mapping(serde_yaml::Mapping::new());
        }
        let mapping = place.as_mapping_mut().with_context(|| format!("`{part}` lies within a value"))?;
        place = mapping.entry(Value::String((*part).to_owned())).or_insert(Value::Null);
    }
    *place = value;
    Ok(())
}

fn assignment(argument: &str, text: &str) -> Result<(String, String)> {
    let (name, value) = text.split_once(":=").with_context(|| format!("`{argument} {text}`: write NAME:=VALUE"))?;
    // `node:name` is how one process with several nodes is told which is meant.
    let name = name.rsplit_once(':').map_or(name, |(_, name)| name);
    Ok((name.to_owned(), value.to_owned()))
}

fn rule(text: &str) -> Result<Rule> {
    let (from, to) = text.split_once(":=").with_context(|| format!("`-r {text}`: write FROM:=TO"))?;
    if from.is_empty() || to.is_empty() {
        bail!("`-r {text}`: write FROM:=TO");
    }
    let (node, from) = match from.split_once(':') {
        Some((node, from)) => (Some(node.to_owned()), from),
        None => (None, from),
    };
    Ok(Rule { node, from: from.to_owned(), to: to.to_owned() })
}

fn log_level(text: &str) -> Result<String> {
    let level = text.rsplit_once(":=").map_or(text, |(_, level)| level).to_lowercase();
    Ok(match level.as_str() {
        "debug" | "info" | "error" => level,
        "warn" | "warning" => "warn".to_owned(),
        "fatal" => "error".to_owned(),
        "unset" => "info".to_owned(),
        _ => bail!("`--log-level {text}`: give debug, info, warn, error or fatal"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(text: &str) -> Vec<String> {
        text.split_whitespace().map(str::to_owned).collect()
    }

    fn graph() -> Graph {
        let text = "mode: live\nnodes:\n  bridge: {kind: bridge, config: {camera: {image: /a}}}\n  \
                    renderer: {kind: renderer, config: {objects: o}}\n";
        Graph::parse(text, Path::new("test.yaml")).unwrap()
    }

    fn applied(text: &str) -> Graph {
        let mut graph = graph();
        RosArgs::parse(&words(text)).unwrap().apply(&mut graph).unwrap();
        graph
    }

    #[test]
    fn the_command_line_is_parted() {
        let (ours, ros) = split(words("run g.yaml --ros-args -r a:=b -- --out x --ros-args -p c:=1").into_iter());
        assert_eq!((ours, ros), (words("run g.yaml --out x"), words("-r a:=b -p c:=1")));
    }

    #[test]
    fn names_topics_and_parameters_reach_the_graph() {
        let graph = applied(
            "-r __ns:=/left -r __node:=eye -r object_pose:=cup -r other:x:=y -p renderer.size_px:=64 -p window:=2 \
             -p camera.image:=/b -p qos_overrides./left/cup.publisher.depth:=3 -p use_sim_time:=true",
        );
        let bridge = &graph.nodes["bridge"].config;
        assert_eq!((bridge["namespace"].as_str(), bridge["node_name"].as_str()), (Some("/left"), Some("eye")));
        assert_eq!(bridge["remap"]["object_pose"].as_str(), Some("cup"));
        assert!(bridge["remap"].get("x").is_none());
        assert_eq!(bridge["camera"]["image"].as_str(), Some("/b"));
        assert_eq!(bridge["qos_overrides"]["/left/cup"]["publisher"]["depth"].as_u64(), Some(3));
        assert_eq!((graph.window, graph.nodes["renderer"].config["size_px"].as_u64()), (2, Some(64)));
    }

    #[test]
    fn a_parameter_file_speaks_to_the_nodes_that_it_names() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("f.yaml");
        let text = "/**:\n  ros__parameters: {window: 3}\n/left/pseudoflow:\n  ros__parameters:\n    renderer: {size_px: 96}\n    \
                    qos_overrides: {/left/object_pose: {publisher: {depth: 7}}}\nleft:\n  pseudoflow:\n    ros__parameters: {object: cup}\n\
                    other:\n  ros__parameters: {window: 9}\n";
        std::fs::write(&path, text).unwrap();
        let graph = applied(&format!("-r __ns:=/left --params-file {}", path.display()));
        assert_eq!((graph.window, graph.nodes["renderer"].config["size_px"].as_u64()), (3, Some(96)));
        let bridge = &graph.nodes["bridge"].config;
        assert_eq!(bridge["object"].as_str(), Some("cup"));
        assert_eq!(bridge["qos_overrides"]["/left/object_pose"]["publisher"]["depth"].as_u64(), Some(7));
    }

    #[test]
    fn patterns_of_nodes_are_those_of_ros() {
        let node = NodeName { namespace: "/left/arm".into(), base: "eye".into() };
        for (pattern, meant) in [
            ("/**", true),
            ("/**/eye", true),
            ("/left/*/eye", true),
            ("/left/eye", false),
            ("/*/eye", false),
            ("/left/arm/eye", true),
        ] {
            assert_eq!(node.is_meant_by(pattern), meant, "{pattern}");
        }
        assert_eq!(NodeName { namespace: "/".into(), base: "eye".into() }.full(), "/eye");
    }

    #[test]
    fn wrong_arguments_are_named() {
        for (text, part) in [
            ("-r", "-r"),
            ("-r a", "FROM:=TO"),
            ("-p x", "NAME:=VALUE"),
            ("--log-level loud", "loud"),
            ("--wrong", "--wrong"),
        ] {
            let error = RosArgs::parse(&words(text)).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
        assert_eq!(RosArgs::parse(&words("--log-level pseudoflow:=WARN")).unwrap().log_level, Some("warn".into()));
    }
}
