//! A convolution with its weights, prepared for its kernel.

use crate::ops::{self, ConvSpec, Prepared3x3};
use burn::tensor::Tensor;

/// Input channels and filters from which on Winograd's transforms cost less than they save.
const WINOGRAD_FROM: usize = 32;
const WINOGRAD_FILTERS: usize = 8;

/// A convolution padded by half its kernel, as all of RAFT's are.
#[derive(Debug)]
pub(crate) enum Conv {
    /// Any kernel and stride.
    General { weight: Tensor<4>, bias: Tensor<1>, stride: usize },
    /// 3x3 of stride 1.
    Same3x3(Prepared3x3),
}

impl Conv {
    /// From weights (O, C, kh, kw) and bias (O).
    pub(crate) fn new((weight, bias): (Tensor<4>, Tensor<1>), stride: usize) -> Self {
        let [o, c, kh, kw] = weight.dims();
        if [kh, kw] == [3, 3] && stride == 1 && c >= WINOGRAD_FROM && o >= WINOGRAD_FILTERS {
            return Self::Same3x3(Prepared3x3::new(weight, bias));
        }
        Self::General { weight, bias, stride }
    }

    /// x (N, C, H, W) to (N, O, H / stride, W / stride).
    pub(crate) fn forward(&self, x: Tensor<4>, relu: bool) -> Tensor<4> {
        match self {
            Self::Same3x3(prepared) => ops::conv3x3(x, prepared, relu),
            Self::General { weight, bias, stride } => {
                let [_, _, kh, kw] = weight.dims();
                let spec = ConvSpec { stride: *stride, pad: [kh / 2, kw / 2], relu };
                ops::conv2d(x, weight.clone(), bias.clone(), spec)
            }
        }
    }
}
