//! The feature encoder of a flow network, run on crops of one size.

use crate::InitializerError;
use pseudoflow_imaging::raster::Rendering;
use pseudoflow_inference::{Engine, EngineConfig, Input, Output, normalise, open};
use pseudoflow_network::{FlowNetwork, Pictures, REFERENCE_CHANNELS, reference_geometry};
use rayon::prelude::*;
use std::path::Path;

/// Pixels across a cell of the features.
pub(super) const CELL_PX: usize = 8;

/// The encoder of a flow network, for crops of one size.
pub(super) struct Encoder {
    of_photographs: Box<dyn Engine>,
    /// Only where it is another one: the refiner's, which sees the geometry of a rendering.
    of_renderings: Option<Box<dyn Engine>>,
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
        let failed = |cause: pseudoflow_network::NetworkError| InitializerError::Model {
            path: model.to_owned(),
            cause: cause.to_string(),
        };
        let network = FlowNetwork::of_weights(model).map_err(failed)?;
        let weights = network.load(model).map_err(failed)?;
        let open_for = |pictures| {
            let onnx = network.export_features(&weights, size_px as usize, pictures).map_err(failed)?;
            Ok::<_, InitializerError>(open(&onnx, engine)?)
        };
        Ok(Self {
            of_photographs: open_for(Pictures::Photographs)?,
            of_renderings: network.is_refiner().then(|| open_for(Pictures::Renderings)).transpose()?,
            size_px,
            channels: network.feature_channels(),
            planes: Vec::new(),
            features: Vec::new(),
        })
    }

    /// What computes, in words.
    pub(super) fn describe(&self) -> String {
        self.of_photographs.describe()
    }

    /// Cells across a crop.
    pub(super) fn across(&self) -> usize {
        self.size_px as usize / CELL_PX
    }

    /// Features of each cell of `n` crops (interleaved RGB), each of length one: n x across^2 x channels.
    pub(super) fn encode(&mut self, rgb: &[u8]) -> Result<Vec<f32>, InitializerError> {
        let area = (self.size_px * self.size_px) as usize;
        self.planes.resize(rgb.len(), 0.0);
        normalise(rgb, area, &mut self.planes);
        self.run(rgb.len() / (3 * area), Pictures::Photographs)
    }

    /// The same of renderings, each with the focal length of its camera, pixels.
    pub(super) fn encode_renderings(&mut self, renderings: &[(Rendering, f64)]) -> Result<Vec<f32>, InitializerError> {
        if self.of_renderings.is_none() {
            let rgb: Vec<u8> = renderings.iter().flat_map(|(r, _)| r.rgb.as_raw().iter().copied()).collect();
            return self.encode(&rgb);
        }
        let (size, area) = (self.size_px as usize, (self.size_px * self.size_px) as usize);
        self.planes.resize(renderings.len() * REFERENCE_CHANNELS * area, 0.0);
        let each = self.planes.par_chunks_exact_mut(REFERENCE_CHANNELS * area).zip(renderings);
        each.for_each(|(planes, (rendering, focal_px))| {
            let (colours, geometry) = planes.split_at_mut(3 * area);
            normalise(rendering.rgb.as_raw(), area, colours);
            reference_geometry(&rendering.depth_m, size, *focal_px, geometry);
        });
        self.run(renderings.len(), Pictures::Renderings)
    }

    /// Features of the `n` pictures in `planes`.
    fn run(&mut self, n: usize, pictures: Pictures) -> Result<Vec<f32>, InitializerError> {
        let (size, cells, channels) = (self.size_px as usize, self.across() * self.across(), self.channels);
        self.features.resize(n * channels * cells, 0.0);
        let engine = match (pictures, &mut self.of_renderings) {
            (Pictures::Renderings, Some(engine)) => engine,
            _ => &mut self.of_photographs,
        };
        let shape = [n, self.planes.len() / (n.max(1) * size * size), size, size];
        let image = Input { name: "image", shape: &shape, data: &self.planes };
        engine.run(&[image], &mut [Output { name: "features", data: &mut self.features }])?;
        Ok(by_cell(&self.features, cells, channels))
    }
}

/// Features of planes (n x channels x cells) cell by cell, each of length one.
fn by_cell(features: &[f32], cells: usize, channels: usize) -> Vec<f32> {
    let mut by_cell = vec![0.0; features.len()];
    let planes = features.par_chunks_exact(channels * cells);
    by_cell.par_chunks_exact_mut(channels * cells).zip(planes).for_each(|(out, planes)| {
        for (cell, feature) in out.chunks_exact_mut(channels).enumerate() {
            (0..channels).for_each(|c| feature[c] = planes[c * cells + cell]);
            let norm = feature.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-6);
            feature.iter_mut().for_each(|v| *v /= norm);
        }
    });
    by_cell
}
