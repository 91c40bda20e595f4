use crate::{EngineConfig, ExecutionProvider, FlowEngine, FlowError};
use ort::environment::Environment;
use ort::ep::ExecutionProviderDispatch;
use ort::session::Session;
use ort::session::builder::GraphOptimizationLevel;
use ort::value::TensorRef;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

const ENGINE: &str = "ONNX Runtime";

/// ONNX Runtime, loaded from the machine.
pub(crate) struct OnnxRuntime {
    session: Session,
    provider: ExecutionProvider,
}

/// The library and its environment: a process has one, whatever the number of networks.
static LOADED: Mutex<Option<(PathBuf, Environment)>> = Mutex::new(None);

impl OnnxRuntime {
    pub(crate) fn open(onnx: &[u8], library: &Path, config: &EngineConfig) -> Result<Self, FlowError> {
        let failed = |cause: String| FlowError::Library { path: library.to_owned(), cause };
        let mut loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
        let (path, environment) = match loaded.take() {
            Some(found) => loaded.insert(found),
            None => loaded.insert((library.to_owned(), load(library).map_err(failed)?)),
        };
        if path != library {
            return Err(failed(format!("this process has loaded {} already", path.display())));
        }
        let session = session(environment, onnx, config)
            .map_err(|cause| FlowError::Load { engine: ENGINE, cause: cause.to_string() })?;
        Ok(Self { session, provider: config.provider })
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
        .with_execution_providers(providers(config.provider))?
        .commit_from_memory(onnx)
}

/// GPU providers are required: without one the session fails instead of computing elsewhere.
fn providers(provider: ExecutionProvider) -> Vec<ExecutionProviderDispatch> {
    let cuda = || ort::ep::CUDA::default().build().error_on_failure();
    match provider {
        ExecutionProvider::Cpu => vec![],
        ExecutionProvider::Cuda => vec![cuda()],
        ExecutionProvider::TensorRt => vec![ort::ep::TensorRT::default().build().error_on_failure(), cuda()],
    }
}

impl FlowEngine for OnnxRuntime {
    fn describe(&self) -> String {
        format!("{ENGINE} ({:?})", self.provider)
    }

    fn run(
        &mut self,
        reference: &[f32],
        real: &[f32],
        n: usize,
        size_px: usize,
        flow_px: &mut [f32],
    ) -> Result<(), FlowError> {
        let shape = [n, 3, size_px, size_px];
        let mut run = || -> ort::Result<()> {
            let outputs = self.session.run(ort::inputs![
                "reference" => TensorRef::from_array_view((shape, reference))?,
                "real" => TensorRef::from_array_view((shape, real))?,
            ])?;
            flow_px.copy_from_slice(outputs["flow"].try_extract_tensor::<f32>()?.1);
            Ok(())
        };
        run().map_err(|cause| FlowError::Run { engine: ENGINE, fields: n, size_px, cause: cause.to_string() })
    }
}
