//! Values that a graph states once and uses in several nodes: `params: {size_px: 256}`, then `size_px: $size_px`.

use super::{Graph, GraphError, Problem};
use indexmap::IndexMap;
use serde::Serialize;
use serde_yaml::Value;
use std::collections::BTreeSet;

/// A value that could not be filled in: what is wrong, and what to do.
type Complaint = (String, String);

impl Graph {
    /// The graph with its parameters filled in: every `$name` or `${name}` within a node's configuration. Where it is the whole
    /// text, the value keeps its type; within a longer text it is written out. `$$` is a dollar sign. A parameter may use those
    /// above it.
    ///
    /// # Errors
    /// A parameter that is not there, has no value or is used by nothing; one that is no text within a text.
    pub fn resolved(&self) -> Result<Self, Vec<Problem>> {
        let mut filling = Filling { values: IndexMap::new(), problems: Vec::new() };
        for (name, value) in &self.params {
            let filled =
                filling.fill(value, &mut |(what, remedy)| self.problem(None, &format!("params.{name}"), what, remedy));
            filling.values.insert(name.clone(), filled);
        }
        let mut graph = Self { params: IndexMap::new(), ..self.clone() };
        for (node, spec) in &mut graph.nodes {
            let problem = &mut |(what, remedy)| self.problem(Some(node), "config", what, remedy);
            spec.config = filling.fill(&spec.config, problem);
        }
        if filling.problems.is_empty() { Ok(graph) } else { Err(filling.problems) }
    }

    /// Gives parameters the values of a struct's fields.
    ///
    /// # Errors
    /// A field that is no parameter of the graph, or no value that YAML can hold.
    pub fn set_params(&mut self, values: &impl Serialize) -> Result<(), GraphError> {
        let failed =
            |key: &str, cause: String| GraphError::Override { key: key.to_owned(), value: String::new(), cause };
        let values = serde_yaml::to_value(values).map_err(|error| failed("params", error.to_string()))?;
        for (name, value) in values.as_mapping().into_iter().flatten() {
            let name = name.as_str().unwrap_or_default();
            let known = self.params.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
            let place = self.params.get_mut(name);
            *place.ok_or_else(|| failed(name, format!("no such parameter: those there are: {known}")))? = value.clone();
        }
        Ok(())
    }

    /// Parameters that nothing uses: a misspelt name would have no effect. (Asked of a graph as its file states it: an
    /// override may well replace what used one.)
    pub(super) fn unused_params(&self) -> Vec<Problem> {
        let mut used = BTreeSet::new();
        let configs = self.nodes.values().map(|spec| &spec.config);
        configs.chain(self.params.values()).for_each(|value| names_in(value, &mut used));
        let remedy = "remove it, or write `$` and its name in a configuration";
        let unused = self.params.keys().filter(|name| !used.contains(name.as_str()));
        unused
            .map(|name| self.problem(None, &format!("params.{name}"), "no node uses it".into(), remedy.into()))
            .collect()
    }

    fn problem(&self, node: Option<&str>, field: &str, what: String, remedy: String) -> Problem {
        Problem { file: self.file.clone(), node: node.map(str::to_owned), field: field.to_owned(), what, remedy }
    }
}

struct Filling {
    values: IndexMap<String, Value>,
    problems: Vec<Problem>,
}

impl Filling {
    fn fill(&mut self, value: &Value, problem: &mut dyn FnMut(Complaint) -> Problem) -> Value {
        match value {
            Value::String(text) => self.fill_text(text).unwrap_or_else(|complaint| {
                self.problems.push(problem(complaint));
                Value::Null
            }),
            Value::Sequence(values) => Value::Sequence(values.iter().map(|v| self.fill(v, problem)).collect()),
            Value::Mapping(entries) => {
                Value::Mapping(entries.iter().map(|(key, v)| (key.clone(), self.fill(v, problem))).collect())
            }
            other => other.clone(),
        }
    }

    fn fill_text(&self, text: &str) -> Result<Value, Complaint> {
        let parts = parts(text)?;
        if let [Part::Name(name)] = parts.as_slice() {
            return self.value(name).cloned();
        }
        let mut filled = String::new();
        for part in parts {
            match part {
                Part::Text(text) => filled.push_str(text),
                Part::Name(name) => filled.push_str(&written(name, self.value(name)?)?),
            }
        }
        Ok(Value::String(filled))
    }

    fn value(&self, name: &str) -> Result<&Value, Complaint> {
        match self.values.get(name) {
            None => Err((format!("`${name}` is no parameter"), self.remedy(name))),
            Some(Value::Null) => {
                Err((format!("parameter `{name}` has no value"), format!("give one: `--set {name}=...`")))
            }
            Some(value) => Ok(value),
        }
    }

    fn remedy(&self, name: &str) -> String {
        let known: Vec<&str> = self.values.keys().map(String::as_str).collect();
        match known.as_slice() {
            [] => format!("add it: `params: {{{name}: ...}}`; a dollar sign is written `$$`"),
            known => format!("those there are: {}; a dollar sign is written `$$`", known.join(", ")),
        }
    }
}

/// Names that a value uses. What cannot be read uses none; filling it in says why.
fn names_in<'a>(value: &'a Value, names: &mut BTreeSet<&'a str>) {
    match value {
        Value::String(text) => names.extend(parts(text).into_iter().flatten().filter_map(|part| match part {
            Part::Name(name) => Some(name),
            Part::Text(_) => None,
        })),
        Value::Sequence(values) => values.iter().for_each(|value| names_in(value, names)),
        Value::Mapping(entries) => entries.values().for_each(|value| names_in(value, names)),
        _ => {}
    }
}

enum Part<'a> {
    Text(&'a str),
    Name(&'a str),
}

/// A text in parts: names after `$`, and what stands between them.
fn parts(text: &str) -> Result<Vec<Part<'_>>, Complaint> {
    let mut parts = Vec::new();
    let mut left = text;
    while let Some(at) = left.find('$') {
        if at > 0 {
            parts.push(Part::Text(&left[..at]));
        }
        let after = &left[at + 1..];
        if let Some(rest) = after.strip_prefix('$') {
            parts.push(Part::Text("$"));
            left = rest;
            continue;
        }
        let (name, rest) = name_at(after).ok_or_else(|| {
            (
                format!("`{text}`: no name follows a `$`"),
                "write `$name`, `${name}`, or `$$` for a dollar sign".to_owned(),
            )
        })?;
        parts.push(Part::Name(name));
        left = rest;
    }
    if !left.is_empty() || parts.is_empty() {
        parts.push(Part::Text(left));
    }
    Ok(parts)
}

/// The name that a text begins with, bare or in braces, and what follows.
fn name_at(text: &str) -> Option<(&str, &str)> {
    let plain = |name: &str| name.find(|c: char| !c.is_ascii_alphanumeric() && c != '_').unwrap_or(name.len());
    if let Some(braced) = text.strip_prefix('{') {
        let (name, rest) = braced.split_once('}')?;
        return (!name.is_empty() && plain(name) == name.len()).then_some((name, rest));
    }
    let end = plain(text);
    (end > 0).then(|| text.split_at(end))
}

/// A value as it stands within a text.
fn written(name: &str, value: &Value) -> Result<String, Complaint> {
    match value {
        Value::String(text) => Ok(text.clone()),
        Value::Number(number) => Ok(number.to_string()),
        Value::Bool(truth) => Ok(truth.to_string()),
        _ => Err((format!("`${name}` is no text"), "use a list or mapping as the whole value".to_owned())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn config_of(params: &str, config: &str) -> Result<Value, String> {
        let text = format!("mode: replay\nparams: {params}\nnodes: {{a: {{kind: player, config: {config}}}}}\n");
        let graph = Graph::parse(&text, Path::new("g.yaml")).map_err(|error| error.to_string())?;
        let resolved = graph.resolved().map_err(|p| p.iter().map(Problem::to_string).collect::<Vec<_>>().join("\n"))?;
        assert!(resolved.params.is_empty());
        Ok(resolved.nodes["a"].config.clone())
    }

    #[test]
    fn values_keep_their_types_and_texts_are_filled() {
        let params = "{size: 256, flags: [a, 1], out: out/x, deep: $out/$size, price: 3$$}";
        let config = "{side: $size, l: $flags, m: {n: [\"${out}_1\", $deep, 7]}, p: $price, e: ''}";
        let expected = "{side: 256, l: [a, 1], m: {n: [out/x_1, out/x/256, 7]}, p: '3$', e: ''}";
        assert_eq!(config_of(params, config).unwrap(), serde_yaml::from_str::<Value>(expected).unwrap());
    }

    #[test]
    fn what_cannot_be_filled_is_said_with_its_place() {
        for (params, config, said) in [
            ("{a: 1}", "{x: $a, y: $b}", "node `a`: `config`: `$b` is no parameter: those there are: a"),
            ("{}", "{y: $b}", "add it: `params: {b: ...}`"),
            ("{a: }", "{y: $a}", "parameter `a` has no value: give one: `--set a=...`"),
            ("{a: 1, b: 2}", "{y: $a}", "`params.b`: no node uses it"),
            ("{a: [1]}", "{y: x$a}", "`$a` is no text"),
            ("{a: 1}", "{y: 'costs $', z: $a}", "no name follows a `$`"),
            ("{a: $b, b: 1}", "{y: $a}", "`params.a`: `$b` is no parameter"),
        ] {
            let message = config_of(params, config).unwrap_err();
            assert!(message.contains(said), "{params} {config}: {message}");
        }
    }

    #[test]
    fn an_override_sets_a_parameter_by_its_name() {
        let text = "mode: replay\nparams: {size: 1}\nnodes: {a: {kind: player, config: {side: $size}}}\n";
        let mut graph = Graph::parse(text, Path::new("g.yaml")).unwrap();
        graph.set("size", "2").unwrap();
        assert_eq!(graph.resolved().unwrap().nodes["a"].config["side"], Value::from(2));
        graph.set("a.side", "3").unwrap();
        assert_eq!(graph.resolved().unwrap().nodes["a"].config["side"], Value::from(3));
        let error = graph.set("sise", "2").unwrap_err().to_string();
        assert!(error.contains("the parameter size"), "{error}");
    }

    #[test]
    fn a_structs_fields_are_parameters() {
        #[derive(serde::Serialize)]
        struct Sizes {
            size: Vec<u32>,
        }
        let text = "mode: replay\nparams: {size: 1}\nnodes: {a: {kind: player, config: {side: $size}}}\n";
        let mut graph = Graph::parse(text, Path::new("g.yaml")).unwrap();
        graph.set_params(&Sizes { size: vec![3, 4] }).unwrap();
        assert_eq!(
            graph.resolved().unwrap().nodes["a"].config["side"],
            serde_yaml::from_str::<Value>("[3, 4]").unwrap()
        );
        let error = graph.set_params(&std::collections::BTreeMap::from([("sise", 2)])).unwrap_err().to_string();
        assert!(error.contains("sise") && error.contains("those there are: size"), "{error}");
    }
}
