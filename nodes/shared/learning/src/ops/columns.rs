//! Convolution on a GPU: im2col by slices, then one matrix product, forward and backward.
//!
//! CubeCL has a dozen kernels for each convolution and finds the fastest of them by compiling and timing all, 6 s for each shape
//! on an H200 (of three passes and many layers); without that search its gradients of filters run on a few threads. Slices and matrix
//! products are a handful of kernels for all layers: a training starts within seconds.

use super::ConvSpec;
use burn::tensor::Tensor;
use burn::tensor::activation::relu;

/// As [`super::conv2d`], from slices and a matrix product.
pub(super) fn conv2d(x: Tensor<4>, w: Tensor<4>, b: Tensor<1>, spec: ConvSpec) -> Tensor<4> {
    let ([n, c, height, width], [o, _, kh, kw]) = (x.dims(), w.dims());
    let size = |length: usize, pad: usize, kernel: usize| (length + 2 * pad - kernel) / spec.stride + 1;
    let (out_h, out_w) = (size(height, spec.pad[0], kh), size(width, spec.pad[1], kw));
    let padded = zero_padded(x, spec);
    let tap = |i: usize| every(padded.clone(), [i / kw, i % kw], [out_h, out_w], spec.stride);
    let columns: Vec<Tensor<3>> = (0..kh * kw).map(|i| tap(i).reshape([n, c, out_h * out_w])).collect();
    let filters: Tensor<3> = w.permute([0, 2, 3, 1]).reshape([1, o, kh * kw * c]);
    let y = filters.matmul(Tensor::cat(columns, 1)).reshape([n, o, out_h, out_w]) + b.reshape([1, o, 1, 1]);
    if spec.relu { relu(y) } else { y }
}

/// With zeros around, and below and to the right as many more as the last step of a tap may reach.
fn zero_padded(x: Tensor<4>, spec: ConvSpec) -> Tensor<4> {
    let ([n, c, h, w], [pad_y, pad_x], more) = (x.dims(), spec.pad, spec.stride - 1);
    let device = x.device();
    let zeros = |shape: [usize; 4]| Tensor::<4>::zeros(shape, &device);
    let joined = |parts: Vec<Tensor<4>>, axis: usize| {
        let parts: Vec<_> = parts.into_iter().filter(|part| part.dims().iter().all(|length| *length > 0)).collect();
        Tensor::cat(parts, axis)
    };
    let wide = joined(vec![zeros([n, c, h, pad_x]), x, zeros([n, c, h, pad_x + more])], 3);
    let full_w = w + 2 * pad_x + more;
    joined(vec![zeros([n, c, pad_y, full_w]), wide, zeros([n, c, pad_y + more, full_w])], 2)
}

/// Of the values from a place on every `stride`-th, so many in each direction.
fn every(x: Tensor<4>, [y0, x0]: [usize; 2], [rows, columns]: [usize; 2], stride: usize) -> Tensor<4> {
    let ([n, c, ..], s) = (x.dims(), stride);
    let part = x.slice([0..n, 0..c, y0..y0 + rows * s, x0..x0 + columns * s]);
    if s == 1 {
        return part;
    }
    let cells: Tensor<6> = part.reshape([n, c, rows, s, columns, s]);
    cells.slice([0..n, 0..c, 0..rows, 0..1, 0..columns, 0..1]).reshape([n, c, rows, columns])
}
