//! The networks that find flow, by name or by their weights: one place for all commands and nodes.

use crate::config::NetworkConfig;
use crate::error::Result;
use crate::layout::refiner::WIDTHS;
use crate::model::{Model, TensorSpec};
use crate::onnx::{ExportOptions, Pictures, export_features, export_onnx, export_refiner, export_refiner_features};
use crate::refiner::{REFERENCE_CHANNELS, RefinerConfig};
use crate::weights::Weights;
use std::path::Path;

/// A network that finds flow from a rendering to a photograph.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum FlowNetwork {
    /// A RAFT.
    Raft(NetworkConfig),
    /// The refiner for all objects, which says how certain it is.
    Refiner(RefinerConfig),
}

impl FlowNetwork {
    /// `refiner`, `nano`, `small`, `paper`, or the RAFT of a YAML file as in config/networks.
    ///
    /// # Errors
    /// The YAML file is unreadable or bad.
    pub fn named(name: &str) -> Result<Self> {
        Ok(match name {
            "refiner" => Self::Refiner(RefinerConfig::default()),
            "nano" => Self::Raft(NetworkConfig::nano()),
            "small" => Self::Raft(NetworkConfig::small()),
            "paper" => Self::Raft(NetworkConfig::paper()),
            path => Self::Raft(NetworkConfig::from_yaml_file(Path::new(path))?),
        })
    }

    /// The network that a weight file says it belongs to: the refiner, or else RAFT-small.
    ///
    /// # Errors
    /// The file is unreadable or damaged.
    pub fn of_weights(path: &Path) -> Result<Self> {
        let refiner = RefinerConfig::default();
        let is_refiner = Weights::read_info(path)?.config_hash == refiner.hash();
        Ok(if is_refiner { Self::Refiner(refiner) } else { Self::Raft(NetworkConfig::nano()) })
    }

    /// Whether it takes the depth of the rendering and says how certain it is.
    #[must_use]
    pub fn is_refiner(&self) -> bool {
        matches!(self, Self::Refiner(_))
    }

    /// Side of the crops it is trained at, px.
    #[must_use]
    pub fn size_px(&self) -> usize {
        match self {
            Self::Raft(raft) => raft.size_px,
            Self::Refiner(refiner) => refiner.size_px,
        }
    }

    /// Channels of the rendering that it takes: colours, and of the refiner its geometry.
    #[must_use]
    pub fn reference_channels(&self) -> usize {
        if self.is_refiner() { REFERENCE_CHANNELS } else { 3 }
    }

    /// Recurrent iterations in training.
    #[must_use]
    pub fn iterations_train(&self) -> usize {
        match self {
            Self::Raft(raft) => raft.iterations_train,
            Self::Refiner(refiner) => refiner.iterations_train,
        }
    }

    /// Sets the recurrent iterations in training.
    pub fn set_iterations_train(&mut self, iterations: usize) {
        match self {
            Self::Raft(raft) => raft.iterations_train = iterations,
            Self::Refiner(refiner) => refiner.iterations_train = iterations,
        }
    }

    /// Recurrent iterations at run time.
    #[must_use]
    pub fn iterations_infer(&self) -> usize {
        match self {
            Self::Raft(raft) => raft.iterations_infer,
            Self::Refiner(refiner) => refiner.iterations_infer,
        }
    }

    /// Reads a weight file.
    ///
    /// # Errors
    /// It is unreadable, damaged, or of another architecture.
    pub fn load(&self, path: &Path) -> Result<Weights> {
        match self {
            Self::Raft(raft) => Weights::load(path, raft),
            Self::Refiner(refiner) => Weights::load(path, refiner),
        }
    }

    /// The same from a file's bytes; `origin` is named in errors.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn read(&self, bytes: &[u8], origin: &str) -> Result<Weights> {
        match self {
            Self::Raft(raft) => Weights::from_bytes(bytes, raft, origin),
            Self::Refiner(refiner) => Weights::from_bytes(bytes, refiner, origin),
        }
    }

    /// The bytes of an ONNX file.
    ///
    /// # Errors
    /// Size, iterations or batch are out of range, or the weights belong to another architecture.
    pub fn export(&self, weights: &Weights, options: ExportOptions) -> Result<Vec<u8>> {
        match self {
            Self::Raft(raft) => export_onnx(weights, raft, options),
            Self::Refiner(refiner) => export_refiner(weights, refiner, options),
        }
    }

    /// The bytes of an ONNX file of the features that are compared between pictures, at 1/8 of their size: input `image` (N, C,
    /// S, S), f32, C = [`Self::reference_channels`] of renderings and 3 of photographs; output `features` (N,
    /// [`Self::feature_channels`], S / 8, S / 8). They resemble each other where rendering and photograph show the same surface.
    ///
    /// # Errors
    /// The size is out of range, or the weights belong to another architecture.
    pub fn export_features(&self, weights: &Weights, size_px: usize, of: Pictures) -> Result<Vec<u8>> {
        match self {
            Self::Raft(raft) => export_features(weights, raft, size_px),
            Self::Refiner(refiner) => export_refiner_features(weights, refiner, size_px, of),
        }
    }

    /// Channels of [`Self::export_features`].
    #[must_use]
    pub fn feature_channels(&self) -> usize {
        match self {
            Self::Raft(raft) => raft.feature_channels(),
            Self::Refiner(_) => WIDTHS.matching,
        }
    }
}

impl Model for FlowNetwork {
    fn name(&self) -> &str {
        match self {
            Self::Raft(raft) => raft.name(),
            Self::Refiner(refiner) => refiner.name(),
        }
    }

    fn hash(&self) -> String {
        match self {
            Self::Raft(raft) => raft.hash(),
            Self::Refiner(refiner) => refiner.hash(),
        }
    }

    fn layout(&self) -> Vec<TensorSpec> {
        match self {
            Self::Raft(raft) => raft.layout(),
            Self::Refiner(refiner) => refiner.layout(),
        }
    }

    fn check(&self) -> Result<()> {
        match self {
            Self::Raft(raft) => Model::check(raft),
            Self::Refiner(refiner) => Model::check(refiner),
        }
    }
}
