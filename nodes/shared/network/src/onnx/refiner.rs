//! The refiner as standard ONNX.

use super::builder::{Attr, Builder};
use super::{ConvWeights, Export, ExportOptions, Pictures, proto};
use crate::config::Architecture;
use crate::error::Result;
use crate::layout::refiner::{LEVELS, RADIUS, WIDTHS};
use crate::model::Model;
use crate::refiner::{REFERENCE_CHANNELS, RefinerConfig};
use crate::weights::Weights;
use prost::Message as _;

/// The bytes of an ONNX file with inputs `reference` (N, 5, S, S) and `real` (N, 3, S, S) as the network in burn takes
/// them, and outputs `flow` (N, 2, S, S), px, defined on the reference, and `certainty` (N, 2, S, S): probability that the
/// rendered surface point is seen in the crop, and confidence that its flow is right to about a pixel, both 0..1. The same
/// weights and options give the same bytes.
///
/// # Errors
/// Size, iterations or batch are out of range, or the weights belong to another architecture.
pub fn export_refiner(weights: &Weights, config: &RefinerConfig, options: ExportOptions) -> Result<Vec<u8>> {
    let ExportOptions { size_px, iterations, batch } = options;
    RefinerConfig::check_size(size_px)?;
    options.check()?;
    config.check_weights(weights)?;
    let (graph, arch) = (Builder::default(), Architecture::Small);
    let mut export = Export { graph, weights, arch, batch, side: size_px / 8 };
    let reference = export.graph.input("reference", batch, &[REFERENCE_CHANNELS, size_px, size_px]);
    let real = export.graph.input("real", batch, &[3, size_px, size_px]);
    let [flow, certainty] = export.refiner(&reference, &real, iterations);
    for (name, value) in [("flow", &flow), ("certainty", &certainty)] {
        export.graph.output(name, value, batch, &[2, size_px, size_px]);
    }
    let info = serde_json::to_string(&weights.info).expect("plain struct");
    let metadata = [
        ("pseudoflow", info),
        ("size_px", size_px.to_string()),
        ("iterations", iterations.to_string()),
        ("network", config.name.clone()),
    ];
    Ok(export.graph.finish("refiner", &metadata))
}

/// The bytes of an ONNX file of the features that the refiner correlates at 1/8: input `image`, of renderings (N, 5, S, S) as
/// the network in burn takes them or of photographs (N, 3, S, S); output `features` (N, 64, S / 8, S / 8).
///
/// # Errors
/// The size is out of range, or the weights belong to another architecture.
pub(crate) fn export_refiner_features(
    weights: &Weights,
    config: &RefinerConfig,
    size_px: usize,
    of: Pictures,
) -> Result<Vec<u8>> {
    RefinerConfig::check_size(size_px)?;
    config.check_weights(weights)?;
    let side = size_px / 8;
    let mut export = Export { graph: Builder::default(), weights, arch: Architecture::Small, batch: None, side };
    let colours = export.conv_weights("stem");
    let (stem, channels) = match of {
        Pictures::Photographs => (colours, 3),
        Pictures::Renderings => (side_by_side(&colours, &export.conv_weights("stem.geometry")), REFERENCE_CHANNELS),
    };
    let image = export.graph.input("image", None, &[channels, size_px, size_px]);
    let fine = export.fine_features(&stem, &image);
    let features = export.plain_conv(&fine, "match.fine");
    export.graph.output("features", &features, None, &[WIDTHS.matching, side, side]);
    let info = serde_json::to_string(&weights.info).expect("plain struct");
    Ok(export.graph.finish("features", &[("pseudoflow", info)]))
}

/// Whether the bytes of an ONNX file are those of a refiner: a network that says how certain it is.
#[must_use]
pub fn is_refiner_onnx(onnx: &[u8]) -> bool {
    let model = proto::Model::decode(onnx).ok();
    let outputs = model.and_then(|model| model.graph).map(|graph| graph.output).unwrap_or_default();
    outputs.iter().any(|output| output.name == "certainty")
}

/// Features of one image at 1/8 and at 1/16.
struct Features {
    fine: String,
    coarse: String,
}

impl Export<'_> {
    fn refiner(&mut self, reference: &str, real: &str, iterations: usize) -> [String; 2] {
        let colours = self.conv_weights("stem");
        let of_reference = side_by_side(&colours, &self.conv_weights("stem.geometry"));
        let [reference, real] =
            [(of_reference, reference), (colours, real)].map(|(stem, x)| self.refiner_features(&stem, x));
        let [rows, columns] = [&reference, &real].map(|f| self.plain_conv(&f.fine, "match.fine"));
        let levels = self.correlation(&rows, columns, WIDTHS.matching, LEVELS);
        let (first, global) = self.global_look(&reference.coarse, &real.coarse);
        let global = self.double(&global);
        let both = self.graph.concat(&[&reference.fine, &global], 1);
        let both = self.plain_conv(&both, "context");
        let parts = self.graph.split(&both, &[WIDTHS.hidden, WIDTHS.context]);
        let mut hidden = self.graph.op("Tanh", &[&parts[0]], &[]);
        let context = self.graph.relu(&parts[1]);
        let context = self.plain_conv(&context, "update.context");
        let (first, two) = (self.double(&first), self.graph.scalar(2.0));
        let mut flow = self.graph.op("Mul", &[&first, &two], &[]);
        for _ in 0..iterations {
            let corr = self.lookup_conv(&levels, &flow, RADIUS, "update.correlation");
            hidden = self.refiner_step(&hidden, &corr, &flow, &context);
            let head = self.conv_relu(&hidden, "head.0");
            let delta = self.plain_conv(&head, "head.flow");
            flow = self.graph.op("Add", &[&flow, &delta], &[]);
        }
        self.prediction(&flow, &hidden)
    }

    fn plain_conv(&mut self, x: &str, name: &str) -> String {
        let weights = self.conv_weights(name);
        self.conv(x, &weights, 1)
    }

    fn refiner_features(&mut self, stem: &ConvWeights, image: &str) -> Features {
        let fine = self.fine_features(stem, image);
        let coarse = self.trunk_stage(&fine, 3);
        Features { fine, coarse }
    }

    fn fine_features(&mut self, stem: &ConvWeights, image: &str) -> String {
        let stem = self.conv(image, stem, 2);
        let stem = self.instance_norm(&stem, WIDTHS.trunk[0]);
        let stem = self.graph.relu(&stem);
        let first = self.trunk_stage(&stem, 1);
        self.trunk_stage(&first, 2)
    }

    fn trunk_stage(&mut self, x: &str, stage: usize) -> String {
        let down = self.normed(x, &format!("trunk.{stage}.down"), "", 2, true);
        let down = self.graph.relu(&down);
        let mut y = self.normed(&down, &format!("trunk.{stage}.first"), "", 1, true);
        if stage > 1 {
            let first = self.graph.relu(&y);
            y = self.normed(&first, &format!("trunk.{stage}.second"), "", 1, true);
        }
        let sum = self.graph.op("Add", &[&down, &y], &[]);
        self.graph.relu(&sum)
    }

    /// Flow and context at 1/16.
    fn global_look(&mut self, reference: &str, real: &str) -> (String, String) {
        let matched = self.matched_flow(reference, real);
        let x = self.graph.concat(&[reference, real, &matched], 1);
        let x = self.conv_relu(&x, "global.0");
        let y = self.conv_relu(&x, "global.1");
        let everywhere = self.graph.op("GlobalAveragePool", &[&y], &[]);
        let everywhere = self.plain_conv(&everywhere, "global.pool");
        let y = self.graph.op("Add", &[&y, &everywhere], &[]);
        let y = self.graph.relu(&y);
        let y = self.conv_relu(&y, "global.2");
        let context = self.graph.op("Add", &[&x, &y], &[]);
        (self.plain_conv(&context, "global.flow"), context)
    }

    fn matched_flow(&mut self, reference: &str, real: &str) -> String {
        let (side, features) = (self.side / 2, WIDTHS.matching as i64);
        let area = (side * side) as i64;
        let rows = self.plain_conv(reference, "match.coarse");
        let rows = self.graph.reshape(&rows, &[-1, features, area]);
        let rows = self.graph.transpose(&rows, &[0, 2, 1]);
        let columns = self.plain_conv(real, "match.coarse");
        let columns = self.graph.reshape(&columns, &[-1, features, area]);
        let scores = self.graph.op("MatMul", &[&rows, &columns], &[]);
        let scale = self.graph.scalar(1.0 / (features as f32).sqrt());
        let scores = self.graph.op("Mul", &[&scores, &scale], &[]);
        let weights = self.graph.op("Softmax", &[&scores], &[("axis", Attr::Int(2))]);
        let at = |i: usize| [(i % side) as f32, (i / side) as f32];
        let positions: Vec<f32> = (0..side * side).flat_map(at).collect();
        let positions = self.graph.floats(&[side * side, 2], &positions);
        let expected = self.graph.op("MatMul", &[&weights, &positions], &[]);
        let flow = self.graph.op("Sub", &[&expected, &positions], &[]);
        let flow = self.graph.transpose(&flow, &[0, 2, 1]);
        self.graph.reshape(&flow, &[-1, 2, side as i64, side as i64])
    }

    /// The next hidden state.
    fn refiner_step(&mut self, hidden: &str, corr: &str, flow: &str, context: &str) -> String {
        let encoded = self.conv_relu(flow, "update.flow");
        let both = self.graph.concat(&[corr, &encoded], 1);
        let motion = self.conv_relu(&both, "update.motion");
        let all = self.graph.concat(&[hidden, &motion, flow], 1);
        let a = self.plain_conv(&all, "update.recurrent");
        let a = self.graph.op("Add", &[&a, context], &[]);
        let parts = self.graph.split(&a, &[WIDTHS.hidden, WIDTHS.hidden]);
        let z = self.graph.op("Sigmoid", &[&parts[0]], &[]);
        let q = self.graph.op("Tanh", &[&parts[1]], &[]);
        let change = self.graph.op("Sub", &[&q, hidden], &[]);
        let change = self.graph.op("Mul", &[&z, &change], &[]);
        self.graph.op("Add", &[hidden, &change], &[])
    }

    /// Flow and certainty at full size.
    fn prediction(&mut self, flow: &str, hidden: &str) -> [String; 2] {
        let head = self.conv_relu(hidden, "head.0");
        let certainty = self.plain_conv(&head, "head.certainty");
        let eight = self.graph.scalar(8.0);
        let flow = self.graph.op("Mul", &[flow, &eight], &[]);
        let all = self.graph.concat(&[&flow, &certainty], 1);
        let logits = self.plain_conv(hidden, "head.mask");
        let fine = self.convex(&all, 5, &logits);
        let parts = self.graph.split(&fine, &[2, 1, 1, 1]);
        // Visibility first, then confidence.
        let logits = self.graph.concat(&[&parts[3], &parts[1]], 1);
        [parts[0].clone(), self.graph.op("Sigmoid", &[&logits], &[])]
    }
}

/// One convolution on the channels of two.
fn side_by_side(a: &ConvWeights, b: &ConvWeights) -> ConvWeights {
    let [o, ca, kh, kw] = a.shape;
    let (wide, narrow) = (ca * kh * kw, b.shape[1] * kh * kw);
    let filters = a.weight.chunks_exact(wide).zip(b.weight.chunks_exact(narrow));
    let weight = filters.flat_map(|(a, b)| [a, b].concat()).collect();
    let bias = a.bias.iter().zip(&b.bias).map(|(a, b)| a + b).collect();
    ConvWeights { shape: [o, ca + b.shape[1], kh, kw], weight, bias }
}
