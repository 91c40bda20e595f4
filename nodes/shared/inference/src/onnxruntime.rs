use crate::{Engine, EngineConfig, ExecutionProvider, InferenceError, Input, Output};
use ort::environment::Environment;
use ort::ep::{ExecutionProvider as _, ExecutionProviderDispatch};
use ort::session::builder::GraphOptimizationLevel;
use ort::session::{Session, SessionInputValue};
use ort::value::TensorRef;
use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

const ENGINE: &str = "ONNX Runtime";

/// ONNX Runtime, loaded from the machine.
pub(crate) struct OnnxRuntime {
    session: Session,
    provider: ExecutionProvider,
    gpu: u16,
}

/// The library and its environment: a process has one, whatever the number of networks.
static LOADED: Mutex<Option<(PathBuf, Environment)>> = Mutex::new(None);

impl OnnxRuntime {
    pub(crate) fn open(onnx: &[u8], library: &Path, config: &EngineConfig) -> Result<Self, InferenceError> {
        let failed = |cause: String| InferenceError::Library { path: library.to_owned(), cause };
        let mut loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
        let (path, environment) = match loaded.take() {
            Some(found) => loaded.insert(found),
            None => loaded.insert((library.to_owned(), load(library).map_err(failed)?)),
        };
        if path != library {
            return Err(failed(format!("this process has loaded {} already", path.display())));
        }
        if !is_built_in(config.provider()).map_err(&failed)? {
            return Err(InferenceError::ProviderNotBuilt { provider: config.provider(), library: library.to_owned() });
        }
        let session = session(environment, onnx, config)
            .map_err(|cause| InferenceError::Load { engine: ENGINE, cause: cause.to_string() })?;
        Ok(Self { session, provider: config.provider(), gpu: config.gpu })
    }
}

fn load(library: &Path) -> Result<Environment, String> {
    let builder = ort::init_from(library).map_err(|error| error.to_string())?;
    builder.with_name("pseudoflow").build().map_err(|error| error.to_string())
}

fn session(environment: &Environment, onnx: &[u8], config: &EngineConfig) -> ort::Result<Session> {
    Session::builder(environment)?
        .with_optimization_level(GraphOptimizationLevel::All)?
        .with_intra_threads(config.threads)?
        .with_execution_providers(providers(config))?
        .commit_from_memory(onnx)
}

/// Whether the library was built with a provider; whether the machine has what it needs shows when a session opens.
fn is_built_in(provider: ExecutionProvider) -> Result<bool, String> {
    let found = match provider {
        ExecutionProvider::Cpu => Ok(true),
        ExecutionProvider::Cuda => ort::ep::CUDA::is_available(),
        ExecutionProvider::TensorRt => ort::ep::TensorRT::is_available(),
    };
    found.map_err(|error| error.to_string())
}

/// GPU providers are required: without one the session fails instead of computing elsewhere.
fn providers(config: &EngineConfig) -> Vec<ExecutionProviderDispatch> {
    let gpu = i32::from(config.gpu);
    let cuda = || ort::ep::CUDA::default().with_device_id(gpu).build().error_on_failure();
    let tensorrt = || ort::ep::TensorRT::default().with_device_id(gpu).build().error_on_failure();
    match config.provider() {
        ExecutionProvider::Cpu => vec![],
        ExecutionProvider::Cuda => vec![cuda()],
        ExecutionProvider::TensorRt => vec![tensorrt(), cuda()],
    }
}

impl Engine for OnnxRuntime {
    fn describe(&self) -> String {
        match self.provider {
            ExecutionProvider::Cpu => format!("{ENGINE} (Cpu)"),
            provider => format!("{ENGINE} ({provider:?}, GPU {})", self.gpu),
        }
    }

    fn run(&mut self, inputs: &[Input<'_>], outputs: &mut [Output<'_>]) -> Result<(), InferenceError> {
        let failed = |cause: String| {
            let (input, shape) =
                inputs.first().map_or_else(Default::default, |i| (i.name.to_owned(), i.shape.to_vec()));
            InferenceError::Run { engine: ENGINE, input, shape, cause }
        };
        let mut values: Vec<(Cow<'_, str>, SessionInputValue<'_>)> = Vec::with_capacity(inputs.len());
        for input in inputs {
            let tensor = TensorRef::from_array_view((input.shape, input.data)).map_err(|e| failed(e.to_string()))?;
            values.push((Cow::Borrowed(input.name), tensor.into()));
        }
        let found = self.session.run(values).map_err(|e| failed(e.to_string()))?;
        for output in outputs {
            let value = found.get(output.name).ok_or_else(|| failed(format!("no output `{}`", output.name)))?;
            let (_, data) = value.try_extract_tensor::<f32>().map_err(|e| failed(e.to_string()))?;
            copy(data, output).map_err(failed)?;
        }
        Ok(())
    }
}

/// The values of an output, if there are as many as wanted.
pub(crate) fn copy(data: &[f32], output: &mut Output<'_>) -> Result<(), String> {
    if data.len() != output.data.len() {
        return Err(format!("output `{}` has {} values, not {}", output.name, data.len(), output.data.len()));
    }
    output.data.copy_from_slice(data);
    Ok(())
}
