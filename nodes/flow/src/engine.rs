//! Which engine computes flow, on which device: chosen once at the start, logged, and then kept.

use crate::burn_engine::{BurnDevice, BurnEngine, gpu_of_auto, open_device};
use crate::loaded::Loaded;
use crate::{FlowConfig, FlowError};
use pseudoflow_inference::{Backend, Engine, EngineConfig, ExecutionProvider, open};
use pseudoflow_network::{ComputeDevice, ExportOptions, FlowNetwork, Weights, is_refiner_onnx};

/// What an engine runs.
pub(crate) enum Model {
    /// A whole ONNX file.
    Onnx(Vec<u8>),
    /// Weights of the network that the configuration names.
    Weights(Weights),
}

/// Opens engines of the kind that was chosen at the start: for new weights as well.
#[derive(Debug, Clone)]
pub(crate) struct Opener {
    network: FlowNetwork,
    options: ExportOptions,
    choice: Choice,
}

/// An engine and where it computes.
#[derive(Debug, Clone)]
enum Choice {
    /// ONNX Runtime or rten.
    Onnx(EngineConfig),
    /// The training's network.
    Burn(BurnDevice),
}

/// What may be chosen, in this order of preference.
#[derive(Debug, Clone, PartialEq)]
enum Attempt {
    Onnx(EngineConfig),
    Burn(ComputeDevice),
    /// The GPU that `auto` finds, or nothing.
    BurnOnGpu,
}

impl Opener {
    /// Chooses: the first engine that opens the model on the configured device.
    ///
    /// # Errors
    /// Device and engine do not go together, or none of those that do opens: the message says why of each.
    pub(crate) fn choose(
        config: &FlowConfig,
        network: &FlowNetwork,
        model: &Model,
    ) -> Result<(Self, Loaded), FlowError> {
        let mut reasons = Vec::new();
        for attempt in attempts(config.device, &config.engine)? {
            match Self::try_attempt(config, network, model, &attempt) {
                Ok(found) => return Ok(found),
                Err(error) => {
                    log::debug!("{attempt:?}: {error}");
                    reasons.push(error);
                }
            }
        }
        match reasons.len() {
            1 => Err(reasons.remove(0)),
            _ => {
                let reasons = reasons.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ");
                Err(FlowError::NoEngine { device: config.device.to_string(), reasons })
            }
        }
    }

    fn try_attempt(
        config: &FlowConfig,
        network: &FlowNetwork,
        model: &Model,
        attempt: &Attempt,
    ) -> Result<(Self, Loaded), FlowError> {
        let choice = match (attempt, model) {
            (Attempt::Onnx(engine), _) => Choice::Onnx(engine.clone()),
            (Attempt::Burn(_) | Attempt::BurnOnGpu, Model::Onnx(_)) => {
                return Err(pseudoflow_inference::InferenceError::NeedsWeights.into());
            }
            (Attempt::Burn(device), _) => Choice::Burn(open_device(*device)?),
            (Attempt::BurnOnGpu, _) => Choice::Burn(gpu_of_auto().ok_or(FlowError::NoGpu)?),
        };
        let iterations = config.iterations.map_or(network.iterations_infer(), |given| given as usize);
        let options = ExportOptions { size_px: config.size_px as usize, iterations, batch: None };
        let opener = Self { network: network.clone(), options, choice };
        let loaded = opener.open(model)?;
        Ok((opener, loaded))
    }

    /// The model on an engine of the chosen kind.
    ///
    /// # Errors
    /// The engine refuses the network.
    pub(crate) fn open(&self, model: &Model) -> Result<Loaded, FlowError> {
        let is_refiner = match model {
            Model::Onnx(onnx) => is_refiner_onnx(onnx),
            Model::Weights(_) => self.network.is_refiner(),
        };
        Ok(Loaded::new(self.engine(model)?, is_refiner, self.options.size_px))
    }

    fn engine(&self, model: &Model) -> Result<Box<dyn Engine>, FlowError> {
        match (&self.choice, model) {
            (Choice::Onnx(engine), Model::Onnx(onnx)) => Ok(open(onnx, engine)?),
            (Choice::Onnx(engine), Model::Weights(weights)) => {
                Ok(open(&self.network.export(weights, self.options)?, engine)?)
            }
            (Choice::Burn(device), Model::Weights(weights)) => {
                BurnEngine::open(weights, &self.network, self.options.iterations, device)
            }
            (Choice::Burn(_), Model::Onnx(_)) => Err(pseudoflow_inference::InferenceError::NeedsWeights.into()),
        }
    }

    /// Weights that came while the node runs.
    ///
    /// # Errors
    /// They belong to another network, or the engine refuses them.
    pub(crate) fn open_weights(&self, bytes: &[u8]) -> Result<Loaded, FlowError> {
        self.open(&Model::Weights(self.network.read(bytes, "the trainer's message")?))
    }
}

/// The engines that can compute on a device, best first.
fn attempts(device: ComputeDevice, engine: &EngineConfig) -> Result<Vec<Attempt>, FlowError> {
    let onnx = |engine: &EngineConfig| Attempt::Onnx(engine.clone());
    let on_gpu = |gpu: Option<u16>| Attempt::Onnx(engine.on_gpu(gpu.unwrap_or(engine.gpu)));
    let wants_gpu = engine.provider() != ExecutionProvider::Cpu;
    Ok(match (device, engine.backend) {
        (ComputeDevice::Cpu, Backend::Auto | Backend::OnnxRuntime | Backend::Rten) if !wants_gpu => vec![onnx(engine)],
        (ComputeDevice::Cpu | ComputeDevice::Vulkan(_), Backend::Burn) => vec![Attempt::Burn(device)],
        (ComputeDevice::Vulkan(_), Backend::Auto) if engine.provider.is_none() => vec![Attempt::Burn(device)],
        (ComputeDevice::Cuda(gpu), Backend::Auto) if engine.provider.is_none() => {
            vec![on_gpu(gpu), Attempt::Burn(device)]
        }
        (ComputeDevice::Cuda(gpu), Backend::Auto | Backend::OnnxRuntime)
            if engine.provider != Some(ExecutionProvider::Cpu) =>
        {
            vec![on_gpu(gpu)]
        }
        (ComputeDevice::Cuda(_), Backend::Burn) => vec![Attempt::Burn(device)],
        (ComputeDevice::Auto, Backend::Burn) => vec![Attempt::Burn(device)],
        (ComputeDevice::Auto, Backend::Auto) if engine.provider.is_none() => {
            vec![on_gpu(None), Attempt::BurnOnGpu, onnx(engine)]
        }
        (ComputeDevice::Auto, Backend::OnnxRuntime) if engine.provider.is_none() => vec![on_gpu(None), onnx(engine)],
        // Whoever names an engine of the processor, or a provider, has chosen.
        (ComputeDevice::Auto, _) => vec![onnx(engine)],
        (device, backend) => {
            let engine = format!("backend {backend:?}, provider {:?}", engine.provider());
            return Err(FlowError::DeviceAndEngine { device: device.to_string(), engine });
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn engine(backend: Backend, provider: Option<ExecutionProvider>) -> EngineConfig {
        EngineConfig { backend, provider, ..EngineConfig::default() }
    }

    fn of(device: &str, backend: Backend, provider: Option<ExecutionProvider>) -> Result<Vec<Attempt>, FlowError> {
        attempts(device.parse().unwrap(), &engine(backend, provider))
    }

    #[test]
    fn auto_ends_at_the_processor_and_a_named_gpu_never_does() {
        let auto = of("auto", Backend::Auto, None).unwrap();
        assert_eq!(auto.last(), Some(&Attempt::Onnx(engine(Backend::Auto, None))));
        assert_eq!(auto.len(), 3);
        for device in ["cuda:1", "vulkan", "vulkan:2"] {
            for attempt in of(device, Backend::Auto, None).unwrap() {
                match attempt {
                    Attempt::Onnx(engine) => assert_eq!((engine.provider(), engine.gpu), (ExecutionProvider::Cuda, 1)),
                    Attempt::Burn(burn) => assert_eq!(burn.to_string(), device),
                    Attempt::BurnOnGpu => panic!("{device} is one device"),
                }
            }
        }
    }

    #[test]
    fn what_was_named_is_what_is_tried() {
        let tensorrt = Some(ExecutionProvider::TensorRt);
        let one = |attempts: Result<Vec<Attempt>, FlowError>| {
            let attempts = attempts.unwrap();
            assert_eq!(attempts.len(), 1, "{attempts:?}");
            attempts[0].clone()
        };
        assert_eq!(one(of("auto", Backend::Rten, None)), Attempt::Onnx(engine(Backend::Rten, None)));
        assert_eq!(one(of("auto", Backend::Auto, tensorrt)), Attempt::Onnx(engine(Backend::Auto, tensorrt)));
        let expected = EngineConfig { gpu: 1, ..engine(Backend::OnnxRuntime, tensorrt) };
        assert_eq!(one(of("cuda:1", Backend::Auto, tensorrt)), Attempt::Onnx(expected));
        assert_eq!(one(of("cpu", Backend::Auto, None)), Attempt::Onnx(engine(Backend::Auto, None)));
    }

    #[test]
    fn what_does_not_go_together_is_refused() {
        let cuda = Some(ExecutionProvider::Cuda);
        for (device, backend, provider) in [
            ("cpu", Backend::Auto, cuda),
            ("vulkan", Backend::OnnxRuntime, None),
            ("vulkan", Backend::Auto, cuda),
            ("vulkan", Backend::Rten, None),
            ("cuda", Backend::Rten, None),
            ("cuda", Backend::OnnxRuntime, Some(ExecutionProvider::Cpu)),
        ] {
            let message = of(device, backend, provider).unwrap_err().to_string();
            assert!(message.contains(device) && message.contains(&format!("{backend:?}")), "{message}");
        }
    }
}
