//! The supervised sequence loss of RAFT on synthetic pairs (docs/method.md, "Synthetic pre-training").

use crate::ops;
use burn::tensor::{Device, Tensor, TensorData};
use pseudoflow_network::{NetworkError, Result};

/// Flows longer than this (px) are left out, as the authors do.
pub const MAX_FLOW_PX: f32 = 400.0;

/// Synthetic pairs with their true flow. Slices are row-major.
#[derive(Debug, Clone, Copy)]
pub struct FlowBatch<'a> {
    /// Rendered images (n, 3, S, S) in [-1, 1].
    pub reference: &'a [f32],
    /// Crops of the camera image (n, 3, S, S) in [-1, 1].
    pub real: &'a [f32],
    /// Flow from reference to real (n, 2, S, S), px. Values outside the mask are ignored, even NaN.
    pub flow: &'a [f32],
    /// Where the flow counts (n, 1, S, S): weight, 0 for pixels without truth.
    pub mask: &'a [f32],
    /// Pairs.
    pub n: usize,
}

/// A [`FlowBatch`] on a device, with the mask cut to [`MAX_FLOW_PX`].
#[derive(Debug)]
pub struct DeviceBatch {
    /// (n, 3, S, S).
    pub reference: Tensor<4>,
    /// (n, 3, S, S).
    pub real: Tensor<4>,
    /// (n, 2, S, S), zero where the mask is zero.
    pub flow: Tensor<4>,
    /// (n, 1, S, S).
    pub mask: Tensor<4>,
    /// Sum of the mask, at least 1.
    pub mask_sum: f32,
}

impl FlowBatch<'_> {
    /// Checks the lengths for images of side `size_px` and copies to a device.
    ///
    /// # Errors
    /// A slice has the wrong length, or an image, mask or counted flow is not finite.
    pub fn to_device(&self, size_px: usize, device: &Device) -> Result<DeviceBatch> {
        let area = size_px * size_px;
        let parts =
            [("reference", self.reference, 3), ("real", self.real, 3), ("flow", self.flow, 2), ("mask", self.mask, 1)];
        for (name, data, channels) in parts {
            let needed = self.n * channels * area;
            if self.n == 0 || data.len() != needed {
                let (n, found) = (self.n, data.len());
                let text =
                    format!("`{name}` has {found} values; {n} images of {size_px} px need {needed}, at least one");
                return Err(NetworkError::Batch(text));
            }
            if name != "flow" && data.iter().any(|v| !v.is_finite()) {
                return Err(NetworkError::Batch(format!("`{name}` has values that are not finite")));
            }
        }
        let (flow, mask) = self.counted(area);
        if flow.iter().any(|v| !v.is_finite()) {
            return Err(NetworkError::Batch("`flow` is not finite at pixels whose mask is not zero".into()));
        }
        let tensor = |data: Vec<f32>, channels: usize| {
            Tensor::from_data(TensorData::new(data, [self.n, channels, size_px, size_px]), device)
        };
        let mask_sum = mask.iter().map(|&m| f64::from(m)).sum::<f64>().max(1.0) as f32;
        Ok(DeviceBatch {
            reference: tensor(self.reference.to_vec(), 3),
            real: tensor(self.real.to_vec(), 3),
            flow: tensor(flow, 2),
            mask: tensor(mask, 1),
            mask_sum,
        })
    }

    /// Flow and mask with everything that does not count set to zero.
    fn counted(&self, area: usize) -> (Vec<f32>, Vec<f32>) {
        let (mut flow, mut mask) = (self.flow.to_vec(), self.mask.to_vec());
        for n in 0..self.n {
            let (fx, fy) = flow[2 * n * area..][..2 * area].split_at_mut(area);
            for ((fx, fy), mask) in fx.iter_mut().zip(fy).zip(&mut mask[n * area..][..area]) {
                if fx.hypot(*fy) >= MAX_FLOW_PX {
                    *mask = 0.0;
                }
                if *mask == 0.0 {
                    (*fx, *fy) = (0.0, 0.0);
                }
            }
        }
        (flow, mask)
    }
}

/// `sum over k of gamma^(K - 1 - k) sum of mask (|dx| + |dy|) / sum of mask`, px; a tensor of shape (1).
pub fn sequence_loss(flows: &[Tensor<4>], batch: &DeviceBatch, gamma: f32) -> Tensor<1> {
    let last = flows.len().saturating_sub(1);
    let terms = flows.iter().enumerate().map(|(k, flow)| {
        let weight = gamma.powi((last - k) as i32) / batch.mask_sum;
        ops::masked_l1(flow.clone(), batch.flow.clone(), batch.mask.clone()) * weight
    });
    terms.reduce(|a, b| a + b).unwrap_or_else(|| Tensor::zeros([1], &batch.flow.device()))
}

/// Mean end point error over the mask, px. `flow` and `truth` are (n, 2, S, S), `mask` is (n, 1, S, S).
pub fn end_point_error(flow: &[f32], truth: &[f32], mask: &[f32], n: usize) -> f32 {
    let area = mask.len() / n.max(1);
    let (mut sum, mut weight) = (0.0_f64, 0.0_f64);
    for (i, &m) in mask.iter().enumerate() {
        let at = (i / area) * 2 * area + i % area;
        if m > 0.0 {
            sum += f64::from(m * (flow[at] - truth[at]).hypot(flow[at + area] - truth[at + area]));
            weight += f64::from(m);
        }
    }
    (sum / weight.max(f64::MIN_POSITIVE)) as f32
}

/// [`end_point_error`] on the device, of shape (1), without a gradient.
pub(crate) fn device_end_point_error(flow: &Tensor<4>, batch: &DeviceBatch) -> Tensor<1> {
    let difference = flow.clone().detach() - batch.flow.clone();
    let length = (difference.clone() * difference).sum_dim(1).sqrt();
    (length * batch.mask.clone()).sum() / batch.mask_sum
}

/// Values of a tensor.
pub(crate) fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_into_vec::<f32>().expect("the network works in f32")
}

#[cfg(test)]
mod tests {
    use super::*;

    const AREA: usize = 16;

    fn batch<'a>(flow: &'a [f32], mask: &'a [f32], image: &'a [f32]) -> FlowBatch<'a> {
        FlowBatch { reference: image, real: image, flow, mask, n: 1 }
    }

    #[test]
    fn loss_and_error_by_hand() {
        let image = vec![0.0; 3 * AREA];
        let mut mask = vec![0.0; AREA];
        let mut flow = vec![f32::NAN; 2 * AREA];
        // Two pixels count; a third is too long.
        for (i, v) in [(0, [3.0, -4.0]), (5, [0.0, 1.0]), (6, [300.0, 300.0])] {
            mask[i] = 1.0;
            (flow[i], flow[i + AREA]) = (v[0], v[1]);
        }
        let device = Device::flex();
        let batch = batch(&flow, &mask, &image).to_device(4, &device).unwrap();
        assert_eq!(batch.mask_sum, 2.0);
        let zero = Tensor::zeros([1, 2, 4, 4], &device);
        let loss = values(sequence_loss(&[zero.clone(), zero.clone()], &batch, 0.8))[0];
        assert!((loss - (0.8 + 1.0) * (7.0 + 1.0) / 2.0).abs() < 1e-5, "{loss}");
        let epe = values(device_end_point_error(&zero, &batch))[0];
        let (truth, mask) = (values(batch.flow), values(batch.mask));
        assert!((end_point_error(&values(zero), &truth, &mask, 1) - 3.0).abs() < 1e-6);
        assert!((epe - 3.0).abs() < 1e-6, "{epe}");
    }

    #[test]
    fn bad_batches_are_refused() {
        let image = vec![0.0; 3 * AREA];
        let (flow, mask) = (vec![f32::NAN; 2 * AREA], vec![1.0; AREA]);
        let device = Device::flex();
        let text = batch(&flow, &mask, &image).to_device(4, &device).unwrap_err().to_string();
        assert!(text.contains("flow"), "{text}");
        let text = batch(&flow[1..], &mask, &image).to_device(4, &device).unwrap_err().to_string();
        assert!(text.contains("flow") && text.contains("32"), "{text}");
        let text = batch(&flow, &[f32::NAN; AREA], &image).to_device(4, &device).unwrap_err().to_string();
        assert!(text.contains("mask"), "{text}");
    }
}
