//! The all-pairs correlation pyramid of RAFT and of the refiner.

use crate::ops;
use burn::tensor::ops::AvgPoolOptions;
use burn::tensor::{Tensor, TensorData, module};

/// Correlation of each reference pixel with each real pixel at several scales.
#[derive(Debug)]
pub(crate) struct Pyramid {
    /// (N, h w, Q): row p holds the maps of all levels one after the other.
    volume: Tensor<3>,
    levels: Vec<[usize; 2]>,
    radius: usize,
    /// Pixel coordinates (1, 2, h, w) at 1/8.
    grid: Tensor<4>,
}

impl Pyramid {
    /// From the features (N, C, h, w) of both images; each level halves the one before.
    ///
    /// Averaging the correlation over 2x2 real pixels equals correlating with averaged features, which is cheaper.
    pub(crate) fn new(reference: Tensor<4>, real: Tensor<4>, radius: usize, level_count: usize) -> Self {
        let [n, c, h, w] = reference.dims();
        let mut pooled = real;
        let (mut levels, mut columns) = (Vec::new(), Vec::new());
        for level in 0..level_count {
            if level > 0 {
                pooled = module::avg_pool2d(pooled, AvgPoolOptions::new([2, 2]).with_stride([2, 2]));
            }
            let [_, _, lh, lw] = pooled.dims();
            levels.push([lh, lw]);
            columns.push(pooled.clone().reshape([n, c, lh * lw]));
        }
        let rows = reference.reshape([n, c, h * w]).swap_dims(1, 2);
        let volume = rows.matmul(Tensor::cat(columns, 2)) / (c as f32).sqrt();
        let grid = grid(h, w, &volume);
        Self { volume, levels, radius, grid }
    }

    /// Windows around pixel + flow: (N, 2, h, w), px at 1/8, to (N, L (2 r + 1)^2, h, w).
    pub(crate) fn lookup(&self, flow: &Tensor<4>) -> Tensor<4> {
        ops::lookup(self.volume.clone(), self.grid.clone() + flow.clone(), self.radius, &self.levels)
    }
}

/// Pixel coordinates x, y (1, 2, h, w).
pub(crate) fn grid(h: usize, w: usize, like: &Tensor<3>) -> Tensor<4> {
    let x = (0..h * w).map(|i| (i % w) as f32);
    let y = (0..h * w).map(|i| (i / w) as f32);
    Tensor::from_data(TensorData::new(x.chain(y).collect::<Vec<_>>(), [1, 2, h, w]), &like.device())
}
