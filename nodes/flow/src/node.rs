use crate::{EngineConfig, FlowEngine, FlowError, interleave, normalise, open};
use pseudoflow_msgs::{FlowFields, FlowFieldsHeader, NetworkWeights, ReferenceViews};
use pseudoflow_network::{ExportOptions, NetworkConfig, Weights, export_onnx};
use pseudoflow_runtime::{Context, Inputs, Node, NodeError, Outputs, PortSpec, Role, read};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Settings of the flow node.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FlowConfig {
    /// The network: a `.onnx` file, or `.safetensors` weights that are exported to ONNX in memory.
    pub model: PathBuf,
    /// The network that `.safetensors` weights belong to.
    #[serde(default)]
    pub network: Network,
    /// Width and height of the crops, pixels; the renderer's `size_px`.
    #[serde(default = "default_size_px")]
    pub size_px: u32,
    /// Refinement iterations of an exported network (an `.onnx` file has its own).
    #[serde(default = "default_iterations")]
    pub iterations: u32,
    /// At most this many fields in one run of the network.
    #[serde(default = "default_batch")]
    pub max_batch: u32,
    /// Engine, provider, threads.
    #[serde(default)]
    pub engine: EngineConfig,
}

/// The networks that weights can belong to.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Network {
    /// RAFT-small, trained at 128 px.
    #[default]
    Nano,
    /// RAFT-small, trained at 256 px.
    Small,
    /// RAFT, trained at 256 px: the paper's.
    Paper,
}

impl Network {
    /// Its configuration.
    #[must_use]
    pub fn config(self) -> NetworkConfig {
        match self {
            Self::Nano => NetworkConfig::nano(),
            Self::Small => NetworkConfig::small(),
            Self::Paper => NetworkConfig::paper(),
        }
    }
}

fn default_size_px() -> u32 {
    128
}

fn default_iterations() -> u32 {
    12
}

fn default_batch() -> u32 {
    16
}

/// A network file as the bytes of an ONNX file: `.onnx` as it is, `.safetensors` exported for crops of `size_px`.
///
/// # Errors
/// When the file cannot be read or holds no such network.
pub fn load_model(path: &Path, network: Network, size_px: u32, iterations: u32) -> Result<Vec<u8>, FlowError> {
    let failed = |cause: String| FlowError::Model { path: path.to_owned(), cause };
    if path.extension().is_some_and(|extension| extension == "safetensors") {
        let config = network.config();
        let options = ExportOptions { size_px: size_px as usize, iterations: iterations as usize, batch: None };
        let weights = Weights::load(path, &config).map_err(|error| failed(error.to_string()))?;
        return export_onnx(&weights, &config, options).map_err(|error| failed(error.to_string()));
    }
    std::fs::read(path).map_err(|error| failed(error.to_string()))
}

/// Reference views in, flow fields out.
pub struct FlowNode {
    config: FlowConfig,
    engine: Box<dyn FlowEngine>,
    weights_version: u64,
    reference: Vec<f32>,
    real: Vec<f32>,
    planes: Vec<f32>,
}

impl FlowNode {
    /// Runs all views of a frame through the network, `max_batch` at a time.
    fn infer(&mut self, views: &ReferenceViews<'_>) -> Result<(), FlowError> {
        let size_px = self.config.size_px as usize;
        let values = size_px * size_px * 3;
        let per_instance = views.header.views_per_instance as usize;
        self.planes.resize(views.views.len() * size_px * size_px * 2, 0.0);
        let batch = self.config.max_batch as usize;
        for (at, planes) in self.planes.chunks_mut(batch * size_px * size_px * 2).enumerate() {
            let first = at * batch;
            let n = batch.min(views.views.len() - first);
            self.reference.resize(n * values, 0.0);
            self.real.resize(n * values, 0.0);
            normalise(&views.rgb[first * values..(first + n) * values], size_px, &mut self.reference);
            for (view, real) in self.real.chunks_exact_mut(values).enumerate() {
                let instance = (first + view) / per_instance;
                normalise(&views.real_rgb[instance * values..(instance + 1) * values], size_px, real);
            }
            self.engine.run(&self.reference, &self.real, n, size_px, planes)?;
        }
        Ok(())
    }

    /// Takes new weights in between two frames. The old engine serves until the new one is ready.
    fn swap(&mut self, weights: &NetworkWeights<'_>) -> Result<(), FlowError> {
        if weights.header.version != self.weights_version {
            self.engine = open(weights.onnx, &self.config.engine)?;
            self.weights_version = weights.header.version;
            log::debug!("weights {} of step {} are in use", weights.header.version, weights.header.step);
        }
        Ok(())
    }

    /// One run on grey images, so that the first frame finds memory and kernels ready.
    fn warm_up(&mut self) -> Result<(), FlowError> {
        let size_px = self.config.size_px as usize;
        let images = vec![0.0; size_px * size_px * 3];
        let mut flow_px = vec![0.0; size_px * size_px * 2];
        self.engine.run(&images, &images, 1, size_px, &mut flow_px)
    }
}

impl Node for FlowNode {
    const KIND: &'static str = "flow";
    const ROLE: Role = Role::Transform;
    type Config = FlowConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![
            PortSpec::required::<ReferenceViews<'static>>("views"),
            PortSpec::latest::<NetworkWeights<'static>>("weights"),
        ]
    }

    fn outputs() -> Vec<PortSpec> {
        vec![PortSpec::required::<FlowFields<'static>>("flow")]
    }

    fn check(config: &FlowConfig) -> Result<(), NodeError> {
        if !config.size_px.is_multiple_of(8) || !(64..=1024).contains(&config.size_px) {
            return Err(format!("`size_px: {}`: give a multiple of 8 in 64..=1024", config.size_px).into());
        }
        if !(1..=64).contains(&config.iterations) {
            return Err(format!("`iterations: {}`: give 1..=64", config.iterations).into());
        }
        if config.max_batch == 0 {
            return Err("`max_batch: 0`: give at least 1".into());
        }
        if !config.model.is_file() {
            let cause = "no such file".to_owned();
            return Err(FlowError::Model { path: config.model.clone(), cause }.into());
        }
        Ok(())
    }

    fn create(config: FlowConfig, _context: &Context) -> Result<Self, NodeError> {
        let onnx = load_model(&config.model, config.network, config.size_px, config.iterations)?;
        let engine = open(&onnx, &config.engine)?;
        log::info!("{} computes flow of {} px with {}", engine.describe(), config.size_px, config.model.display());
        let mut node = Self { config, engine, weights_version: 0, reference: vec![], real: vec![], planes: vec![] };
        node.warm_up()?;
        Ok(node)
    }

    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        if inputs.bytes("weights").is_some() {
            self.swap(&read::<NetworkWeights<'static>>(inputs, "weights")?)?;
        }
        let views = read::<ReferenceViews<'static>>(inputs, "views")?;
        let (size_px, views_px) = (self.config.size_px as usize, views.header.size_px as usize);
        if views_px != size_px {
            return Err(FlowError::Size { views_px, network_px: size_px }.into());
        }
        self.infer(&views)?;
        let header = FlowFieldsHeader {
            fields: views.views.len() as u32,
            size_px: self.config.size_px,
            weights_version: self.weights_version,
        };
        outputs.send("flow", inputs.key(), FlowFields::byte_len(&header), &mut |bytes| {
            interleave(&self.planes, size_px, FlowFields::write(bytes, header).flow_px);
        })
    }
}
