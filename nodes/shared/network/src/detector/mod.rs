//! The initializer's network (docs/method.md, pipeline step 1; Hu et al., "Wide-Depth-Range 6D Object Pose Estimation in
//! Space", CVPR 2021): every location inside an object says which object it is and where the eight corners of its
//! bounding box project, at three resolutions. Beyond the recipe, it also says which point of the object's surface it shows:
//! texture tells that from its neighbourhood alone, long before a network has learned to see a whole box. And it gives the upright
//! rectangle around the projection: corners that are not sure how a box is turned shrink to its middle and say nothing of its size.
//!
//! Backbone: the feature encoder of RAFT-small to 1/8 (so its published weights start it), residual stages at 1/8, 1/16 and
//! 1/32, a feature pyramid over them, and one head for all levels.

mod config;
mod grid;
mod loss;
#[cfg(test)]
pub(crate) mod tests;

pub use config::{CORNERS, DetectorConfig, SURFACE_UNIT};
pub use grid::{Cell, Grid, STRIDES};
pub use loss::{DetectionLoss, DetectorOutput, InstanceTruth, LossWeights, SceneTruth, detection_loss};

use crate::config::Architecture;
use crate::error::{NetworkError, Result};

use crate::model::{Model, Parameter, Source, TensorSpec, fingerprint, read_together};
use crate::raft::{Block, Conv, List, Norm, forward_normed, normed_conv};
use crate::train::{StepStats, TrainState};
use crate::weights::{NamedTensor, Weights, WeightsInfo};
use burn::tensor::{Device, Tensor, TensorData};

/// The network with its weights on a device.
#[derive(Debug)]
pub struct Detector {
    stem: Conv,
    /// Blocks before the first level.
    trunk: Vec<Block>,
    /// Blocks of each level.
    stages: Vec<Vec<Block>>,
    laterals: Vec<Conv>,
    tower: Vec<Conv>,
    class: Conv,
    corners: Conv,
    surface: Conv,
    rectangle: Conv,
    parameters: Vec<Parameter>,
}

/// Names of the tensors, in order. The trunk's are those of RAFT's feature encoder behind another prefix.
pub(crate) const TRUNK: &str = "trunk";
/// Convolutions before the outputs.
pub(crate) const TOWER: usize = 2;

fn layout(config: &DetectorConfig) -> Vec<TensorSpec> {
    let mut list = List::default();
    list.trunk(TRUNK, Architecture::Small, false);
    let widths = config.stage_widths();
    for (level, pair) in widths.windows(2).enumerate() {
        for block in 0..2 {
            let from = if block == 0 { pair[0] } else { pair[1] };
            let shrinks = level > 0 && block == 0;
            list.block(&format!("stage{level}.{block}"), Architecture::Basic, [from, pair[1]], shrinks, false);
        }
        list.conv(&format!("lateral{level}"), config.pyramid, pair[1], [1, 1], None);
    }
    let kaiming = Some(crate::model::Init::KaimingNormal);
    for i in 0..TOWER {
        list.conv(&format!("tower.{i}"), config.pyramid, config.pyramid, [3, 3], kaiming);
    }
    list.conv("class", config.objects, config.pyramid, [3, 3], None);
    list.conv("corners", 2 * CORNERS * config.objects, config.pyramid, [3, 3], None);
    list.conv("surface", 3 * config.objects, config.pyramid, [3, 3], None);
    list.conv("rectangle", 4, config.pyramid, [3, 3], None);
    for spec in list.0.iter_mut().filter(|spec| spec.name == "class.bias") {
        // At first everything is background (Lin et al., "Focal Loss for Dense Object Detection", section 3.3).
        spec.init = crate::model::Init::Constant(-4.6);
    }
    list.0
}

impl Detector {
    /// Builds the network; the device decides backend and autodiff.
    ///
    /// # Errors
    /// The weights belong to another architecture.
    pub fn new(weights: &Weights, config: &DetectorConfig, device: &Device) -> Result<Self> {
        let source = Source::new(weights, config, device)?;
        let stem = normed_conv(&source, &format!("{TRUNK}.conv1"), "", 2);
        let blocks = (1..4).flat_map(|stage| (0..2).map(move |block| (stage, block)));
        let trunk = blocks.map(|(stage, block)| {
            Block::new(&source, &format!("{TRUNK}.layer{stage}.{block}"), Architecture::Small, stage > 1 && block == 0)
        });
        let trunk = trunk.collect();
        let levels = 0..STRIDES.len();
        let stage = |level: usize| {
            let block = |block: usize| {
                let shrinks = level > 0 && block == 0;
                Block::new(&source, &format!("stage{level}.{block}"), Architecture::Basic, shrinks)
            };
            (0..2).map(block).collect()
        };
        let stages = levels.clone().map(stage).collect();
        let conv = |name: String| Conv::new(source.conv(&name), 1);
        Ok(Self {
            stem,
            trunk,
            stages,
            laterals: levels.map(|level| conv(format!("lateral{level}"))).collect(),
            tower: (0..TOWER).map(|i| conv(format!("tower.{i}"))).collect(),
            class: conv("class".into()),
            corners: conv("corners".into()),
            surface: conv("surface".into()),
            rectangle: conv("rectangle".into()),
            parameters: source.into_parameters(),
        })
    }

    /// Images (N, 3, H, W) in [-1, 1], H and W multiples of 32, to class logits (N, objects, cells) and corner offsets
    /// (N, 16 objects, cells), in units of [`Cell::unit_px`] from the cell's centre, and surface points (N, 3 objects,
    /// cells), in units of [`SURFACE_UNIT`] from the middle of the object's box, and rectangles (N, 4, cells): left, top, right,
    /// bottom, as the corners; cells in the order of [`Grid`].
    pub fn forward(&self, images: Tensor<4>) -> [Tensor<3>; 4] {
        self.heads(self.features(images))
    }

    /// The trunk alone: (N, 3, H, W) to (N, C, H / 8, W / 8).
    fn features(&self, images: Tensor<4>) -> Tensor<4> {
        let x = forward_normed(&self.stem, images, Norm::Instance, true);
        self.trunk.iter().fold(x, |x, block| block.forward(x, Norm::Instance))
    }

    /// From the trunk's features on.
    fn heads(&self, mut x: Tensor<4>) -> [Tensor<3>; 4] {
        let norm = Norm::Instance;
        let mut levels = Vec::new();
        for (stage, lateral) in self.stages.iter().zip(&self.laterals) {
            x = stage.iter().fold(x, |x, block| block.forward(x, norm));
            levels.push(lateral.forward(x.clone(), false));
        }
        for level in (1..levels.len()).rev() {
            levels[level - 1] = levels[level - 1].clone() + double(levels[level].clone());
        }
        let heads = levels.into_iter().map(|x| {
            let x = self.tower.iter().fold(x, |x, conv| conv.forward(x, true));
            [&self.class, &self.corners, &self.surface, &self.rectangle]
                .map(|conv| flat(conv.forward(x.clone(), false)))
        });
        let by_level: Vec<[Tensor<3>; 4]> = heads.collect();
        [0, 1, 2, 3].map(|i| Tensor::cat(by_level.iter().map(|heads| heads[i].clone()).collect(), 2))
    }
}

/// Every pixel becomes four.
fn double(x: Tensor<4>) -> Tensor<4> {
    let [n, c, h, w] = x.dims();
    x.reshape([n, c, h, 1, w, 1]).expand([n, c, h, 2, w, 2]).reshape([n, c, 2 * h, 2 * w])
}

fn flat(x: Tensor<4>) -> Tensor<3> {
    let [n, c, h, w] = x.dims();
    x.reshape([n, c, h * w])
}

impl Model for DetectorConfig {
    type Network = Detector;

    fn name(&self) -> &str {
        &self.name
    }

    fn hash(&self) -> String {
        fingerprint(&format!(
            "detector with surface, rectangle {:?} {:?} {} {}",
            self.input_px, self.widths, self.pyramid, self.objects
        ))
    }

    fn layout(&self) -> Vec<TensorSpec> {
        layout(self)
    }

    fn check(&self) -> Result<()> {
        self.check()
    }

    fn build(&self, weights: &Weights, device: &Device) -> Result<Detector> {
        Detector::new(weights, self, device)
    }

    fn parameters(network: &Detector) -> &[Parameter] {
        &network.parameters
    }
}

impl Weights {
    /// Random weights, but the trunk from the feature encoder of RAFT-small: as its authors trained it, or that of a flow
    /// network for the same objects.
    ///
    /// # Errors
    /// `raft_small` belongs to another architecture.
    pub fn detector_from_raft(config: &DetectorConfig, raft_small: &Self, seed: u64) -> Result<Self> {
        let mut weights = Self::random(config, seed);
        for tensor in weights.tensors_mut().filter(|t| t.name.starts_with(TRUNK)) {
            let name = tensor.name.replacen(TRUNK, "fnet", 1);
            let found = raft_small.get(&name).filter(|t| t.shape == tensor.shape);
            let found = found.ok_or_else(|| NetworkError::WeightsMismatch {
                origin: format!("weights of `{}`", raft_small.info.network),
                network: config.name.clone(),
                tensor: name,
                problem: "is missing or has another shape; the trunk starts from RAFT-small".into(),
            })?;
            tensor.data.clone_from(&found.data);
        }
        Ok(weights)
    }

    /// Weights for other objects, from an initializer that finds some already: where things are and how large is the same
    /// question for all objects, so most is taken as it is; what the network says of each object by itself starts as the mean
    /// over those that `known` was trained for.
    ///
    /// # Errors
    /// `known` has other widths.
    pub fn detector_from_known(config: &DetectorConfig, known: &Self) -> Result<Self> {
        let objects = known.get("class.bias").map_or(1, |bias| bias.data.len().max(1));
        let of_new_objects = |tensor: &NamedTensor| {
            let mut tensor = tensor.clone();
            if ["class.", "corners.", "surface."].iter().any(|head| tensor.name.starts_with(head)) {
                tensor.shape[0] = tensor.shape[0] / objects * config.objects;
                tensor.data = mean_of(&tensor.data, objects).repeat(config.objects);
            }
            (tensor.name.clone(), tensor)
        };
        let info = WeightsInfo { network: config.name.clone(), config_hash: config.hash(), ..WeightsInfo::default() };
        let origin = format!("weights of `{}`, of which only the number of objects may differ", known.info.network);
        Self::from_parts(info, known.tensors().iter().map(of_new_objects).collect(), config, &origin)
    }
}

/// The mean of `parts` runs of values that lie one behind the other.
fn mean_of(values: &[f32], parts: usize) -> Vec<f32> {
    let length = values.len() / parts;
    (0..length).map(|i| (0..parts).map(|part| values[part * length + i]).sum::<f32>() / parts as f32).collect()
}

/// What becomes of the trunk in a training step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trunk {
    /// It learns with the rest.
    Trained,
    /// It stays as it is, and the step does not go back through it: about half of the time.
    Frozen,
}

impl TrainState<DetectorConfig> {
    /// One step on `n` images (n, 3, H, W) in [-1, 1] with what they show.
    ///
    /// # Errors
    /// The batch has wrong lengths, or loss or gradient are not finite: the weights then stay as they were.
    pub fn detection_step(
        &mut self,
        images: &[f32],
        truth: &[SceneTruth],
        weights: &LossWeights,
        trunk: Trunk,
    ) -> Result<(StepStats, DetectionLoss)> {
        let [width, height] = self.network.input_px;
        let (n, needed) = (truth.len(), truth.len() * 3 * width * height);
        if n == 0 || images.len() != needed {
            let text = format!("{} values; {n} images of {width} x {height} px need {needed}", images.len());
            return Err(NetworkError::Batch(text));
        }
        let device = self.device().autodiff();
        let (grid, objects) = (Grid::new(width, height), self.network.objects);
        let mut found = None;
        let mut stats = self.step_with(|network| {
            let images = TensorData::new(images.to_vec(), [n, 3, height, width]);
            let features = network.features(Tensor::from_data(images, &device));
            let outputs = network.heads(match trunk {
                Trunk::Trained => features,
                Trunk::Frozen => features.detach(),
            });
            let read = read_together(outputs.clone()).unwrap_or_else(|error| panic!("{error}"));
            let [logits, offsets, surface, rectangles] = read.try_into().expect("four outputs");
            let output = DetectorOutput {
                logits: &logits,
                offsets: &offsets,
                surface: &surface,
                rectangles: &rectangles,
                objects,
            };
            let loss = detection_loss(&output, truth, &grid, weights);
            // Linear in the outputs: their gradients are the loss's.
            let slope = |values: &[f32], like: &Tensor<3>| {
                Tensor::<3>::from_data(TensorData::new(values.to_vec(), like.dims()), &device)
            };
            let gradients =
                [&loss.logit_gradient, &loss.offset_gradient, &loss.surface_gradient, &loss.rectangle_gradient];
            let terms = outputs.into_iter().zip(gradients).map(|(output, gradient)| {
                let by_output = slope(gradient, &output);
                (output * by_output).sum()
            });
            let sum = terms.reduce(|a, b| a + b).expect("four outputs");
            found = Some(loss);
            sum
        })?;
        let loss = found.expect("the step computes its loss");
        stats.loss = loss.total;
        Ok((stats, loss))
    }
}
