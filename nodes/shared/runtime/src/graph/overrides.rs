use super::{Graph, GraphError};
use serde_yaml::{Mapping, Value};

impl Graph {
    /// Overrides a value: `mode`, `seed`, `window`, `restarts`, the deadlines, a parameter by its name, or `node.key` (deeper with more dots) for a value
    /// in a node's configuration. The value is read as YAML: `4`, `true`, `[1, 2]`, `some/path`.
    ///
    /// # Errors
    /// When there is no such node or the key leads through a value that is no mapping.
    pub fn set(&mut self, key: &str, value: &str) -> Result<(), GraphError> {
        let error = |cause: String| GraphError::Override { key: key.to_owned(), value: value.to_owned(), cause };
        let parsed: Value = crate::yaml::from_str(value).map_err(|e| error(format!("the value is no YAML: {e}")))?;
        match key.split_once('.') {
            None => self.set_top(key, parsed).map_err(error),
            Some((node, path)) => self.set_config(node, path, parsed).map_err(error),
        }
    }

    fn set_top(&mut self, key: &str, value: Value) -> Result<(), String> {
        fn read<T: serde::de::DeserializeOwned>(value: Value) -> Result<T, String> {
            serde_yaml::from_value(value).map_err(|error| error.to_string())
        }
        match key {
            "mode" => self.mode = read(value)?,
            "seed" => self.seed = read(value)?,
            "window" => self.window = read(value)?,
            "restarts" => self.restarts = read(value)?,
            "frame_deadline_s" => self.frame_deadline_s = Some(read(value)?),
            "start_deadline_s" => self.start_deadline_s = Some(read(value)?),
            name => match self.params.get_mut(name) {
                Some(parameter) => *parameter = value,
                None => return Err(self.no_such_key()),
            },
        }
        Ok(())
    }

    fn no_such_key(&self) -> String {
        let params: Vec<&str> = self.params.keys().map(String::as_str).collect();
        let of_params = match params.as_slice() {
            [] => String::new(),
            [one] => format!(", the parameter {one}"),
            several => format!(", a parameter ({})", several.join(", ")),
        };
        format!(
            "no such key: write mode, seed, window, restarts, frame_deadline_s, start_deadline_s{of_params} or `node.key`"
        )
    }

    fn set_config(&mut self, node: &str, path: &str, value: Value) -> Result<(), String> {
        let names = self.nodes.keys().cloned().collect::<Vec<_>>().join(", ");
        let spec =
            self.nodes.get_mut(node).ok_or_else(|| format!("the graph has no node `{node}`: its nodes are {names}"))?;
        let mut place = &mut spec.config;
        for part in path.split('.') {
            if place.is_null() {
                *place = Value::Mapping(Mapping::new());
            }
            let mapping =
                place.as_mapping_mut().ok_or_else(|| format!("`{part}` lies within a value that is no mapping"))?;
            place = mapping.entry(Value::String(part.to_owned())).or_insert(Value::Null);
        }
        *place = value;
        Ok(())
    }
}
