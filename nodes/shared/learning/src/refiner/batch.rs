//! Synthetic pairs as the refiner's training takes them.

use crate::loss::MAX_FLOW_PX;
use burn::tensor::{Device, Tensor, TensorData};
use pseudoflow_network::{NetworkError, REFERENCE_CHANNELS, RefinerConfig, Result};

/// Synthetic pairs with what is true of them. Slices are row-major.
#[derive(Debug, Clone, Copy)]
pub struct RefinerBatch<'a> {
    /// Renderings (n, 5, S, S): colours in [-1, 1] and [`pseudoflow_network::reference_geometry`].
    pub reference: &'a [f32],
    /// Crops of the camera image (n, 3, S, S) in [-1, 1].
    pub real: &'a [f32],
    /// Flow from reference to real (n, 2, S, S), px. Values outside of the foreground are ignored, even NaN.
    pub flow: &'a [f32],
    /// Visibility (n, 1, S, S): 1 where the rendered surface point is seen in the crop, 0 where it is hidden or outside, -1
    /// where the rendering shows no object.
    pub visible: &'a [f32],
    /// Pairs.
    pub n: usize,
}

/// A [`RefinerBatch`] on a device.
#[derive(Debug)]
pub struct DeviceRefinerBatch {
    /// (n, 5, S, S).
    pub reference: Tensor<4>,
    /// (n, 3, S, S).
    pub real: Tensor<4>,
    /// (n, 4, S, S): flow x and y, whether the flow counts, visibility.
    pub target: Tensor<4>,
    /// (n, 2, S/8, S/8): mean flow of the counted pixels of each cell, px at 1/8.
    pub coarse_flow: Tensor<4>,
    /// (n, 1, S/8, S/8): share of each cell that counts.
    pub coarse_weight: Tensor<4>,
    /// Sum of `coarse_weight`, at least 1.
    pub coarse_sum: f32,
}

/// Side of a cell of the coarse flow, px.
const CELL: usize = 8;

impl RefinerBatch<'_> {
    /// Checks lengths and values for images of side `size_px` and copies to a device.
    ///
    /// # Errors
    /// A slice has the wrong length, or an image or a visible pixel's flow is not finite.
    pub fn to_device(&self, size_px: usize, device: &Device) -> Result<DeviceRefinerBatch> {
        RefinerConfig::check_size(size_px)?;
        self.check(size_px)?;
        let (n, side) = (self.n, size_px / CELL);
        let target = self.target(size_px * size_px);
        let (flow, weight) = coarse(&target, n, size_px);
        let coarse_sum = weight.iter().map(|&w| f64::from(w)).sum::<f64>().max(1.0) as f32;
        let tensor = |data: Vec<f32>, channels: usize, side: usize| {
            Tensor::from_data(TensorData::new(data, [n, channels, side, side]), device)
        };
        Ok(DeviceRefinerBatch {
            reference: tensor(self.reference.to_vec(), REFERENCE_CHANNELS, size_px),
            real: tensor(self.real.to_vec(), 3, size_px),
            target: tensor(target, 4, size_px),
            coarse_flow: tensor(flow, 2, side),
            coarse_weight: tensor(weight, 1, side),
            coarse_sum,
        })
    }

    fn check(&self, size_px: usize) -> Result<()> {
        let parts = [
            ("reference", self.reference, REFERENCE_CHANNELS),
            ("real", self.real, 3),
            ("flow", self.flow, 2),
            ("visible", self.visible, 1),
        ];
        for (name, data, channels) in parts {
            let (needed, found) = (self.n * channels * size_px * size_px, data.len());
            if self.n == 0 || found != needed {
                let n = self.n;
                let text =
                    format!("`{name}` has {found} values; {n} images of {size_px} px need {needed}, at least one");
                return Err(NetworkError::Batch(text));
            }
            if name != "flow" && data.iter().any(|v| !v.is_finite()) {
                return Err(NetworkError::Batch(format!("`{name}` has values that are not finite")));
            }
        }
        Ok(())
    }

    /// (n, 4, S, S): flow, whether it counts, visibility; flow is zero where it does not count. Only what is seen counts:
    /// where the photograph shows something else there is nothing to find.
    fn target(&self, area: usize) -> Vec<f32> {
        let mut target = vec![0.0; 4 * self.n * area];
        for (image, out) in target.chunks_exact_mut(4 * area).enumerate() {
            let flow = &self.flow[2 * image * area..][..2 * area];
            for i in 0..area {
                let visible = self.visible[image * area + i];
                let (x, y) = (flow[i], flow[area + i]);
                out[3 * area + i] = visible;
                if visible > 0.0 && x.hypot(y) < MAX_FLOW_PX {
                    (out[i], out[area + i], out[2 * area + i]) = (x, y, 1.0);
                }
            }
        }
        target
    }
}

/// Mean flow, px at 1/8, and share of the counted pixels of each cell.
fn coarse(target: &[f32], n: usize, size_px: usize) -> (Vec<f32>, Vec<f32>) {
    let (area, side) = (size_px * size_px, size_px / CELL);
    let (mut flow, mut weight) = (vec![0.0; 2 * n * side * side], vec![0.0; n * side * side]);
    for image in 0..n {
        let target = &target[4 * image * area..][..4 * area];
        let (out, share) = (&mut flow[2 * image * side * side..], &mut weight[image * side * side..]);
        for i in 0..area {
            if target[2 * area + i] > 0.0 {
                let cell = i / size_px / CELL * side + i % size_px / CELL;
                share[cell] += 1.0;
                out[cell] += target[i];
                out[side * side + cell] += target[area + i];
            }
        }
        for cell in 0..side * side {
            if share[cell] > 0.0 {
                let scale = 1.0 / (CELL as f32 * share[cell]);
                out[cell] *= scale;
                out[side * side + cell] *= scale;
                share[cell] /= (CELL * CELL) as f32;
            }
        }
    }
    (flow, weight)
}
