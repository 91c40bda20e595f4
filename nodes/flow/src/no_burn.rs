//! A build without training has no burn: whoever asks for it is told so.

use crate::FlowError;
use pseudoflow_inference::Engine;
use pseudoflow_network::{ComputeDevice, FlowNetwork, Weights};

/// There is none.
#[derive(Debug, Clone)]
pub(crate) enum BurnDevice {}

pub(crate) fn open_device(device: ComputeDevice) -> Result<BurnDevice, FlowError> {
    Err(FlowError::NoBurn { device: device.to_string() })
}

pub(crate) fn gpu_of_auto() -> Option<BurnDevice> {
    None
}

pub(crate) struct BurnEngine;

impl BurnEngine {
    pub(crate) fn open(
        _: &Weights,
        _: &FlowNetwork,
        _: usize,
        device: &BurnDevice,
    ) -> Result<Box<dyn Engine>, FlowError> {
        match *device {}
    }
}
