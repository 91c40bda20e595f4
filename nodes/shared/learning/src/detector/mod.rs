//! The initializer's network in burn ([`DetectorConfig`] says what it is made of), its loss and its training.

mod loss;
#[cfg(test)]
pub(crate) mod tests;

pub use loss::{DetectionLoss, DetectorOutput, InstanceTruth, LossWeights, SceneTruth, detection_loss};

use crate::model::{Parameter, Source, Trainable, read_together};
use crate::ops;
use crate::raft::{Block, Conv, Norm, forward_normed, normed_conv};
use crate::train::{StepStats, TrainState};
use burn::tensor::{Device, Tensor, TensorData};
use pseudoflow_network::layout::detector::{TOWER, TRUNK};
use pseudoflow_network::{Architecture, DetectorConfig, Grid, NetworkError, Result, STRIDES, Weights};

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
    /// (N, 16 objects, cells), in units of [`Cell::unit_px`](pseudoflow_network::Cell::unit_px) from the cell's centre, and surface points (N, 3 objects,
    /// cells), in units of [`SURFACE_UNIT`](pseudoflow_network::SURFACE_UNIT) from the middle of the object's box, and rectangles (N, 4, cells): left, top, right,
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
            levels[level - 1] = levels[level - 1].clone() + ops::double(levels[level].clone());
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

fn flat(x: Tensor<4>) -> Tensor<3> {
    let [n, c, h, w] = x.dims();
    x.reshape([n, c, h * w])
}

impl Trainable for DetectorConfig {
    type Network = Detector;

    fn build(&self, weights: &Weights, device: &Device) -> Result<Detector> {
        Detector::new(weights, self, device)
    }

    fn parameters(network: &Detector) -> &[Parameter] {
        &network.parameters
    }
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
