//! RAFT's learned upsampling.

use burn::tensor::{Tensor, activation};

/// Each fine pixel is a convex combination of the 3x3 coarse pixels around it: flow (N, 2, h, w), px at 1/8, and
/// logits (N, 9 * 64, h, w) to (N, 2, 8 h, 8 w), px at full size.
pub(super) fn convex(flow: Tensor<4>, logits: Tensor<4>) -> Tensor<4> {
    let [n, _, h, w] = flow.dims();
    let weights = activation::softmax(logits.reshape([n, 9, 64, h, w]), 1);
    let neighbours = neighbours(flow * 8.0);
    let planes = (0..2).map(|axis| {
        let values: Tensor<5> = neighbours.clone().narrow(1, axis, 1).reshape([n, 9, 1, h, w]);
        let fine: Tensor<5> = (weights.clone() * values).sum_dim(1).reshape([n, 8, 8, h, w]);
        // (n, fy, fx, y, x) to (n, y, fy, x, fx).
        fine.permute([0, 3, 1, 4, 2]).reshape([n, 1, 8 * h, 8 * w])
    });
    Tensor::cat(planes.collect(), 1)
}

/// (N, 2, h, w) to (N, 2, 9, h w): the 3x3 neighbours, row by row, zeros outside.
fn neighbours(flow: Tensor<4>) -> Tensor<4> {
    let [n, c, h, w] = flow.dims();
    let side = Tensor::zeros([n, c, h, 1], &flow.device());
    let wide = Tensor::cat(vec![side.clone(), flow, side], 3);
    let edge = Tensor::zeros([n, c, 1, w + 2], &wide.device());
    let padded = Tensor::cat(vec![edge.clone(), wide, edge], 2);
    let shifted = (0..9).map(|k| {
        let window = padded.clone().narrow(2, k / 3, h).narrow(3, k % 3, w);
        window.reshape([n, c, 1, h * w])
    });
    Tensor::cat(shifted.collect(), 2)
}
