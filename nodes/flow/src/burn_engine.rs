//! The training's own network as an engine: burn over Vulkan or CUDA, which needs nothing but the driver, or on the
//! processor. Its flow differs from that of the ONNX engines by rounding (`tests/engines.rs` says how much).

use crate::FlowError;
use pseudoflow_inference::{Engine, InferenceError, Input, Output};
use pseudoflow_learning::{BuiltFlow, OpenDevice, Trainable as _};
use pseudoflow_network::{ComputeDevice, FlowNetwork, Weights};

const ENGINE: &str = "burn";

/// A device that burn computes on.
pub(crate) type BurnDevice = OpenDevice;

/// A device by its name.
///
/// # Errors
/// It is not compiled in or not there.
pub(crate) fn open_device(device: ComputeDevice) -> Result<BurnDevice, FlowError> {
    Ok(OpenDevice::open(device)?)
}

/// The GPU that `auto` finds.
pub(crate) fn gpu_of_auto() -> Option<BurnDevice> {
    OpenDevice::gpu_of_auto()
}

/// A network with its weights on a device.
pub(crate) struct BurnEngine {
    network: BuiltFlow,
    iterations: usize,
    device: OpenDevice,
}

impl BurnEngine {
    pub(crate) fn open(
        weights: &Weights,
        network: &FlowNetwork,
        iterations: usize,
        device: &OpenDevice,
    ) -> Result<Box<dyn Engine>, FlowError> {
        let network = network.build(weights, &device.device)?;
        Ok(Box::new(Self { network, iterations, device: device.clone() }))
    }

    /// Fields that a run computes for `n` wanted ones. A GPU chooses its kernels anew for every number that it has not
    /// seen: only powers of two are asked of it.
    fn padded(&self, n: usize) -> usize {
        if self.device.choice == ComputeDevice::Cpu { n } else { n.next_power_of_two() }
    }

    /// Flow and, of the refiner, certainty of `n` pairs.
    fn compute(&self, images: [&[f32]; 2], n: usize, size_px: usize) -> Result<[Vec<f32>; 2], String> {
        let padded = self.padded(n);
        let fill = |image: &[f32]| {
            let mut image = image.to_vec();
            image.resize(image.len() / n * padded, 0.0);
            image
        };
        let [reference, real] = images.map(fill);
        let answer = self.network.infer([&reference, &real], padded, size_px, self.iterations, &self.device.device);
        let (flow, certainty) = answer.map_err(|error| error.to_string())?;
        Ok([flow, certainty.unwrap_or_default()].map(|mut values| {
            values.truncate(values.len() / padded * n);
            values
        }))
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
        let &[n, _, size_px, _] = shape.as_slice() else { return Err(failed("images are (n, channels, S, S)".into())) };
        let [flow, certainty] = self.compute([named("reference")?, named("real")?], n, size_px).map_err(&failed)?;
        for output in outputs {
            let values = if output.name == "certainty" { &certainty } else { &flow };
            if output.data.len() != values.len() {
                return Err(failed(format!("output `{}` has {} values", output.name, values.len())));
            }
            output.data.copy_from_slice(values);
        }
        Ok(())
    }
}
