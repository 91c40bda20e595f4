//! A network on an engine, with the buffers between messages and tensors.

use crate::FlowError;
use crate::node::Pair;
use pseudoflow_inference::{Engine, Input, Output, normalise};
use pseudoflow_network::{REFERENCE_CHANNELS, reference_geometry};

/// A RAFT or the refiner, ready to run on crops of one size.
pub(crate) struct Loaded {
    engine: Box<dyn Engine>,
    is_refiner: bool,
    size_px: usize,
    reference: Vec<f32>,
    real: Vec<f32>,
    flow_px: Vec<f32>,
    certainty: Vec<f32>,
}

/// What a network says of a batch of n pairs, row-major.
pub(crate) struct Answer<'a> {
    /// n x 2 x S x S, px.
    pub(crate) flow_px: &'a [f32],
    /// n x 2 x S x S, 0..1: seen, confident. `None` of a RAFT, which does not say.
    pub(crate) certainty: Option<&'a [f32]>,
}

impl Loaded {
    /// A network on an engine, for crops of `size_px`.
    pub(crate) fn new(engine: Box<dyn Engine>, is_refiner: bool, size_px: usize) -> Self {
        let (reference, real, flow_px, certainty) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        Self { engine, is_refiner, size_px, reference, real, flow_px, certainty }
    }

    /// Engine and network, for the log.
    pub(crate) fn describe(&self) -> String {
        format!("{}, {}", if self.is_refiner { "refiner" } else { "RAFT" }, self.engine.describe())
    }

    /// Whether answers have a certainty.
    pub(crate) fn has_certainty(&self) -> bool {
        self.is_refiner
    }

    /// Channels of the rendering that the network takes.
    fn channels(&self) -> usize {
        if self.is_refiner { REFERENCE_CHANNELS } else { 3 }
    }

    /// Compares each pair.
    pub(crate) fn run(&mut self, pairs: &[Pair<'_>]) -> Result<Answer<'_>, FlowError> {
        let (area, channels) = (self.size_px * self.size_px, self.channels());
        self.reference.resize(pairs.len() * channels * area, 0.0);
        self.real.resize(pairs.len() * 3 * area, 0.0);
        let out = self.reference.chunks_exact_mut(channels * area).zip(self.real.chunks_exact_mut(3 * area));
        for (pair, (reference, real)) in pairs.iter().zip(out) {
            let (colours, geometry) = reference.split_at_mut(3 * area);
            normalise(pair.reference_rgb, area, colours);
            normalise(pair.real_rgb, area, real);
            if self.is_refiner {
                reference_geometry(pair.reference_depth_m, self.size_px, pair.focal_px, geometry);
            }
        }
        self.compute(pairs.len())
    }

    /// One run on grey images, so that the first frame finds memory and kernels ready.
    pub(crate) fn warm_up(&mut self) -> Result<(), FlowError> {
        let area = self.size_px * self.size_px;
        self.reference = vec![0.0; self.channels() * area];
        self.real = vec![0.0; 3 * area];
        self.compute(1).map(|_| ())
    }

    /// Runs the network on the `n` pairs in the buffers.
    fn compute(&mut self, n: usize) -> Result<Answer<'_>, FlowError> {
        let (size, channels) = (self.size_px, self.channels());
        let (field, is_refiner) = (n * 2 * size * size, self.is_refiner);
        self.flow_px.resize(field, 0.0);
        self.certainty.resize(if is_refiner { field } else { 0 }, 0.0);
        let (reference_shape, real_shape) = ([n, channels, size, size], [n, 3, size, size]);
        let inputs = [
            Input { name: "reference", shape: &reference_shape, data: &self.reference },
            Input { name: "real", shape: &real_shape, data: &self.real },
        ];
        let flow = Output { name: "flow", data: &mut self.flow_px };
        let certainty = Output { name: "certainty", data: &mut self.certainty };
        let mut outputs = if is_refiner { vec![flow, certainty] } else { vec![flow] };
        self.engine.run(&inputs, &mut outputs)?;
        Ok(Answer { flow_px: &self.flow_px, certainty: is_refiner.then_some(&self.certainty[..]) })
    }
}
