use crate::engine::{Model, Opener};
use crate::loaded::Loaded;
use crate::{FlowError, interleave};
use pseudoflow_inference::EngineConfig;
use pseudoflow_msgs::{FlowFields, FlowFieldsHeader, NetworkWeights, ReferenceViews};
use pseudoflow_network::{ComputeDevice, ExportOptions, FlowNetwork, NetworkConfig, NetworkError, RefinerConfig};
use pseudoflow_runtime::{Context, Inputs, Node, NodeError, Outputs, Port, PortSpec, Role};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

const VIEWS: Port<ReferenceViews<'static>> = Port::required("views");
const WEIGHTS: Port<NetworkWeights<'static>> = Port::latest("weights");
const FLOW: Port<FlowFields<'static>> = Port::required("flow");

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
    /// Refinement iterations of an exported network (an `.onnx` file has its own); the network's own number where absent.
    #[serde(default)]
    pub iterations: Option<u32>,
    /// At most this many fields in one run of the network.
    #[serde(default = "default_batch")]
    pub max_batch: u32,
    /// What computes: auto, cpu, `vulkan[:N]` or `cuda[:N]`. `auto` takes ONNX Runtime's CUDA where its library has it, else a
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
    /// As the weights say: the refiner, or else RAFT-small.
    #[default]
    Auto,
    /// The refiner for all objects.
    Refiner,
    /// RAFT-small, trained at 128 px.
    Nano,
    /// RAFT-small, trained at 256 px.
    Small,
    /// RAFT, trained at 256 px: the paper's.
    Paper,
}

impl Network {
    /// The network of a file.
    ///
    /// # Errors
    /// The file is unreadable or damaged.
    pub fn of(self, path: &Path) -> Result<FlowNetwork, NetworkError> {
        let is_weights = path.extension().is_some_and(|extension| extension == "safetensors");
        Ok(match self {
            Self::Auto if is_weights => FlowNetwork::of_weights(path)?,
            Self::Auto | Self::Nano => FlowNetwork::Raft(NetworkConfig::nano()),
            Self::Small => FlowNetwork::Raft(NetworkConfig::small()),
            Self::Paper => FlowNetwork::Raft(NetworkConfig::paper()),
            Self::Refiner => FlowNetwork::Refiner(RefinerConfig::default()),
        })
    }
}

fn default_size_px() -> u32 {
    128
}

fn default_batch() -> u32 {
    16
}

/// A network file as the bytes of an ONNX file: `.onnx` as it is, `.safetensors` exported for crops of `size_px`, with the
/// network's own number of iterations where none is given.
///
/// # Errors
/// When the file cannot be read or holds no such network.
pub fn load_model(path: &Path, network: Network, size_px: u32, iterations: Option<u32>) -> Result<Vec<u8>, FlowError> {
    let failed = |cause: String| FlowError::Model { path: path.to_owned(), cause };
    let network = network.of(path).map_err(|error| failed(error.to_string()))?;
    match load(path, &network)? {
        Model::Onnx(onnx) => Ok(onnx),
        Model::Weights(weights) => {
            let iterations = iterations.map_or(network.iterations_infer(), |given| given as usize);
            let options = ExportOptions { size_px: size_px as usize, iterations, batch: None };
            network.export(&weights, options).map_err(|error| failed(error.to_string()))
        }
    }
}

fn load(path: &Path, network: &FlowNetwork) -> Result<Model, FlowError> {
    let failed = |cause: String| FlowError::Model { path: path.to_owned(), cause };
    if path.extension().is_some_and(|extension| extension == "safetensors") {
        let weights = network.load(path).map_err(|error| failed(error.to_string()))?;
        return Ok(Model::Weights(weights));
    }
    Ok(Model::Onnx(std::fs::read(path).map_err(|error| failed(error.to_string()))?))
}

/// Reference views in, flow fields out.
pub struct FlowNode {
    config: FlowConfig,
    opener: Opener,
    network: Loaded,
    /// `None` while those of the start serve.
    weights_version: Option<u64>,
    /// In lockstep: what served before, for frames that another node's death brings back.
    before: Option<(u64, Loaded)>,
    planes: Vec<f32>,
    certainty: Vec<u8>,
}

/// What the network compares for a field: a rendering, its depth and intrinsics, and a real crop.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pair<'a> {
    pub(crate) reference_rgb: &'a [u8],
    pub(crate) reference_depth_m: &'a [f32],
    /// Focal length of the crop, px: the mean of both directions.
    pub(crate) focal_px: f64,
    pub(crate) real_rgb: &'a [u8],
}

/// The pair of every field, in the order of the message: views, then partners (`None` where absent).
fn pairs<'a>(views: &ReferenceViews<'a>, area: usize) -> Vec<Option<Pair<'a>>> {
    let (n, m) = (views.header.views_per_instance as usize, views.header.partners_per_instance as usize);
    let pair = |view: usize, real_rgb: &'a [u8]| Pair {
        reference_rgb: &views.rgb[view * 3 * area..(view + 1) * 3 * area],
        reference_depth_m: &views.depth_m[view * area..(view + 1) * area],
        focal_px: (views.views[view].crop_intrinsics[0] + views.views[view].crop_intrinsics[1]) / 2.0,
        real_rgb,
    };
    let crop = |crops: &'a [u8], i: usize| &crops[i * 3 * area..(i + 1) * 3 * area];
    let of_views = (0..views.views.len()).map(|view| Some(pair(view, crop(views.real_rgb, view / n))));
    let of_partners = views
        .partners
        .iter()
        .enumerate()
        .map(|(p, partner)| (partner.present == 1).then(|| pair(p / m * n, crop(views.partner_rgb, p))));
    of_views.chain(of_partners).collect()
}

impl FlowNode {
    /// Runs all pairs of a frame through the network, `max_batch` at a time. What has no image keeps zero flow.
    fn infer(&mut self, views: &ReferenceViews<'_>) -> Result<(), FlowError> {
        let area = (self.config.size_px as usize).pow(2);
        let pairs = pairs(views, area);
        self.planes.clear();
        self.planes.resize(pairs.len() * 2 * area, 0.0);
        self.certainty.clear();
        self.certainty.resize(if self.network.has_certainty() { self.planes.len() } else { 0 }, 0);
        let present: Vec<usize> = (0..pairs.len()).filter(|pair| pairs[*pair].is_some()).collect();
        for batch in present.chunks(self.config.max_batch as usize) {
            let images: Vec<Pair<'_>> = batch.iter().filter_map(|pair| pairs[*pair]).collect();
            let answer = self.network.run(&images)?;
            for (i, pair) in batch.iter().enumerate() {
                let (from, to) = (i * 2 * area..(i + 1) * 2 * area, pair * 2 * area..(pair + 1) * 2 * area);
                self.planes[to.clone()].copy_from_slice(&answer.flow_px[from.clone()]);
                if let Some(certainty) = answer.certainty {
                    let out = self.certainty[to].iter_mut().zip(&certainty[from]);
                    out.for_each(|(out, value)| *out = (value * 255.0 + 0.5) as u8);
                }
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
        let network = match self.before.take() {
            Some((version, network)) if version == wanted => network,
            // `ready` lets only frames through that want one of the two.
            _ if newest == wanted => self.opener.open_weights(weights.weights)?,
            _ => self.opener.open_weights(weights.previous)?,
        };
        let served = std::mem::replace(&mut self.network, network);
        let version = self.weights_version.replace(wanted);
        self.before = version.filter(|_| self.config.lockstep.is_some()).map(|version| (version, served));
        log::debug!("publication {wanted} is in use from frame {frame} on");
        Ok(())
    }
}

impl Node for FlowNode {
    const KIND: &'static str = "flow";
    const ROLE: Role = Role::Transform;
    type Config = FlowConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![VIEWS.spec(), WEIGHTS.spec()]
    }

    fn outputs() -> Vec<PortSpec> {
        vec![FLOW.spec()]
    }

    fn check(config: &FlowConfig) -> Result<(), NodeError> {
        if !config.size_px.is_multiple_of(8) || !(64..=1024).contains(&config.size_px) {
            return Err(format!("`size_px: {}`: give a multiple of 8 in 64..=1024", config.size_px).into());
        }
        if let Some(iterations) = config.iterations.filter(|n| !(1..=64).contains(n)) {
            return Err(format!("`iterations: {iterations}`: give 1..=64").into());
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
        let network = config.network.of(&config.model)?;
        let (opener, mut network) = Opener::choose(&config, &network, &load(&config.model, &network)?)?;
        log::info!("{} computes flow of {} px with {}", network.describe(), config.size_px, config.model.display());
        network.warm_up()?;
        let (planes, certainty) = (Vec::new(), Vec::new());
        Ok(Self { config, opener, network, weights_version: None, before: None, planes, certainty })
    }

    fn ready(&self, inputs: &dyn Inputs) -> Result<bool, NodeError> {
        let Some(lockstep) = self.config.lockstep else { return Ok(true) };
        let wanted = lockstep.publication_for(inputs.key().index);
        if self.weights_version == Some(wanted) || self.before.as_ref().is_some_and(|(version, _)| *version == wanted) {
            return Ok(true);
        }
        if !WEIGHTS.has_come(inputs) {
            return Ok(false);
        }
        let header = WEIGHTS.read(inputs)?.header;
        let (here, there) = (lockstep.frames_per_step * lockstep.publish_every, header.frames_per_version);
        if here != there {
            return Err(FlowError::OutOfStep { here, there }.into());
        }
        // A frame whose weights are gone is sent again after a death and in a checkpoint of the trainer already, or that
        // publication would not have been sent: the acknowledgement that takes it away is on its way.
        Ok((wanted..=wanted + 1).contains(&header.version))
    }

    fn objects(inputs: &dyn Inputs) -> Option<usize> {
        Some(VIEWS.read(inputs).ok()?.objects())
    }

    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        if WEIGHTS.has_come(inputs) {
            self.swap(&WEIGHTS.read(inputs)?, inputs.key().index)?;
        }
        let views = VIEWS.read(inputs)?;
        let (size_px, views_px) = (self.config.size_px as usize, views.header.size_px as usize);
        if views_px != size_px {
            return Err(FlowError::Size { views_px, network_px: size_px }.into());
        }
        self.infer(&views)?;
        let header = FlowFieldsHeader {
            fields: (views.views.len() + views.partners.len()) as u32,
            size_px: self.config.size_px,
            weights_version: self.weights_version.unwrap_or(0),
            has_certainty: u32::from(self.network.has_certainty()),
            reserved: 0,
        };
        FLOW.send(outputs, inputs.key(), FlowFields::byte_len(&header), &mut |bytes| {
            let fields = FlowFields::write(bytes, header);
            interleave(&self.planes, size_px, fields.flow_px);
            fields.certainty.copy_from_slice(&self.certainty);
        })
    }
}
