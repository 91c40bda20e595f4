//! The feature encoder of a flow network, run on crops of one size.

use crate::InitializerError;
use pseudoflow_inference::{Engine, EngineConfig, Input, Output, normalise, open};
use pseudoflow_network::{NetworkConfig, Weights, export_features};
use rayon::prelude::*;
use std::path::Path;

/// Pixels across a cell of the features.
pub(super) const CELL_PX: usize = 8;

/// The encoder of a flow network, for crops of one size.
pub(super) struct Encoder {
    engine: Box<dyn Engine>,
    /// Width and height of the crops, pixels.
    pub(super) size_px: u32,
    pub(super) channels: usize,
    planes: Vec<f32>,
    features: Vec<f32>,
}

impl Encoder {
    /// # Errors
    /// When the weights are not those of a flow network, or the engine cannot be opened.
    pub(super) fn open(model: &Path, size_px: u32, engine: &EngineConfig) -> Result<Self, InitializerError> {
        let failed = |cause: String| InitializerError::Model { path: model.to_owned(), cause };
        let network = NetworkConfig::nano();
        let weights = Weights::load(model, &network).map_err(|e| failed(e.to_string()))?;
        let onnx = export_features(&weights, &network, size_px as usize).map_err(|e| failed(e.to_string()))?;
        let (engine, channels) = (open(&onnx, engine)?, network.feature_channels());
        Ok(Self { engine, size_px, channels, planes: Vec::new(), features: Vec::new() })
    }

    /// What computes, in words.
    pub(super) fn describe(&self) -> String {
        self.engine.describe()
    }

    /// Cells across a crop.
    pub(super) fn across(&self) -> usize {
        self.size_px as usize / CELL_PX
    }

    /// Features of each cell of `n` crops (interleaved RGB), each of length one: n x across^2 x channels.
    pub(super) fn encode(&mut self, rgb: &[u8]) -> Result<Vec<f32>, InitializerError> {
        let (size, cells, channels) = (self.size_px as usize, self.across() * self.across(), self.channels);
        let n = rgb.len() / (3 * size * size);
        self.planes.resize(rgb.len(), 0.0);
        normalise(rgb, size * size, &mut self.planes);
        self.features.resize(n * channels * cells, 0.0);
        let image = Input { name: "image", shape: &[n, 3, size, size], data: &self.planes };
        self.engine.run(&[image], &mut [Output { name: "features", data: &mut self.features }])?;
        let mut by_cell = vec![0.0; self.features.len()];
        let planes = self.features.par_chunks_exact(channels * cells);
        by_cell.par_chunks_exact_mut(channels * cells).zip(planes).for_each(|(out, planes)| {
            for (cell, feature) in out.chunks_exact_mut(channels).enumerate() {
                (0..channels).for_each(|c| feature[c] = planes[c * cells + cell]);
                let norm = feature.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-6);
                feature.iter_mut().for_each(|v| *v /= norm);
            }
        });
        Ok(by_cell)
    }
}
