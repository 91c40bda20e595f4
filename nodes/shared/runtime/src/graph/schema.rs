use super::Graph;
use crate::Registry;
use crate::registry::Kind;
use serde_json::{Value, json};

/// The JSON schema of graphs over the registered kinds, from the structs that read them: for editors, and as
/// the reference of every key.
#[must_use]
pub fn schema(registry: &Registry) -> Value {
    let mut schema = schemars::schema_for!(Graph).to_value();
    let kinds: Vec<Value> = registry.kinds().map(node_schema).collect();
    schema["$defs"]["NodeSpec"] = json!({ "description": "One node of a graph.", "oneOf": kinds });
    schema
}

fn node_schema(kind: &Kind) -> Value {
    let ports: serde_json::Map<String, Value> = kind
        .inputs
        .iter()
        .map(|port| (port.name.to_owned(), json!({ "type": "string", "description": port.message })))
        .collect();
    let required: Vec<&str> = kind.inputs.iter().filter(|port| port.required).map(|port| port.name).collect();
    let mut config = (kind.schema)();
    // A schema inside a schema: its own definitions move with it, so references must point there.
    point_references_at(&mut config, &format!("#/$defs/NodeSpec/oneOf/{}/properties/config", kind.position));
    if let Some(object) = config.as_object_mut() {
        object.remove("$schema");
    }
    allow_parameters(&mut config);
    json!({
        "type": "object",
        "additionalProperties": false,
        "required": if required.is_empty() { vec!["kind"] } else { vec!["kind", "inputs"] },
        "properties": {
            "kind": { "const": kind.name },
            "inputs": {
                "type": "object",
                "additionalProperties": false,
                "required": required,
                "properties": ports,
            },
            "nice": { "type": "integer", "minimum": 0, "maximum": 19, "default": 0 },
            "threads": { "type": "integer", "minimum": 1, "maximum": 256 },
            "config": config,
        }
    })
}

fn point_references_at(value: &mut Value, place: &str) {
    match value {
        Value::Object(object) => {
            for (key, value) in object {
                match value {
                    Value::String(reference) if key == "$ref" && reference.starts_with("#/") => {
                        *reference = format!("{place}{}", &reference[1..]);
                    }
                    _ => point_references_at(value, place),
                }
            }
        }
        Value::Array(values) => values.iter_mut().for_each(|value| point_references_at(value, place)),
        _ => {}
    }
}

/// Wherever a property of a configuration has a type of its own, a parameter (`$name`) may stand in its place.
fn allow_parameters(schema: &mut Value) {
    match schema {
        Value::Object(object) => {
            object.values_mut().for_each(allow_parameters);
            let properties = object.get_mut("properties").and_then(Value::as_object_mut);
            for property in properties.into_iter().flat_map(|p| p.values_mut()) {
                let mut own = property.take();
                let description = own.as_object_mut().and_then(|own| own.remove("description"));
                *property = json!({ "anyOf": [own, { "type": "string", "pattern": "^\\$[{a-zA-Z_]" }] });
                if let Some(text) = description {
                    property["description"] = text;
                }
            }
        }
        Value::Array(values) => values.iter_mut().for_each(allow_parameters),
        _ => {}
    }
}
