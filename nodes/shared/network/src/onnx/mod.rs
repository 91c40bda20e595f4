//! Writes the inference network as standard ONNX (opset 16) with the weights inside and the iterations unrolled.
//!
//! The graph does what the network in burn does, in forms that CPU runtimes execute fast: the correlation lookup is
//! one small Add and one GridSample per pyramid level, the first convolution on the looked-up correlation is a matrix
//! product before the transpose, the context's share of the GRU is computed once, bilinear upsampling is two matrix
//! products.

mod builder;
mod detector;
mod proto;
mod recurrent;
mod refiner;

use crate::config::{Architecture, NetworkConfig};
use crate::error::{NetworkError, Result};
use crate::model::{BATCH_NORM_EPSILON, Model};
use crate::weights::{NamedTensor, Weights};
use builder::{Attr, Batch, Builder};
pub use detector::export_detector;
pub(crate) use refiner::export_refiner_features;
pub use refiner::{export_refiner, is_refiner_onnx};

/// What to export.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ExportOptions {
    /// Side S of the crops, px; it need not be the size of the training.
    pub size_px: usize,
    /// Recurrent iterations.
    pub iterations: usize,
    /// Image pairs per run; `None` leaves it open (named `batch`).
    pub batch: Option<usize>,
}

impl ExportOptions {
    /// Checks iterations and batch; the size's rule is the network's.
    fn check(&self) -> Result<()> {
        if !(1..=64).contains(&self.iterations) {
            let problem = format!("is {}; use 1 to 64", self.iterations);
            return Err(NetworkError::ConfigValue { field: "iterations", problem });
        }
        if self.batch == Some(0) {
            return Err(NetworkError::ConfigValue { field: "batch", problem: "is 0; use at least 1".into() });
        }
        Ok(())
    }
}

/// The bytes of an ONNX file with inputs `reference` and `real` (N, 3, S, S), f32 in [-1, 1], and output `flow`
/// (N, 2, S, S), px, defined on the reference. The same weights and options give the same bytes.
///
/// # Errors
/// Size, iterations or batch are out of range, or the weights belong to another architecture.
pub fn export_onnx(weights: &Weights, config: &NetworkConfig, options: ExportOptions) -> Result<Vec<u8>> {
    let ExportOptions { size_px, iterations, batch } = options;
    NetworkConfig::check_size(size_px)?;
    options.check()?;
    config.check_weights(weights)?;
    let mut export = Export { graph: Builder::default(), weights, arch: config.arch, batch, side: size_px / 8 };
    let image = [3, size_px, size_px];
    let reference = export.graph.input("reference", batch, &image);
    let real = export.graph.input("real", batch, &image);
    let flow = export.network(&reference, &real, iterations);
    export.graph.output("flow", &flow, batch, &[2, size_px, size_px]);
    let info = serde_json::to_string(&weights.info).expect("plain struct");
    let metadata = [
        ("pseudoflow", info),
        ("size_px", size_px.to_string()),
        ("iterations", iterations.to_string()),
        ("network", config.name.clone()),
    ];
    Ok(export.graph.finish("raft", &metadata))
}

/// What an encoder of features looks at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pictures {
    /// Renderings of an object.
    Renderings,
    /// Crops of a camera's image.
    Photographs,
}

/// The bytes of an ONNX file of a RAFT's feature encoder alone: input `image` (N, 3, S, S), f32 in [-1, 1], output `features`
/// (N, C, S / 8, S / 8). Features of a rendering and of a real crop resemble each other where they show the same surface.
///
/// # Errors
/// The size is out of range, or the weights belong to another architecture.
pub(crate) fn export_features(weights: &Weights, config: &NetworkConfig, size_px: usize) -> Result<Vec<u8>> {
    NetworkConfig::check_size(size_px)?;
    config.check_weights(weights)?;
    let side = size_px / 8;
    let mut export = Export { graph: Builder::default(), weights, arch: config.arch, batch: None, side };
    let image = export.graph.input("image", None, &[3, size_px, size_px]);
    let features = export.encoder(&image, "fnet", true);
    export.graph.output("features", &features, None, &[config.feature_channels(), side, side]);
    let info = serde_json::to_string(&weights.info).expect("plain struct");
    Ok(export.graph.finish("features", &[("pseudoflow", info)]))
}

/// An export in progress.
struct Export<'a> {
    graph: Builder,
    weights: &'a Weights,
    arch: Architecture,
    batch: Batch,
    /// Side of the feature maps, S / 8.
    side: usize,
}

/// A convolution's constants.
#[derive(Clone)]
struct ConvWeights {
    shape: [usize; 4],
    weight: Vec<f32>,
    bias: Vec<f32>,
}

impl<'a> Export<'a> {
    /// A tensor whose presence [`Model::check_weights`] has checked.
    fn tensor(&self, name: &str) -> &'a NamedTensor {
        self.weights.get(name).expect("checked against the architecture before")
    }

    fn conv_weights(&self, name: &str) -> ConvWeights {
        let weight = self.tensor(&format!("{name}.weight"));
        let shape = weight.shape.as_slice().try_into().expect("convolution weights have rank 4");
        ConvWeights { shape, weight: weight.data.clone(), bias: self.tensor(&format!("{name}.bias")).data.clone() }
    }

    fn conv(&mut self, x: &str, c: &ConvWeights, stride: usize) -> String {
        self.graph.conv(x, c.shape, &c.weight, &c.bias, stride)
    }

    fn conv_relu(&mut self, x: &str, name: &str) -> String {
        let weights = self.conv_weights(name);
        let y = self.conv(x, &weights, 1);
        self.graph.relu(&y)
    }

    /// Convolution and norm of an encoder: instance norm as a node, batch norm folded into the weights.
    fn normed(&mut self, x: &str, name: &str, norm: &str, stride: usize, instance: bool) -> String {
        let mut weights = self.conv_weights(name);
        self.fold_batch_norm(&mut weights, norm);
        let y = self.conv(x, &weights, stride);
        if !instance {
            return y;
        }
        self.instance_norm(&y, weights.shape[0])
    }

    fn instance_norm(&mut self, y: &str, channels: usize) -> String {
        let scale = self.graph.floats(&[channels], &vec![1.0; channels]);
        let shift = self.graph.floats(&[channels], &vec![0.0; channels]);
        self.graph.op("InstanceNormalization", &[y, &scale, &shift], &[("epsilon", Attr::Float(1e-5))])
    }

    fn fold_batch_norm(&self, conv: &mut ConvWeights, norm: &str) {
        let Some(var) = self.weights.get(&format!("{norm}.running_var")) else { return };
        let [weight, bias, mean] =
            ["weight", "bias", "running_mean"].map(|part| &self.tensor(&format!("{norm}.{part}")).data);
        let filter = conv.weight.len() / conv.shape[0];
        for (o, filter) in conv.weight.chunks_exact_mut(filter).enumerate() {
            let scale = weight[o] / (var.data[o] + BATCH_NORM_EPSILON).sqrt();
            filter.iter_mut().for_each(|v| *v *= scale);
            conv.bias[o] = conv.bias[o] * scale + bias[o] - mean[o] * scale;
        }
    }

    fn encoder(&mut self, x: &str, name: &str, instance: bool) -> String {
        let y = self.trunk(x, name, instance);
        let head = self.conv_weights(&format!("{name}.conv2"));
        self.conv(&y, &head, 1)
    }

    /// An encoder without its last convolution.
    fn trunk(&mut self, x: &str, name: &str, instance: bool) -> String {
        let stem = self.normed(x, &format!("{name}.conv1"), &format!("{name}.norm1"), 2, instance);
        let mut y = self.graph.relu(&stem);
        for stage in 1..4 {
            for block in 0..2 {
                let shrinks = stage > 1 && block == 0;
                y = self.block(&y, &format!("{name}.layer{stage}.{block}"), self.arch, shrinks, instance);
            }
        }
        y
    }

    fn block(&mut self, x: &str, name: &str, arch: Architecture, shrinks: bool, instance: bool) -> String {
        let stride = if shrinks { 2 } else { 1 };
        let strides: &[usize] = match arch {
            Architecture::Basic => &[stride, 1],
            Architecture::Small => &[1, stride, 1],
        };
        let mut y = x.to_string();
        for (i, &stride) in strides.iter().enumerate() {
            let i = i + 1;
            let normed = self.normed(&y, &format!("{name}.conv{i}"), &format!("{name}.norm{i}"), stride, instance);
            y = self.graph.relu(&normed);
        }
        let mut shortcut = x.to_string();
        if shrinks {
            shortcut = self.normed(x, &format!("{name}.downsample.0"), &format!("{name}.downsample.1"), 2, instance);
        }
        let sum = self.graph.op("Add", &[&shortcut, &y], &[]);
        self.graph.relu(&sum)
    }

    /// A constant (N, 2, h, w) of zeros.
    fn zero_flow(&mut self, reference: &str) -> String {
        let side = self.side;
        if let Some(n) = self.batch {
            return self.graph.floats(&[n, 2, side, side], &vec![0.0; n * 2 * side * side]);
        }
        let shape = self.graph.op("Shape", &[reference], &[]);
        let [first, last] = [self.graph.ints(&[0]), self.graph.ints(&[1])];
        let n = self.graph.op("Slice", &[&shape, &first, &last], &[]);
        let rest = self.graph.ints(&[2, side as i64, side as i64]);
        let shape = self.graph.concat(&[&n, &rest], 0);
        let zero = self.graph.floats(&[1, 2, side, side], &vec![0.0; 2 * side * side]);
        self.graph.op("Expand", &[&zero, &shape], &[])
    }
}
