//! The recurrent part of the exported graph: correlation, lookup, motion encoder, GRU, flow head, upsampling.

use super::builder::Attr;
use super::{ConvWeights, Export};
use crate::config::Architecture;
use crate::layout::raft::LEVELS;
use crate::upsampling::align_corners_matrix;

/// Correlation maps of one level.
pub(super) struct Level {
    /// (N h w, 1, lh, lw).
    map: String,
    side: usize,
}

/// One GRU: its convolutions on hidden state and motion, and the constant share of the context.
struct Gru {
    gates: ConvWeights,
    candidate: ConvWeights,
    context: [String; 2],
}

impl Export<'_> {
    /// The whole network; returns the flow at full size.
    pub(super) fn network(&mut self, reference: &str, real: &str, iterations: usize) -> String {
        let widths = self.arch.widths();
        let [of_reference, of_real] = self.features(reference, real);
        let levels = self.correlation(&of_reference, of_real, widths.features, LEVELS);
        let both = self.encoder(reference, "cnet", false);
        let parts = self.graph.split(&both, &[widths.hidden, widths.context]);
        let mut hidden = self.graph.op("Tanh", &[&parts[0]], &[]);
        let context = self.graph.relu(&parts[1]);
        let grus = self.grus(&context);
        let mut flow = self.zero_flow(reference);
        for _ in 0..iterations {
            let motion = self.motion(&levels, &flow);
            for gru in &grus {
                hidden = self.gru(gru, &hidden, &motion);
            }
            let head = self.conv_relu(&hidden, "update_block.flow_head.conv1");
            let last = self.conv_weights("update_block.flow_head.conv2");
            let delta = self.conv(&head, &last, 1);
            flow = self.graph.op("Add", &[&flow, &delta], &[]);
        }
        match self.arch {
            Architecture::Small => self.upsample_bilinear(&flow),
            Architecture::Basic => self.upsample_convex(&flow, &hidden),
        }
    }

    /// Correlation of features (N, `features`, h, w) of both images.
    pub(super) fn correlation(
        &mut self,
        reference: &str,
        mut pooled: String,
        features: usize,
        level_count: usize,
    ) -> Vec<Level> {
        let side = self.side;
        let rows = reference;
        let rows = self.graph.reshape(rows, &[-1, features as i64, (side * side) as i64]);
        let rows = self.graph.transpose(&rows, &[0, 2, 1]);
        let scale = self.graph.scalar(1.0 / (features as f32).sqrt());
        let rows = self.graph.op("Mul", &[&rows, &scale], &[]);
        let mut levels = Vec::new();
        for level in 0..level_count {
            if level > 0 {
                let attrs = [("kernel_shape", Attr::Ints(vec![2, 2])), ("strides", Attr::Ints(vec![2, 2]))];
                pooled = self.graph.op("AveragePool", &[&pooled], &attrs);
            }
            let side = side >> level;
            let columns = self.graph.reshape(&pooled, &[-1, features as i64, (side * side) as i64]);
            let volume = self.graph.op("MatMul", &[&rows, &columns], &[]);
            let map = self.graph.reshape(&volume, &[-1, 1, side as i64, side as i64]);
            levels.push(Level { map, side });
        }
        levels
    }

    /// Features of reference and real image; as one batch where the split is known, else one after the other.
    fn features(&mut self, reference: &str, real: &str) -> [String; 2] {
        let Some(n) = self.batch else {
            return [reference, real].map(|image| self.encoder(image, "fnet", true));
        };
        let both = self.graph.concat(&[reference, real], 0);
        let features = self.encoder(&both, "fnet", true);
        let sizes = self.graph.ints(&[n as i64; 2]);
        let parts = self.graph.op_many("Split", &[&features, &sizes], &[("axis", Attr::Int(0))], 2);
        parts.try_into().expect("two outputs")
    }

    /// Windows around pixel + flow as (N h w, L (2 r + 1)^2).
    fn lookup(&mut self, levels: &[Level], flow: &str, radius: usize) -> String {
        let side = self.side;
        let xs = (0..side * side).map(|i| (i % side) as f32);
        let ys = (0..side * side).map(|i| (i / side) as f32);
        let grid = self.graph.floats(&[1, 2, side, side], &xs.chain(ys).collect::<Vec<_>>());
        let coords = self.graph.op("Add", &[flow, &grid], &[]);
        let coords = self.graph.transpose(&coords, &[0, 2, 3, 1]);
        let coords = self.graph.reshape(&coords, &[-1, 1, 1, 2]);
        let window = 2 * radius + 1;
        let mut windows = Vec::new();
        for (l, level) in levels.iter().enumerate() {
            // GridSample without align_corners reads texel ((g + 1) size - 1) / 2, defined also for size 1.
            let scale = self.graph.scalar(2.0 / (level.side << l) as f32);
            let base = self.graph.op("Mul", &[&coords, &scale], &[]);
            let offset = |i: usize| (2.0 * (i as f32 - radius as f32) + 1.0) / level.side as f32 - 1.0;
            // The first window index moves x, as the trained weights expect.
            let offsets: Vec<f32> =
                (0..window * window).flat_map(|k| [offset(k / window), offset(k % window)]).collect();
            let offsets = self.graph.floats(&[1, window, window, 2], &offsets);
            let positions = self.graph.op("Add", &[&base, &offsets], &[]);
            let attrs = [
                ("mode", Attr::Text("bilinear")),
                ("padding_mode", Attr::Text("zeros")),
                ("align_corners", Attr::Int(0)),
            ];
            let sampled = self.graph.op("GridSample", &[&level.map, &positions], &attrs);
            windows.push(self.graph.reshape(&sampled, &[-1, (window * window) as i64]));
        }
        self.graph.concat(&windows.iter().map(String::as_str).collect::<Vec<_>>(), 1)
    }

    /// A 1x1 convolution with ReLU on looked-up windows, (N, O, h, w): on channels-last rows it is a matrix product; only its
    /// result is transposed.
    pub(super) fn lookup_conv(&mut self, levels: &[Level], flow: &str, radius: usize, name: &str) -> String {
        let looked_up = self.lookup(levels, flow, radius);
        let first = self.conv_weights(name);
        let [o, c, ..] = first.shape;
        let transposed: Vec<f32> = (0..c * o).map(|i| first.weight[i % o * c + i / o]).collect();
        let weight = self.graph.floats(&[c, o], &transposed);
        let bias = self.graph.floats(&[o], &first.bias);
        let corr = self.graph.op("Gemm", &[&looked_up, &weight, &bias], &[]);
        let corr = self.graph.relu(&corr);
        let side = self.side as i64;
        let corr = self.graph.reshape(&corr, &[-1, side, side, o as i64]);
        self.graph.transpose(&corr, &[0, 3, 1, 2])
    }

    fn motion(&mut self, levels: &[Level], flow: &str) -> String {
        let mut corr = self.lookup_conv(levels, flow, self.arch.widths().radius, "update_block.encoder.convc1");
        if self.arch == Architecture::Basic {
            corr = self.conv_relu(&corr, "update_block.encoder.convc2");
        }
        let features = self.conv_relu(flow, "update_block.encoder.convf1");
        let features = self.conv_relu(&features, "update_block.encoder.convf2");
        let both = self.graph.concat(&[&corr, &features], 1);
        let motion = self.conv_relu(&both, "update_block.encoder.conv");
        self.graph.concat(&[&motion, flow], 1)
    }

    fn grus(&mut self, context: &str) -> Vec<Gru> {
        let suffixes: &[&str] = match self.arch {
            Architecture::Basic => &["1", "2"],
            Architecture::Small => &[""],
        };
        let mut grus = Vec::new();
        for suffix in suffixes {
            let part = |name: &str| self.conv_weights(&format!("update_block.gru.conv{name}{suffix}"));
            let (gates, candidate) = (stack(part("z"), part("r")), part("q"));
            let (gates, gates_context) = self.split_context(gates);
            let (candidate, candidate_context) = self.split_context(candidate);
            let shares = [self.conv(context, &gates_context, 1), self.conv(context, &candidate_context, 1)];
            grus.push(Gru { gates, candidate, context: shares });
        }
        grus
    }

    /// The share of hidden state and motion (without bias), and the share of the context (with bias).
    fn split_context(&self, conv: ConvWeights) -> (ConvWeights, ConvWeights) {
        let widths = self.arch.widths();
        let (first, last) = (widths.hidden, widths.hidden + widths.context);
        let recurrent = input_channels(&conv, |c| !(first..last).contains(&c));
        let context = input_channels(&conv, |c| (first..last).contains(&c));
        (ConvWeights { bias: vec![0.0; conv.shape[0]], ..recurrent }, context)
    }

    fn gru(&mut self, gru: &Gru, hidden: &str, motion: &str) -> String {
        let channels = self.arch.widths().hidden;
        let [gates_context, candidate_context] = &gru.context;
        let both = self.graph.concat(&[hidden, motion], 1);
        let gates = self.conv(&both, &gru.gates, 1);
        let gates = self.graph.op("Add", &[&gates, gates_context], &[]);
        let gates = self.graph.op("Sigmoid", &[&gates], &[]);
        let gates = self.graph.split(&gates, &[channels, channels]);
        let reset = self.graph.op("Mul", &[&gates[1], hidden], &[]);
        let both = self.graph.concat(&[&reset, motion], 1);
        let candidate = self.conv(&both, &gru.candidate, 1);
        let candidate = self.graph.op("Add", &[&candidate, candidate_context], &[]);
        let candidate = self.graph.op("Tanh", &[&candidate], &[]);
        // (1 - z) h + z q = h + z (q - h).
        let change = self.graph.op("Sub", &[&candidate, hidden], &[]);
        let change = self.graph.op("Mul", &[&gates[0], &change], &[]);
        self.graph.op("Add", &[hidden, &change], &[])
    }

    fn upsample_bilinear(&mut self, flow: &str) -> String {
        let side = self.side;
        let matrix = align_corners_matrix(side);
        let left: Vec<f32> = matrix.iter().map(|v| 8.0 * v).collect();
        let right: Vec<f32> = (0..matrix.len()).map(|i| matrix[i % (8 * side) * side + i / (8 * side)]).collect();
        let left = self.graph.floats(&[8 * side, side], &left);
        let right = self.graph.floats(&[side, 8 * side], &right);
        let tall = self.graph.op("MatMul", &[&left, flow], &[]);
        self.graph.op("MatMul", &[&tall, &right], &[])
    }

    fn upsample_convex(&mut self, flow: &str, hidden: &str) -> String {
        let logits = self.conv_relu(hidden, "update_block.mask.0");
        let mut last = self.conv_weights("update_block.mask.2");
        last.weight.iter_mut().chain(&mut last.bias).for_each(|v| *v *= 0.25);
        let logits = self.conv(&logits, &last, 1);
        let eight = self.graph.scalar(8.0);
        let flow = self.graph.op("Mul", &[flow, &eight], &[]);
        self.convex(&flow, 2, &logits)
    }

    /// x (N, `channels`, h, w) and logits (N, 9 * 64, h, w) to (N, `channels`, 8 h, 8 w).
    pub(super) fn convex(&mut self, x: &str, channels: usize, logits: &str) -> String {
        let side = self.side as i64;
        let logits = self.graph.reshape(logits, &[-1, 9, 64, side * side]);
        let weights = self.graph.op("Softmax", &[&logits], &[("axis", Attr::Int(1))]);
        let neighbours = self.neighbours(x, channels);
        let axis = self.graph.ints(&[1]);
        let planes: Vec<String> = neighbours
            .iter()
            .map(|plane| {
                let plane = self.graph.reshape(plane, &[-1, 9, 1, side * side]);
                let weighed = self.graph.op("Mul", &[&weights, &plane], &[]);
                let sum = self.graph.op("ReduceSum", &[&weighed, &axis], &[("keepdims", Attr::Int(0))]);
                let fine = self.graph.reshape(&sum, &[-1, 8, 8, side, side]);
                let fine = self.graph.transpose(&fine, &[0, 3, 1, 4, 2]);
                self.graph.reshape(&fine, &[-1, 1, 8 * side, 8 * side])
            })
            .collect();
        self.graph.concat(&planes.iter().map(String::as_str).collect::<Vec<_>>(), 1)
    }

    /// The 3x3 neighbours of each pixel, zeros outside, for each channel: (N, 1, 9, h w).
    fn neighbours(&mut self, x: &str, channels: usize) -> Vec<String> {
        let side = self.side as i64;
        let pads = self.graph.ints(&[0, 0, 1, 1, 0, 0, 1, 1]);
        let padded = self.graph.op("Pad", &[x, &pads], &[("mode", Attr::Text("constant"))]);
        let axes = self.graph.ints(&[2, 3]);
        let windows: Vec<String> = (0..9)
            .map(|k| {
                let (first, last) = ([k / 3, k % 3], [k / 3 + side, k % 3 + side]);
                let (first, last) = (self.graph.ints(&first), self.graph.ints(&last));
                let window = self.graph.op("Slice", &[&padded, &first, &last, &axes], &[]);
                self.graph.reshape(&window, &[-1, channels as i64, 1, side * side])
            })
            .collect();
        let all = self.graph.concat(&windows.iter().map(String::as_str).collect::<Vec<_>>(), 2);
        self.graph.split(&all, &vec![1; channels])
    }
}

/// Two convolutions on the same input as one.
fn stack(mut first: ConvWeights, second: ConvWeights) -> ConvWeights {
    first.shape[0] += second.shape[0];
    first.weight.extend(second.weight);
    first.bias.extend(second.bias);
    first
}

/// The convolution on some of its input channels.
fn input_channels(conv: &ConvWeights, keep: impl Fn(usize) -> bool) -> ConvWeights {
    let [_, c, kh, kw] = conv.shape;
    let filters = conv.weight.chunks_exact(kh * kw).enumerate().filter(|(i, _)| keep(i % c));
    let weight = filters.flat_map(|(_, filter)| filter).copied().collect();
    let mut shape = conv.shape;
    shape[1] = (0..c).filter(|&c| keep(c)).count();
    ConvWeights { shape, weight, bias: conv.bias.clone() }
}
