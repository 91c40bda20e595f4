//! The training's own network as an engine: burn over Vulkan or CUDA, which needs nothing but the driver, or on the
//! processor. Its flow differs from that of the ONNX engines by rounding (`tests/engines.rs` says how much).

use crate::FlowError;
use pseudoflow_inference::{Engine, InferenceError, Input, Output};
use pseudoflow_network::{ComputeDevice, NetworkConfig, OpenDevice, Raft, Weights};

const ENGINE: &str = "burn";

/// A network with its weights on a device.
pub(crate) struct BurnEngine {
    raft: Raft,
    iterations: usize,
    device: OpenDevice,
}

impl BurnEngine {
    pub(crate) fn open(
        weights: &Weights,
        network: &NetworkConfig,
        iterations: usize,
        device: &OpenDevice,
    ) -> Result<Self, FlowError> {
        let raft = Raft::new(weights, network, &device.device)?;
        Ok(Self { raft, iterations, device: device.clone() })
    }

    /// Fields that a run computes for `n` wanted ones. A GPU chooses its kernels anew for every number that it has not
    /// seen: only powers of two are asked of it.
    fn padded(&self, n: usize) -> usize {
        if self.device.choice == ComputeDevice::Cpu { n } else { n.next_power_of_two() }
    }

    fn compute(&self, [reference, real]: [&[f32]; 2], n: usize, size_px: usize) -> Result<Vec<f32>, String> {
        let padded = self.padded(n);
        let fill = |image: &[f32]| {
            let mut image = image.to_vec();
            image.resize(image.len() / n * padded, 0.0);
            image
        };
        let (reference, real) = (fill(reference), fill(real));
        let flow = self.raft.infer_slices(&reference, &real, padded, size_px, self.iterations, &self.device.device);
        let mut flow = flow.map_err(|error| error.to_string())?;
        flow.truncate(flow.len() / padded * n);
        Ok(flow)
    }
}

impl Engine for BurnEngine {
    fn describe(&self) -> String {
        format!("{ENGINE} on {}", self.device)
    }

    fn run(&mut self, inputs: &[Input<'_>], outputs: &mut [Output<'_>]) -> Result<(), InferenceError> {
        let shape = inputs.first().map_or_else(Vec::new, |input| input.shape.to_vec());
        let failed = |cause: String| InferenceError::Run {
            engine: ENGINE,
            input: "reference".into(),
            shape: shape.clone(),
            cause,
        };
        let named = |name: &str| {
            let found = inputs.iter().find(|input| input.name == name);
            found.map(|input| input.data).ok_or_else(|| failed(format!("no input `{name}`")))
        };
        let &[n, 3, size_px, _] = shape.as_slice() else { return Err(failed("images are (n, 3, S, S)".into())) };
        let flow = self.compute([named("reference")?, named("real")?], n, size_px).map_err(&failed)?;
        for output in outputs {
            if output.data.len() != flow.len() {
                return Err(failed(format!("output `{}` has {} values", output.name, flow.len())));
            }
            output.data.copy_from_slice(&flow);
        }
        Ok(())
    }
}
