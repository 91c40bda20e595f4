//! Trunk of rendering and photograph, and the look at 1/16 that sees the whole crop.

use super::WIDTHS;
use crate::model::Source;
use crate::ops;
use crate::raft::{Conv, grid};
use burn::tensor::{Tensor, activation};

/// One trunk for rendering and photograph; the rendering's geometry comes in at the first convolution.
#[derive(Debug)]
pub(super) struct Trunk {
    /// Of the rendering's five channels and of the photograph's three.
    stems: [Conv; 2],
    stages: Vec<Stage>,
}

/// Features of a batch of pairs: the first half of the batch are the renderings, the second the photographs.
#[derive(Debug)]
pub(super) struct Features {
    /// (2 N, 64, S/8, S/8).
    pub(super) fine: Tensor<4>,
    /// (2 N, 96, S/16, S/16).
    pub(super) coarse: Tensor<4>,
}

impl Features {
    /// Renderings and photographs of a tensor with both.
    pub(super) fn halves(&self, both: &Tensor<4>) -> [Tensor<4>; 2] {
        halves(both)
    }
}

fn halves(both: &Tensor<4>) -> [Tensor<4>; 2] {
    let n = both.dims()[0] / 2;
    [both.clone().narrow(0, 0, n), both.clone().narrow(0, n, n)]
}

impl Trunk {
    pub(super) fn new(source: &Source<'_>) -> Self {
        let ((colours, bias), (geometry, shift)) = (source.conv("stem"), source.conv("stem.geometry"));
        let of_reference = (Tensor::cat(vec![colours.clone(), geometry], 1), bias.clone() + shift);
        let stems = [Conv::new(of_reference, 2), Conv::new((colours, bias), 2)];
        Self { stems, stages: (1..4).map(|stage| Stage::new(source, stage)).collect() }
    }

    pub(super) fn forward(&self, reference: Tensor<4>, real: Tensor<4>) -> Features {
        let stem = |conv: &Conv, x: Tensor<4>| ops::instance_norm(conv.forward(x, false), true);
        let x = Tensor::cat(vec![stem(&self.stems[0], reference), stem(&self.stems[1], real)], 0);
        let fine = self.stages[1].forward(self.stages[0].forward(x));
        let coarse = self.stages[2].forward(fine.clone());
        Features { fine, coarse }
    }
}

/// Halves the resolution, then a residual block of one or two convolutions.
#[derive(Debug)]
struct Stage {
    down: Conv,
    block: Vec<Conv>,
}

impl Stage {
    fn new(source: &Source<'_>, stage: usize) -> Self {
        let conv = |part: &str, stride| Conv::new(source.conv(&format!("trunk.{stage}.{part}")), stride);
        let parts: &[&str] = if stage > 1 { &["first", "second"] } else { &["first"] };
        Self { down: conv("down", 2), block: parts.iter().map(|part| conv(part, 1)).collect() }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let x = ops::instance_norm(self.down.forward(x, false), true);
        let last = self.block.len() - 1;
        let y = self
            .block
            .iter()
            .enumerate()
            .fold(x.clone(), |y, (i, conv)| ops::instance_norm(conv.forward(y, false), i < last));
        ops::add_relu(x, y)
    }
}

/// The look at 1/16: where each pixel's features are found again, and what convolutions over all of it make of that.
#[derive(Debug)]
pub(super) struct GlobalLook {
    matching: Conv,
    convs: [Conv; 3],
    pool: Conv,
    flow: Conv,
}

impl GlobalLook {
    pub(super) fn new(source: &Source<'_>) -> Self {
        let conv = |name: &str| Conv::new(source.conv(name), 1);
        Self {
            matching: conv("match.coarse"),
            convs: ["global.0", "global.1", "global.2"].map(conv),
            pool: conv("global.pool"),
            flow: conv("global.flow"),
        }
    }

    /// Flow (N, 2, S/16, S/16), px at 1/16, and context (N, 96, S/16, S/16).
    pub(super) fn forward(&self, coarse: &Tensor<4>) -> (Tensor<4>, Tensor<4>) {
        let [reference, real] = halves(&self.matching.forward(coarse.clone(), false));
        let matched = matched_flow(reference, real);
        let [reference, real] = halves(coarse);
        let x = self.convs[0].forward(Tensor::cat(vec![reference, real, matched], 1), true);
        let y = self.convs[1].forward(x.clone(), true);
        // What all of the crop has in common, such as a turn of the whole object.
        let everywhere = self.pool.forward(y.clone().mean_dim(3).mean_dim(2), false);
        let y = activation::relu(y + everywhere);
        let y = self.convs[2].forward(y, true);
        let context = x + y;
        (self.flow.forward(context.clone(), false), context)
    }
}

/// Expected displacement under a softmax over all positions of the other image (GMFlow, Xu et al., CVPR 2022): features
/// (N, C, h, w) of both to (N, 2, h, w), px of this resolution.
fn matched_flow(reference: Tensor<4>, real: Tensor<4>) -> Tensor<4> {
    let [n, c, h, w] = reference.dims();
    let rows = reference.reshape([n, c, h * w]).swap_dims(1, 2);
    let scores: Tensor<3> = rows.matmul(real.reshape([n, c, h * w])) / (c as f32).sqrt();
    let grid = grid(h, w, &scores);
    let positions = grid.clone().reshape([1, 2, h * w]).swap_dims(1, 2).expand([n, h * w, 2]);
    let expected: Tensor<3> = activation::softmax(scores, 2).matmul(positions);
    expected.swap_dims(1, 2).reshape([n, 2, h, w]) - grid
}

const _: () = assert!(WIDTHS.trunk[3] == WIDTHS.global, "the residual sum of the global look");
