//! The recurrent part at 1/8: encoded correlation and flow, gated update, heads.

use crate::model::Source;
use crate::ops;
use crate::raft::Conv;
use burn::tensor::Tensor;

/// The recurrent part with its weights.
#[derive(Debug)]
pub(super) struct Update {
    correlation: Conv,
    flow: Conv,
    motion: Conv,
    context: Conv,
    recurrent: Conv,
    head: Conv,
    head_flow: Conv,
    head_certainty: Conv,
    head_mask: Conv,
}

impl Update {
    pub(super) fn new(source: &Source<'_>) -> Self {
        let conv = |name: &str| Conv::new(source.conv(name), 1);
        Self {
            correlation: conv("update.correlation"),
            flow: conv("update.flow"),
            motion: conv("update.motion"),
            context: conv("update.context"),
            recurrent: conv("update.recurrent"),
            head: conv("head.0"),
            head_flow: conv("head.flow"),
            head_certainty: conv("head.certainty"),
            head_mask: conv("head.mask"),
        }
    }

    /// The context's share of gate and candidate (N, 2 hidden, h, w): it never changes between iterations.
    pub(super) fn context(&self, context: Tensor<4>) -> Tensor<4> {
        self.context.forward(context, false)
    }

    /// Looked-up correlation and flow (N, 2, h, w), px at 1/8, to (N, motion, h, w).
    pub(super) fn motion(&self, correlation: Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
        let parts = vec![self.correlation.forward(correlation, true), self.flow.forward(flow.clone(), true)];
        Tensor::cat(vec![self.motion.forward(Tensor::cat(parts, 1), true), flow], 1)
    }

    /// The next hidden state (N, hidden, h, w).
    pub(super) fn hidden(&self, hidden: Tensor<4>, motion: Tensor<4>, context: Tensor<4>) -> Tensor<4> {
        let a = self.recurrent.forward(Tensor::cat(vec![hidden.clone(), motion], 1), false);
        ops::gated_update(a, context, hidden)
    }

    /// The change of the flow (N, 2, h, w), px at 1/8.
    pub(super) fn delta(&self, hidden: &Tensor<4>) -> Tensor<4> {
        self.head_flow.forward(self.head.forward(hidden.clone(), true), false)
    }

    /// Logit of confidence, raw scale, logit of visibility (N, 3, h, w).
    pub(super) fn certainty(&self, hidden: &Tensor<4>) -> Tensor<4> {
        self.head_certainty.forward(self.head.forward(hidden.clone(), true), false)
    }

    /// Logits of the upsampling (N, 9 * 64, h, w).
    pub(super) fn mask(&self, hidden: &Tensor<4>) -> Tensor<4> {
        self.head_mask.forward(hidden.clone(), false)
    }
}
