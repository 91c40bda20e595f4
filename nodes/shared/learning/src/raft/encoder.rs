//! Feature and context encoder: image to features at 1/8.

use super::conv::Conv;
use crate::model::Source;
use crate::ops;
use burn::tensor::Tensor;
use pseudoflow_network::Architecture;

/// Normalisation inside an encoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Norm {
    /// Instance norm after each convolution.
    Instance,
    /// None, or batch norm with stored statistics folded into the convolutions.
    None,
}

/// An encoder with its weights.
#[derive(Debug)]
pub(super) struct Encoder {
    norm: Norm,
    stem: Conv,
    blocks: Vec<Block>,
    head: Conv,
}

/// A residual block: convolutions with ReLU, plus the input (shrunk where the block shrinks), then ReLU.
#[derive(Debug)]
pub(crate) struct Block {
    convs: Vec<Conv>,
    shortcut: Option<Conv>,
}

/// Reads convolution `name`, with the batch norm `norm` folded into it if the network has one there.
pub(crate) fn normed_conv(source: &Source<'_>, name: &str, norm: &str, stride: usize) -> Conv {
    let (weight, bias) = source.conv(name);
    let Some([scale, shift]) = source.batch_norm(norm) else {
        return Conv::new((weight, bias), stride);
    };
    let o = scale.dims()[0];
    Conv::new((weight * scale.clone().reshape([o, 1, 1, 1]), bias * scale + shift), stride)
}

pub(crate) fn forward_normed(conv: &Conv, x: Tensor<4>, norm: Norm, relu: bool) -> Tensor<4> {
    match norm {
        Norm::Instance => ops::instance_norm(conv.forward(x, false), relu),
        Norm::None => conv.forward(x, relu),
    }
}

impl Block {
    pub(crate) fn new(source: &Source<'_>, name: &str, arch: Architecture, shrinks: bool) -> Self {
        let stride = if shrinks { 2 } else { 1 };
        let strides: &[usize] = match arch {
            Architecture::Basic => &[stride, 1],
            Architecture::Small => &[1, stride, 1],
        };
        let convs = strides.iter().enumerate().map(|(i, &stride)| {
            let i = i + 1;
            normed_conv(source, &format!("{name}.conv{i}"), &format!("{name}.norm{i}"), stride)
        });
        let shortcut = || normed_conv(source, &format!("{name}.downsample.0"), &format!("{name}.downsample.1"), 2);
        Self { convs: convs.collect(), shortcut: shrinks.then(shortcut) }
    }

    pub(crate) fn forward(&self, x: Tensor<4>, norm: Norm) -> Tensor<4> {
        let y = self.convs.iter().fold(x.clone(), |y, conv| forward_normed(conv, y, norm, true));
        let x = match &self.shortcut {
            Some(conv) => forward_normed(conv, x, norm, false),
            None => x,
        };
        ops::add_relu(x, y)
    }
}

impl Encoder {
    pub(super) fn new(source: &Source<'_>, name: &str, arch: Architecture, instance_norm: bool) -> Self {
        let norm = if instance_norm { Norm::Instance } else { Norm::None };
        let stem = normed_conv(source, &format!("{name}.conv1"), &format!("{name}.norm1"), 2);
        let blocks = (1..4).flat_map(|stage| (0..2).map(move |block| (stage, block)));
        let blocks = blocks.map(|(stage, block)| {
            let shrinks = stage > 1 && block == 0;
            Block::new(source, &format!("{name}.layer{stage}.{block}"), arch, shrinks)
        });
        let blocks = blocks.collect();
        Self { norm, stem, blocks, head: normed_conv(source, &format!("{name}.conv2"), "", 1) }
    }

    /// Images (N, 3, S, S) in [-1, 1] to features (N, C, S/8, S/8).
    pub(super) fn forward(&self, images: Tensor<4>) -> Tensor<4> {
        let x = forward_normed(&self.stem, images, self.norm, true);
        let x = self.blocks.iter().fold(x, |x, block| block.forward(x, self.norm));
        self.head.forward(x, false)
    }
}
