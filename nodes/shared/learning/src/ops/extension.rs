//! The bridge between burn and the kernels: one extension operation per number of inputs.
//!
//! Only the CPU backend (Flex) runs the kernels; [`crate::ops`] gives other devices burn's stock operations.

use crate::kernels::{Array, BackwardCall, Kernel, View};
use burn::backend::autodiff::{
    checkpoint::{base::Checkpointer, strategy::CheckpointStrategy},
    grads::Gradients,
    ops::{Backward, Ops, OpsKind},
};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Flex, backend_extension};
use burn::tensor::{Bytes, DType, Shape};
use burn_flex::{FlexTensor, Layout};
use std::sync::Arc;

/// A kernel as burn carries it.
pub(crate) type SharedKernel = Arc<dyn Kernel>;

/// Runs a kernel on one to five inputs, differentiably.
#[backend_extension(Flex, Autodiff)]
pub(crate) trait KernelBackend: Backend {
    /// One input.
    fn kernel1(a: FloatTensor<Self>, kernel: SharedKernel) -> FloatTensor<Self>;
    /// Two inputs.
    fn kernel2(a: FloatTensor<Self>, b: FloatTensor<Self>, kernel: SharedKernel) -> FloatTensor<Self>;
    /// Three inputs.
    fn kernel3(
        a: FloatTensor<Self>,
        b: FloatTensor<Self>,
        c: FloatTensor<Self>,
        kernel: SharedKernel,
    ) -> FloatTensor<Self>;
    /// Five inputs.
    fn kernel5(
        a: FloatTensor<Self>,
        b: FloatTensor<Self>,
        c: FloatTensor<Self>,
        d: FloatTensor<Self>,
        e: FloatTensor<Self>,
        kernel: SharedKernel,
    ) -> FloatTensor<Self>;
}

/// A Flex tensor with its shape and contiguous values at hand.
#[derive(Debug, Clone)]
struct Dense {
    shape: Vec<usize>,
    tensor: FlexTensor,
}

impl Dense {
    fn new(tensor: FlexTensor) -> Self {
        assert_eq!(tensor.dtype(), DType::F32, "the kernels take f32 tensors only");
        let tensor = tensor.to_contiguous();
        Self { shape: tensor.layout().shape().to_vec(), tensor }
    }

    fn data(&self) -> &[f32] {
        self.tensor.as_slice::<f32>().expect("contiguous by construction")
    }

    fn view(&self) -> View<'_> {
        View { shape: &self.shape, data: self.data() }
    }
}

fn to_flex(array: Array) -> FlexTensor {
    let layout = Layout::contiguous(Shape::from(array.shape));
    FlexTensor::new(Bytes::from_elems(array.data), layout, DType::F32)
}

fn run<const N: usize>(kernel: &SharedKernel, inputs: [FlexTensor; N]) -> FlexTensor {
    let inputs = inputs.map(Dense::new);
    let views = inputs.each_ref().map(Dense::view);
    to_flex(kernel.forward(&views, false).0)
}

/// What a tracked call keeps for its backward pass.
#[derive(Debug)]
struct Saved {
    kernel: SharedKernel,
    inputs: Vec<Dense>,
    output: Dense,
    kept: Vec<f32>,
}

#[derive(Debug)]
struct KernelBackward;

impl<const N: usize> Backward<Flex, N> for KernelBackward {
    type State = Arc<Saved>;

    fn backward(self, ops: Ops<Self::State, N>, grads: &mut Gradients, _checkpointer: &mut Checkpointer) {
        let grad = Dense::new(grads.consume::<Flex>(&ops.node));
        let saved = ops.state;
        let inputs: Vec<View<'_>> = saved.inputs.iter().map(Dense::view).collect();
        let wanted = ops.parents.each_ref().map(Option::is_some);
        let call = BackwardCall {
            inputs: &inputs,
            output: saved.output.view(),
            kept: &saved.kept,
            grad: grad.data(),
            wanted: &wanted,
        };
        for (parent, grad) in ops.parents.into_iter().zip(saved.kernel.backward(&call)) {
            if let (Some(parent), Some(grad)) = (parent, grad) {
                grads.register::<Flex>(parent.id, to_flex(grad));
            }
        }
    }
}

fn run_tracked<const N: usize, C: CheckpointStrategy>(
    kernel: SharedKernel,
    inputs: [FloatTensor<Autodiff<Flex, C>>; N],
) -> FloatTensor<Autodiff<Flex, C>> {
    let nodes = inputs.each_ref().map(|input| input.node());
    let primitives = inputs.map(|input| input.into_primitive());
    match KernelBackward.prepare::<C>(nodes).compute_bound().stateful() {
        OpsKind::UnTracked(prepared) => prepared.finish(run(&kernel, primitives)),
        OpsKind::Tracked(prepared) => {
            let inputs = primitives.map(Dense::new);
            let (output, kept) = kernel.forward(&inputs.each_ref().map(Dense::view), true);
            let output = Dense::new(to_flex(output));
            let tensor = output.tensor.clone();
            prepared.finish(Arc::new(Saved { kernel, inputs: inputs.into(), output, kept }), tensor)
        }
    }
}

impl KernelBackend for Flex {
    fn kernel1(a: FloatTensor<Self>, kernel: SharedKernel) -> FloatTensor<Self> {
        run(&kernel, [a])
    }

    fn kernel2(a: FloatTensor<Self>, b: FloatTensor<Self>, kernel: SharedKernel) -> FloatTensor<Self> {
        run(&kernel, [a, b])
    }

    fn kernel3(
        a: FloatTensor<Self>,
        b: FloatTensor<Self>,
        c: FloatTensor<Self>,
        kernel: SharedKernel,
    ) -> FloatTensor<Self> {
        run(&kernel, [a, b, c])
    }

    fn kernel5(
        a: FloatTensor<Self>,
        b: FloatTensor<Self>,
        c: FloatTensor<Self>,
        d: FloatTensor<Self>,
        e: FloatTensor<Self>,
        kernel: SharedKernel,
    ) -> FloatTensor<Self> {
        run(&kernel, [a, b, c, d, e])
    }
}

impl<C: CheckpointStrategy> KernelBackend for Autodiff<Flex, C> {
    fn kernel1(a: FloatTensor<Self>, kernel: SharedKernel) -> FloatTensor<Self> {
        run_tracked::<1, C>(kernel, [a])
    }

    fn kernel2(a: FloatTensor<Self>, b: FloatTensor<Self>, kernel: SharedKernel) -> FloatTensor<Self> {
        run_tracked::<2, C>(kernel, [a, b])
    }

    fn kernel3(
        a: FloatTensor<Self>,
        b: FloatTensor<Self>,
        c: FloatTensor<Self>,
        kernel: SharedKernel,
    ) -> FloatTensor<Self> {
        run_tracked::<3, C>(kernel, [a, b, c])
    }

    fn kernel5(
        a: FloatTensor<Self>,
        b: FloatTensor<Self>,
        c: FloatTensor<Self>,
        d: FloatTensor<Self>,
        e: FloatTensor<Self>,
        kernel: SharedKernel,
    ) -> FloatTensor<Self> {
        run_tracked::<5, C>(kernel, [a, b, c, d, e])
    }
}
