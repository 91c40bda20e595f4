//! The network with its weights in an engine.

use crate::{Fit, InitializerError};
use pseudoflow_imaging::RgbImage;
use pseudoflow_inference::{Engine, EngineConfig, Input, Output, normalise, open};
use pseudoflow_network::{CORNERS, DetectorConfig, Grid, Weights, export_detector};
use std::path::Path;

/// Finds cells of objects in images.
pub struct DetectorNetwork {
    engine: Box<dyn Engine>,
    config: DetectorConfig,
    grid: Grid,
    object_ids: Vec<u32>,
    planes: Vec<f32>,
    logits: Vec<f32>,
    offsets: Vec<f32>,
    surface: Vec<f32>,
    rectangles: Vec<f32>,
}

/// The network's answer to one image.
#[derive(Debug, Clone, Copy)]
pub struct Answer<'a> {
    /// (objects, cells).
    pub logits: &'a [f32],
    /// (16 objects, cells).
    pub offsets: &'a [f32],
    /// (3 objects, cells).
    pub surface: &'a [f32],
    /// (4, cells).
    pub rectangles: &'a [f32],
    /// The cells.
    pub grid: &'a Grid,
    /// Objects by place.
    pub object_ids: &'a [u32],
}

impl DetectorNetwork {
    /// Reads weights, exports them to ONNX in memory and opens an engine on that.
    ///
    /// # Errors
    /// When the weights are not those of such a network, or the engine cannot be opened.
    pub fn open(path: &Path, network: &str, engine: &EngineConfig) -> Result<Self, InitializerError> {
        let failed = |cause: String| InitializerError::Model { path: path.to_owned(), cause };
        let info = Weights::read_info(path).map_err(|e| failed(e.to_string()))?;
        if info.object_ids.is_empty() {
            return Err(failed("the file does not say which objects it finds".into()));
        }
        let config = DetectorConfig::named(network, info.object_ids.len()).map_err(|e| failed(e.to_string()))?;
        let weights = Weights::load(path, &config).map_err(|e| failed(e.to_string()))?;
        let onnx = export_detector(&weights, &config).map_err(|e| failed(e.to_string()))?;
        let [width, height] = config.input_px;
        let grid = Grid::new(width, height);
        let cells = grid.cells.len();
        Ok(Self {
            engine: open(&onnx, engine)?,
            planes: vec![0.0; 3 * width * height],
            logits: vec![0.0; config.objects * cells],
            offsets: vec![0.0; 2 * CORNERS * config.objects * cells],
            surface: vec![0.0; 3 * config.objects * cells],
            rectangles: vec![0.0; 4 * cells],
            config,
            grid,
            object_ids: info.object_ids,
        })
    }

    /// Engine, version and provider.
    #[must_use]
    pub fn describe(&self) -> String {
        self.engine.describe()
    }

    /// The objects that it finds.
    #[must_use]
    pub fn object_ids(&self) -> &[u32] {
        &self.object_ids
    }

    /// How images of a size come into its input.
    #[must_use]
    pub fn fit(&self, width: u32, height: u32) -> Fit {
        Fit::new(width, height, self.config.input_px)
    }

    /// What it says to an input ([`Fit::input`]).
    ///
    /// # Errors
    /// What the engine says.
    pub fn run(&mut self, input: &RgbImage) -> Result<Answer<'_>, InitializerError> {
        let [width, height] = self.config.input_px;
        normalise(input.as_raw(), width * height, &mut self.planes);
        let shape = [1, 3, height, width];
        let image = Input { name: "image", shape: &shape, data: &self.planes };
        let mut outputs = [
            Output { name: "classes", data: &mut self.logits },
            Output { name: "corners", data: &mut self.offsets },
            Output { name: "surface", data: &mut self.surface },
            Output { name: "rectangles", data: &mut self.rectangles },
        ];
        self.engine.run(&[image], &mut outputs)?;
        Ok(Answer {
            logits: &self.logits,
            offsets: &self.offsets,
            surface: &self.surface,
            rectangles: &self.rectangles,
            grid: &self.grid,
            object_ids: &self.object_ids,
        })
    }
}
