//! The recurrent part: motion encoder, convolutional GRU, flow head.
//!
//! The context never changes between iterations, so its share of the GRU's convolutions is computed once per image
//! pair. This is the authors' arithmetic in another order of summation.

use super::conv::Conv;
use crate::model::Source;
use crate::ops;
use burn::tensor::Tensor;
use pseudoflow_network::Architecture;
use pseudoflow_network::layout::raft::Widths;

/// The recurrent part with its weights.
#[derive(Debug)]
pub(super) struct UpdateBlock {
    corr: Vec<Conv>,
    flow: Vec<Conv>,
    motion: Conv,
    gru: Vec<Gru>,
    head: [Conv; 2],
    mask: Option<[Conv; 2]>,
}

/// One convolutional GRU; the basic network has two, across and down.
#[derive(Debug)]
struct Gru {
    /// Update and reset gate, then candidate: shares of hidden state and motion.
    gates: Conv,
    candidate: Conv,
    /// The shares of the context, with the biases.
    gates_context: Conv,
    candidate_context: Conv,
}

/// The GRUs' constant share: gates (N, 2 C, h, w) and candidate (N, C, h, w) of each.
pub(super) type Context = Vec<[Tensor<4>; 2]>;

impl Gru {
    fn new(source: &Source<'_>, suffix: &str, widths: Widths) -> Self {
        let part = |name: &str| source.conv(&format!("update_block.gru.conv{name}{suffix}"));
        let ((wz, bz), (wr, br), (wq, bq)) = (part("z"), part("r"), part("q"));
        let gates = Tensor::cat(vec![wz, wr], 0);
        let bias = Tensor::cat(vec![bz, br], 0);
        let split = |w: Tensor<4>, bias: Tensor<1>| {
            let Widths { hidden, context, motion, .. } = widths;
            let recurrent = vec![w.clone().narrow(1, 0, hidden), w.clone().narrow(1, hidden + context, motion)];
            let no_bias = Tensor::zeros(bias.dims(), &bias.device());
            [Conv::new((Tensor::cat(recurrent, 1), no_bias), 1), Conv::new((w.narrow(1, hidden, context), bias), 1)]
        };
        let [gates, gates_context] = split(gates, bias);
        let [candidate, candidate_context] = split(wq, bq);
        Self { gates, candidate, gates_context, candidate_context }
    }

    fn forward(&self, h: Tensor<4>, motion: Tensor<4>, [cg, cq]: [Tensor<4>; 2]) -> Tensor<4> {
        let gates = self.gates.forward(Tensor::cat(vec![h.clone(), motion.clone()], 1), false);
        let reset = ops::reset_gate(gates.clone(), cg.clone(), h.clone());
        let candidate = self.candidate.forward(Tensor::cat(vec![reset, motion], 1), false);
        ops::gru_blend([gates, cg], [candidate, cq], h)
    }
}

impl UpdateBlock {
    pub(super) fn new(source: &Source<'_>, arch: Architecture) -> Self {
        let conv = |name: &str| Conv::new(source.conv(&format!("update_block.{name}")), 1);
        let (corr, suffixes): (&[&str], &[&str]) = match arch {
            Architecture::Basic => (&["encoder.convc1", "encoder.convc2"], &["1", "2"]),
            Architecture::Small => (&["encoder.convc1"], &[""]),
        };
        Self {
            corr: corr.iter().map(|name| conv(name)).collect(),
            flow: ["encoder.convf1", "encoder.convf2"].map(conv).into(),
            motion: conv("encoder.conv"),
            gru: suffixes.iter().map(|suffix| Gru::new(source, suffix, arch.widths())).collect(),
            head: ["flow_head.conv1", "flow_head.conv2"].map(conv),
            mask: (arch == Architecture::Basic).then(|| ["mask.0", "mask.2"].map(conv)),
        }
    }

    /// The GRUs' constant share of a context (N, C, h, w).
    pub(super) fn context(&self, context: &Tensor<4>) -> Context {
        let share = |conv: &Conv| conv.forward(context.clone(), false);
        self.gru.iter().map(|gru| [share(&gru.gates_context), share(&gru.candidate_context)]).collect()
    }

    /// Looked-up correlation (N, L (2 r + 1)^2, h, w) and flow (N, 2, h, w), px at 1/8, to (N, M, h, w).
    pub(super) fn motion(&self, corr: Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
        let corr = self.corr.iter().fold(corr, |x, conv| conv.forward(x, true));
        let features = self.flow.iter().fold(flow.clone(), |x, conv| conv.forward(x, true));
        let motion = self.motion.forward(Tensor::cat(vec![corr, features], 1), true);
        Tensor::cat(vec![motion, flow], 1)
    }

    /// The next hidden state (N, C, h, w).
    pub(super) fn hidden(&self, h: Tensor<4>, motion: &Tensor<4>, context: &Context) -> Tensor<4> {
        let steps = self.gru.iter().zip(context);
        steps.fold(h, |h, (gru, context)| gru.forward(h, motion.clone(), context.clone()))
    }

    /// The change of the flow (N, 2, h, w), px at 1/8.
    pub(super) fn delta(&self, h: &Tensor<4>) -> Tensor<4> {
        self.head[1].forward(self.head[0].forward(h.clone(), true), false)
    }

    /// The upsampling logits (N, 9 * 64, h, w) of the basic network.
    pub(super) fn mask(&self, h: &Tensor<4>) -> Option<Tensor<4>> {
        let [first, second] = self.mask.as_ref()?;
        // The authors scale the mask "to balance gradients".
        Some(second.forward(first.forward(h.clone(), true), false) * 0.25)
    }
}
