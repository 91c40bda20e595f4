//! Builds a graph node by node; values are known by name.

use super::proto::{self, attribute_kind, data_type};
use prost::Message;

/// The standard operator set the graph uses: the first with GridSample.
const OPSET: i64 = 16;
const IR_VERSION: i64 = 8;

/// A graph under construction.
#[derive(Debug, Default)]
pub(super) struct Builder {
    nodes: Vec<proto::Node>,
    initializers: Vec<proto::TensorValue>,
    inputs: Vec<proto::ValueInfo>,
    outputs: Vec<proto::ValueInfo>,
}

/// The value of a node's attribute.
#[derive(Debug, Clone)]
pub(super) enum Attr {
    Int(i64),
    Ints(Vec<i64>),
    Float(f32),
    Text(&'static str),
}

/// Batch size in a shape: fixed, or `batch`.
pub(super) type Batch = Option<usize>;

impl Builder {
    /// Adds a node with one output and returns its name.
    pub(super) fn op(&mut self, op: &str, inputs: &[&str], attrs: &[(&str, Attr)]) -> String {
        self.op_many(op, inputs, attrs, 1).remove(0)
    }

    /// Adds a node with several outputs.
    pub(super) fn op_many(&mut self, op: &str, inputs: &[&str], attrs: &[(&str, Attr)], outputs: usize) -> Vec<String> {
        let name = format!("{op}_{}", self.nodes.len());
        let output: Vec<String> = (0..outputs).map(|i| format!("{name}_{i}")).collect();
        self.nodes.push(proto::Node {
            input: inputs.iter().map(ToString::to_string).collect(),
            output: output.clone(),
            name,
            op_type: op.into(),
            attribute: attrs.iter().map(|(name, value)| attribute(name, value)).collect(),
        });
        output
    }

    /// A constant f32 tensor.
    pub(super) fn floats(&mut self, shape: &[usize], values: &[f32]) -> String {
        debug_assert_eq!(shape.iter().product::<usize>(), values.len());
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.constant(data_type::FLOAT, shape, bytes)
    }

    /// A constant f32 of rank 0.
    pub(super) fn scalar(&mut self, value: f32) -> String {
        self.floats(&[], &[value])
    }

    /// A constant vector of int64: shapes, axes.
    pub(super) fn ints(&mut self, values: &[i64]) -> String {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.constant(data_type::INT64, &[values.len()], bytes)
    }

    /// Equal constants become one.
    fn constant(&mut self, data_type: i32, shape: &[usize], raw_data: Vec<u8>) -> String {
        let dims: Vec<i64> = shape.iter().map(|&d| d as i64).collect();
        let same = |t: &&proto::TensorValue| t.data_type == data_type && t.dims == dims && t.raw_data == raw_data;
        if let Some(found) = self.initializers.iter().find(same) {
            return found.name.clone();
        }
        let name = format!("constant_{}", self.initializers.len());
        self.initializers.push(proto::TensorValue { dims, data_type, name: name.clone(), raw_data });
        name
    }

    pub(super) fn input(&mut self, name: &str, batch: Batch, shape: &[usize]) -> String {
        self.inputs.push(float_value(name, batch, shape));
        name.into()
    }

    /// Names `value` as an output of the graph.
    pub(super) fn output(&mut self, name: &str, value: &str, batch: Batch, shape: &[usize]) {
        self.nodes.push(proto::Node {
            input: vec![value.into()],
            output: vec![name.into()],
            name: format!("output_{name}"),
            op_type: "Identity".into(),
            attribute: vec![],
        });
        self.outputs.push(float_value(name, batch, shape));
    }

    pub(super) fn reshape(&mut self, x: &str, shape: &[i64]) -> String {
        let shape = self.ints(shape);
        self.op("Reshape", &[x, &shape], &[])
    }

    pub(super) fn transpose(&mut self, x: &str, order: &[i64]) -> String {
        self.op("Transpose", &[x], &[("perm", Attr::Ints(order.into()))])
    }

    pub(super) fn concat(&mut self, parts: &[&str], axis: i64) -> String {
        self.op("Concat", parts, &[("axis", Attr::Int(axis))])
    }

    /// Splits along axis 1.
    pub(super) fn split(&mut self, x: &str, sizes: &[usize]) -> Vec<String> {
        let sizes_value = self.ints(&sizes.iter().map(|&s| s as i64).collect::<Vec<_>>());
        self.op_many("Split", &[x, &sizes_value], &[("axis", Attr::Int(1))], sizes.len())
    }

    /// Convolution padded by half its kernel; weights (O, C, kh, kw), bias (O).
    pub(super) fn conv(&mut self, x: &str, shape: [usize; 4], w: &[f32], b: &[f32], stride: usize) -> String {
        let (pad_y, pad_x) = ((shape[2] / 2) as i64, (shape[3] / 2) as i64);
        let (w, b) = (self.floats(&shape, w), self.floats(&[shape[0]], b));
        let attrs = [
            ("kernel_shape", Attr::Ints(vec![shape[2] as i64, shape[3] as i64])),
            ("strides", Attr::Ints(vec![stride as i64; 2])),
            ("pads", Attr::Ints(vec![pad_y, pad_x, pad_y, pad_x])),
        ];
        self.op("Conv", &[x, &w, &b], &attrs)
    }

    pub(super) fn relu(&mut self, x: &str) -> String {
        self.op("Relu", &[x], &[])
    }

    /// The file's bytes.
    pub(super) fn finish(self, name: &str, metadata: &[(&str, String)]) -> Vec<u8> {
        let graph = proto::Graph {
            node: self.nodes,
            name: name.into(),
            initializer: self.initializers,
            input: self.inputs,
            output: self.outputs,
        };
        let entries = metadata.iter().map(|(key, value)| proto::Entry { key: key.to_string(), value: value.clone() });
        let model = proto::Model {
            ir_version: IR_VERSION,
            producer_name: "pseudoflow".into(),
            producer_version: env!("CARGO_PKG_VERSION").into(),
            graph: Some(graph),
            opset_import: vec![proto::OperatorSet { domain: String::new(), version: OPSET }],
            metadata_props: entries.collect(),
        };
        model.encode_to_vec()
    }
}

fn attribute(name: &str, value: &Attr) -> proto::Attribute {
    let mut attribute = proto::Attribute { name: name.into(), ..Default::default() };
    match value {
        Attr::Int(i) => (attribute.i, attribute.kind) = (*i, attribute_kind::INT),
        Attr::Ints(ints) => (attribute.ints, attribute.kind) = (ints.clone(), attribute_kind::INTS),
        Attr::Float(f) => (attribute.f, attribute.kind) = (*f, attribute_kind::FLOAT),
        Attr::Text(s) => (attribute.s, attribute.kind) = (s.as_bytes().to_vec(), attribute_kind::STRING),
    }
    attribute
}

fn float_value(name: &str, batch: Batch, shape: &[usize]) -> proto::ValueInfo {
    let first = match batch {
        Some(n) => proto::DimensionValue::Known(n as i64),
        None => proto::DimensionValue::Named("batch".into()),
    };
    let rest = shape.iter().map(|&d| proto::DimensionValue::Known(d as i64));
    let dim = std::iter::once(first).chain(rest).map(|value| proto::Dimension { value: Some(value) }).collect();
    let tensor = proto::TensorType { elem_type: data_type::FLOAT, shape: Some(proto::TensorShape { dim }) };
    proto::ValueInfo { name: name.into(), value_type: Some(proto::ValueType { tensor: Some(tensor) }) }
}
