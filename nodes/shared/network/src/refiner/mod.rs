//! The refiner: a compact network for all objects that knows the rendering's depth and says how sure it is.
//!
//! It follows RAFT's plan (features, all-pairs correlation, recurrent refinement) at a fraction of its price: first flow and
//! context come from a look at 1/16 of the resolution that sees the whole crop (NeuFlow v2, Zhang et al. 2024), three or four
//! iterations refine at 1/8, and all of it shares one trunk. Beside the flow each pixel gets a *visibility* (is this point of
//! the rendered surface seen in the photograph?) and a *confidence* (the sure component's share of a mixture of two Laplace
//! distributions; SEA-RAFT, Wang et al., ECCV 2024).
//!
//! Input: the rendering (N, 5, S, S): red, green, blue in [-1, 1], relative depth, mask ([`reference_geometry`]); the
//! photograph's crop (N, 3, S, S). S is a multiple of 16.

mod batch;
mod encoder;
mod geometry;
mod layout;
#[cfg(test)]
pub(crate) mod tests;
pub(crate) mod train;
mod update;

pub use batch::{DeviceRefinerBatch, RefinerBatch};
pub use geometry::reference_geometry;
pub(crate) use layout::{LEVELS, RADIUS, WIDTHS};
pub(crate) use train::coarse_loss;

use crate::error::{NetworkError, Result, io_error};
use crate::guard::guarded_on;
use crate::model::{Model, Parameter, Source, TensorSpec, read_together};
use crate::ops;
use crate::raft::{Conv, Pyramid};
use crate::weights::Weights;
use burn::tensor::{Device, Tensor, TensorData, activation};
use encoder::{Features, GlobalLook, Trunk};
use serde::{Deserialize, Serialize};
use std::path::Path;
use update::Update;

/// Channels of the rendering that the refiner takes: red, green, blue, relative depth, mask.
pub const REFERENCE_CHANNELS: usize = 5;

/// The refiner and the size it is trained at. Unknown keys are rejected.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RefinerConfig {
    /// Name, written into the weights.
    pub name: String,
    /// Side S of the square crops in training, px; a multiple of 16, from 64 to 1024.
    pub size_px: usize,
    /// Recurrent iterations in training.
    pub iterations_train: usize,
    /// Recurrent iterations at run time.
    pub iterations_infer: usize,
}

impl Default for RefinerConfig {
    fn default() -> Self {
        Self { name: "refiner".into(), size_px: 128, iterations_train: 3, iterations_infer: 4 }
    }
}

impl RefinerConfig {
    /// Reads and checks a YAML file.
    ///
    /// # Errors
    /// The file is unreadable, has unknown keys, or a value is out of range.
    pub fn from_yaml_file(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(io_error(path))?;
        let config: Self = serde_yaml::from_str(&text)
            .map_err(|e| NetworkError::ConfigSyntax { path: path.into(), message: e.to_string() })?;
        Model::check(&config)?;
        Ok(config)
    }
}

/// Checks a crop side of the refiner in px: a multiple of 16 from 64 to 1024.
pub(crate) fn check_size(size_px: usize) -> Result<()> {
    if size_px.is_multiple_of(16) && (64..=1024).contains(&size_px) {
        return Ok(());
    }
    let problem = format!("is {size_px}; the refiner takes a multiple of 16 from 64 to 1024");
    Err(NetworkError::ConfigValue { field: "size_px", problem })
}

/// The refiner with its weights on a device. On a device with autodiff every trained tensor requires a gradient.
#[derive(Debug)]
pub struct Refiner {
    trunk: Trunk,
    match_fine: Conv,
    global: GlobalLook,
    context: Conv,
    update: Update,
    parameters: Vec<Parameter>,
}

/// What the refiner says about a batch.
#[derive(Debug)]
pub struct Refinement {
    /// The first flow and that of each iteration but the last, (N, 2, S/8, S/8), px at 1/8, for the training.
    pub coarse: Vec<Tensor<4>>,
    /// (N, 5, S, S): flow x and y, px of the crop, defined on the rendering; logit of the confidence; raw scale of the unsure
    /// component; logit of the visibility.
    pub prediction: Tensor<4>,
}

impl Refiner {
    /// Builds the network; the device decides backend and autodiff.
    ///
    /// # Errors
    /// The weights belong to another architecture.
    pub fn new(weights: &Weights, config: &RefinerConfig, device: &Device) -> Result<Self> {
        let source = Source::new(weights, config, device)?;
        let conv = |name: &str| Conv::new(source.conv(name), 1);
        let trunk = Trunk::new(&source);
        let match_fine = conv("match.fine");
        let global = GlobalLook::new(&source);
        let context = conv("context");
        let update = Update::new(&source);
        Ok(Self { trunk, match_fine, global, context, update, parameters: source.into_parameters() })
    }

    /// Refines with `iterations` looks: rendering (N, 5, S, S), crop (N, 3, S, S).
    pub fn forward(&self, reference: Tensor<4>, real: Tensor<4>, iterations: usize) -> Refinement {
        let features = self.trunk.forward(reference, real);
        let pyramid = self.pyramid(&features);
        let (first, global) = self.global.forward(&features.coarse);
        let [fine_reference, _] = features.halves(&features.fine);
        let context = self.context.forward(Tensor::cat(vec![fine_reference, double(global)], 1), false);
        let mut hidden = context.clone().narrow(1, 0, WIDTHS.hidden).tanh();
        let context = self.update.context(activation::relu(context.narrow(1, WIDTHS.hidden, WIDTHS.context)));
        // Coarse pixels of the first flow are twice as large.
        let mut flow = double(first) * 2.0;
        let mut coarse = vec![flow.clone()];
        for i in 0..iterations {
            flow = flow.detach();
            let motion = self.update.motion(pyramid.lookup(&flow), flow.clone());
            hidden = self.update.hidden(hidden, motion, context.clone());
            flow = flow + self.update.delta(&hidden);
            if i + 1 < iterations {
                coarse.push(flow.clone());
            }
        }
        Refinement { coarse, prediction: self.finish(flow, &hidden) }
    }

    /// The prediction at full size.
    fn finish(&self, flow: Tensor<4>, hidden: &Tensor<4>) -> Tensor<4> {
        let all = Tensor::cat(vec![flow * 8.0, self.update.certainty(hidden)], 1);
        ops::upsample_convex(all, self.update.mask(hidden))
    }

    fn pyramid(&self, features: &Features) -> Pyramid {
        let [reference, real] = features.halves(&self.match_fine.forward(features.fine.clone(), false));
        Pyramid::new(reference, real, RADIUS, LEVELS)
    }

    /// [`Self::forward`] on plain slices of `n` pairs of side `size_px`; returns the prediction's values (n, 5, S, S).
    ///
    /// # Errors
    /// The size is not allowed, a slice has another length, or a GPU failed.
    pub fn infer_slices(
        &self,
        reference: &[f32],
        real: &[f32],
        n: usize,
        size_px: usize,
        iterations: usize,
        device: &Device,
    ) -> Result<Vec<f32>> {
        check_size(size_px)?;
        let tensor = |name: &str, data: &[f32], channels: usize| {
            let shape = [n, channels, size_px, size_px];
            if data.len() != shape.iter().product::<usize>() {
                return Err(NetworkError::Batch(format!("`{name}` has {} values, {shape:?} needed", data.len())));
            }
            Ok(Tensor::<4>::from_data(TensorData::new(data.to_vec(), shape), device))
        };
        guarded_on(device, || {
            let [reference, real] = [tensor("reference", reference, REFERENCE_CHANNELS)?, tensor("real", real, 3)?];
            let prediction = self.forward(reference, real, iterations).prediction;
            Ok(read_together([prediction])?.remove(0))
        })
    }
}

/// Every pixel becomes four.
fn double(x: Tensor<4>) -> Tensor<4> {
    let [n, c, h, w] = x.dims();
    let wide: Tensor<6> = x.reshape([n, c, h, 1, w, 1]);
    wide.expand([n, c, h, 2, w, 2]).reshape([n, c, 2 * h, 2 * w])
}

impl Model for RefinerConfig {
    type Network = Refiner;

    fn name(&self) -> &str {
        &self.name
    }

    fn hash(&self) -> String {
        crate::model::fingerprint("refiner 1")
    }

    fn layout(&self) -> Vec<TensorSpec> {
        layout::layout()
    }

    fn check(&self) -> Result<()> {
        if self.name.is_empty() {
            let problem = "is empty; give the network a name".into();
            return Err(NetworkError::ConfigValue { field: "name", problem });
        }
        for (field, n) in [("iterations_train", self.iterations_train), ("iterations_infer", self.iterations_infer)] {
            if !(1..=64).contains(&n) {
                return Err(NetworkError::ConfigValue { field, problem: format!("is {n}; use 1 to 64") });
            }
        }
        check_size(self.size_px)
    }

    fn build(&self, weights: &Weights, device: &Device) -> Result<Refiner> {
        Refiner::new(weights, self, device)
    }

    fn parameters(network: &Refiner) -> &[Parameter] {
        &network.parameters
    }
}
