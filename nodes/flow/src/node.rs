use crate::engine::{Model, Opener};
use crate::{FlowError, interleave};
use pseudoflow_inference::{Engine, EngineConfig, Input, Output, normalise};
use pseudoflow_msgs::{FlowFields, FlowFieldsHeader, NetworkWeights, ReferenceViews};
use pseudoflow_network::{ComputeDevice, ExportOptions, NetworkConfig, Weights, export_onnx};
use pseudoflow_runtime::{Context, Inputs, Node, NodeError, Outputs, PortSpec, Role, read};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Settings of the flow node.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FlowConfig {
    /// The network: a `.onnx` file, or `.safetensors` weights, which become ONNX in memory or run as they are on a GPU.
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
    /// What computes: auto, cpu, vulkan[:N] or cuda[:N]. `auto` takes ONNX Runtime's CUDA where its library has it, else a
    /// GPU of which this binary knows, else the processor; the log says which. The same bits come out on the processor only.
    #[serde(default)]
    pub device: ComputeDevice,
    /// Engine, provider, threads.
    #[serde(default)]
    pub engine: EngineConfig,
    /// Training: which frames wait for which weights. Without it the newest weights are used.
    #[serde(default)]
    pub lockstep: Option<Lockstep>,
}

/// How weights that come back from training are put into use: at frames that are known beforehand, whatever the speed of
/// anything, so that a run can be repeated to the bit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Lockstep {
    /// Frames of one training step.
    pub frames_per_step: u64,
    /// Training steps between two publications of the teacher.
    pub publish_every: u64,
    /// Step that frame 0 belongs to, when a training is resumed.
    #[serde(default)]
    pub first_step: u64,
}

impl Lockstep {
    /// The publication that labels a frame: the one before the newest that can have come, so that labelling a step need
    /// not wait for the step before. Its age is `publish_every` to `2 publish_every - 1` steps.
    #[must_use]
    pub fn publication_for(&self, frame: u64) -> u64 {
        let step = self.first_step + frame / self.frames_per_step;
        (step / self.publish_every).saturating_sub(1)
    }
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
    let options = ExportOptions { size_px: size_px as usize, iterations: iterations as usize, batch: None };
    match load(path, network)? {
        Model::Onnx(onnx) => Ok(onnx),
        Model::Weights(weights) => {
            export_onnx(&weights, &network.config(), options).map_err(|error| failed(error.to_string()))
        }
    }
}

fn load(path: &Path, network: Network) -> Result<Model, FlowError> {
    let failed = |cause: String| FlowError::Model { path: path.to_owned(), cause };
    if path.extension().is_some_and(|extension| extension == "safetensors") {
        let weights = Weights::load(path, &network.config()).map_err(|error| failed(error.to_string()))?;
        return Ok(Model::Weights(weights));
    }
    Ok(Model::Onnx(std::fs::read(path).map_err(|error| failed(error.to_string()))?))
}

/// Reference views in, flow fields out.
pub struct FlowNode {
    config: FlowConfig,
    opener: Opener,
    engine: Box<dyn Engine>,
    /// `None` while those of the start serve.
    weights_version: Option<u64>,
    /// In lockstep: what served before, for frames that another node's death brings back.
    before: Option<(u64, Box<dyn Engine>)>,
    reference: Vec<f32>,
    real: Vec<f32>,
    planes: Vec<f32>,
}

/// Reference and real image of every field, in the order of the message: views, then partners (`None` where absent).
fn pairs<'a>(views: &ReferenceViews<'a>, values: usize) -> Vec<Option<(&'a [u8], &'a [u8])>> {
    let (n, m) = (views.header.views_per_instance as usize, views.header.partners_per_instance as usize);
    let reference = |view: usize| &views.rgb[view * values..(view + 1) * values];
    let real = |instance: usize| &views.real_rgb[instance * values..(instance + 1) * values];
    let of_views = (0..views.views.len()).map(|view| Some((reference(view), real(view / n))));
    let of_partners = views.partners.iter().enumerate().map(|(p, partner)| {
        let crop = &views.partner_rgb[p * values..(p + 1) * values];
        (partner.present == 1).then(|| (reference(p / m * n), crop))
    });
    of_views.chain(of_partners).collect()
}

/// Computes `n` fields: reference and real images are `n x 3 x S x S`, `flow_px` is `n x 2 x S x S`.
fn run(
    engine: &mut dyn Engine,
    [reference, real]: [&[f32]; 2],
    n: usize,
    size_px: usize,
    flow_px: &mut [f32],
) -> Result<(), FlowError> {
    let shape = [n, 3, size_px, size_px];
    let inputs = [("reference", reference), ("real", real)].map(|(name, data)| Input { name, shape: &shape, data });
    Ok(engine.run(&inputs, &mut [Output { name: "flow", data: flow_px }])?)
}

impl FlowNode {
    /// Runs all pairs of a frame through the network, `max_batch` at a time. What has no image keeps zero flow.
    fn infer(&mut self, views: &ReferenceViews<'_>) -> Result<(), FlowError> {
        let size_px = self.config.size_px as usize;
        let (values, field) = (size_px * size_px * 3, size_px * size_px * 2);
        let pairs = pairs(views, values);
        self.planes.clear();
        self.planes.resize(pairs.len() * field, 0.0);
        let present: Vec<usize> = (0..pairs.len()).filter(|pair| pairs[*pair].is_some()).collect();
        let mut flow_px = Vec::new();
        for batch in present.chunks(self.config.max_batch as usize) {
            self.reference.resize(batch.len() * values, 0.0);
            self.real.resize(batch.len() * values, 0.0);
            flow_px.resize(batch.len() * field, 0.0);
            let images = batch.iter().filter_map(|pair| pairs[*pair]);
            let out = self.reference.chunks_exact_mut(values).zip(self.real.chunks_exact_mut(values));
            for ((reference, real), (reference_out, real_out)) in images.zip(out) {
                normalise(reference, size_px * size_px, reference_out);
                normalise(real, size_px * size_px, real_out);
            }
            run(&mut *self.engine, [&self.reference, &self.real], batch.len(), size_px, &mut flow_px)?;
            for (pair, flow_px) in batch.iter().zip(flow_px.chunks_exact(field)) {
                self.planes[pair * field..(pair + 1) * field].copy_from_slice(flow_px);
            }
        }
        Ok(())
    }

    /// Takes new weights in between two frames. The old engine serves until the new one is ready.
    fn swap(&mut self, weights: &NetworkWeights<'_>, frame: u64) -> Result<(), FlowError> {
        let newest = weights.header.version;
        let wanted = self.config.lockstep.map_or(newest, |lockstep| lockstep.publication_for(frame));
        if self.weights_version == Some(wanted) {
            return Ok(());
        }
        let engine = match self.before.take() {
            Some((version, engine)) if version == wanted => engine,
            // `ready` lets only frames through that want one of the two.
            _ if newest == wanted => self.opener.open_weights(weights.weights)?,
            _ => self.opener.open_weights(weights.previous)?,
        };
        let served = std::mem::replace(&mut self.engine, engine);
        let version = self.weights_version.replace(wanted);
        self.before = version.filter(|_| self.config.lockstep.is_some()).map(|version| (version, served));
        log::debug!("publication {wanted} is in use from frame {frame} on");
        Ok(())
    }

    /// One run on grey images, so that the first frame finds memory and kernels ready.
    fn warm_up(&mut self) -> Result<(), FlowError> {
        let size_px = self.config.size_px as usize;
        let images = vec![0.0; size_px * size_px * 3];
        let mut flow_px = vec![0.0; size_px * size_px * 2];
        run(&mut *self.engine, [&images, &images], 1, size_px, &mut flow_px)
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
        if config.lockstep.is_some_and(|l| l.frames_per_step == 0 || l.publish_every == 0) {
            return Err("`lockstep`: `frames_per_step` and `publish_every` must be at least 1".into());
        }
        if !config.model.is_file() {
            let cause = "no such file".to_owned();
            return Err(FlowError::Model { path: config.model.clone(), cause }.into());
        }
        Ok(())
    }

    fn create(config: FlowConfig, _context: &Context) -> Result<Self, NodeError> {
        let (opener, engine) = Opener::choose(&config, &load(&config.model, config.network)?)?;
        log::info!("{} computes flow of {} px with {}", engine.describe(), config.size_px, config.model.display());
        let (reference, real, planes) = (Vec::new(), Vec::new(), Vec::new());
        let mut node = Self { config, opener, engine, weights_version: None, before: None, reference, real, planes };
        node.warm_up()?;
        Ok(node)
    }

    fn ready(&self, inputs: &dyn Inputs) -> Result<bool, NodeError> {
        let Some(lockstep) = self.config.lockstep else { return Ok(true) };
        let wanted = lockstep.publication_for(inputs.key().index);
        if self.weights_version == Some(wanted) || self.before.as_ref().is_some_and(|(version, _)| *version == wanted) {
            return Ok(true);
        }
        if inputs.bytes("weights").is_none() {
            return Ok(false);
        }
        let header = read::<NetworkWeights<'static>>(inputs, "weights")?.header;
        let (here, there) = (lockstep.frames_per_step * lockstep.publish_every, header.frames_per_version);
        if here != there {
            return Err(FlowError::OutOfStep { here, there }.into());
        }
        // A frame whose weights are gone is sent again after a death and in a checkpoint of the trainer already, or that
        // publication would not have been sent: the acknowledgement that takes it away is on its way.
        Ok((wanted..=wanted + 1).contains(&header.version))
    }

    fn objects(inputs: &dyn Inputs) -> Option<usize> {
        Some(read::<ReferenceViews<'static>>(inputs, "views").ok()?.objects())
    }

    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        if inputs.bytes("weights").is_some() {
            self.swap(&read::<NetworkWeights<'static>>(inputs, "weights")?, inputs.key().index)?;
        }
        let views = read::<ReferenceViews<'static>>(inputs, "views")?;
        let (size_px, views_px) = (self.config.size_px as usize, views.header.size_px as usize);
        if views_px != size_px {
            return Err(FlowError::Size { views_px, network_px: size_px }.into());
        }
        self.infer(&views)?;
        let header = FlowFieldsHeader {
            fields: (views.views.len() + views.partners.len()) as u32,
            size_px: self.config.size_px,
            weights_version: self.weights_version.unwrap_or(0),
        };
        outputs.send("flow", inputs.key(), FlowFields::byte_len(&header), &mut |bytes| {
            interleave(&self.planes, size_px, FlowFields::write(bytes, header).flow_px);
        })
    }
}
