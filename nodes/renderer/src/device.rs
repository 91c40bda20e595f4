use crate::gpu::{AdapterChoice, GpuRasteriser};
use pseudoflow_imaging::raster::{RasterError, Rasteriser, SoftwareRasteriser};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What renders.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Device {
    /// A graphics adapter where there is one, else the software rasteriser; the log says which.
    #[default]
    Auto,
    /// A graphics adapter, or an error.
    Gpu,
    /// The software rasteriser.
    Cpu,
}

/// Opens the rasteriser that a configuration asks for, and logs which one it is. A driver that computes on the CPU
/// (lavapipe) is no graphics adapter here: the software rasteriser is faster.
///
/// # Errors
/// `gpu` without an adapter, or with one that refuses to work.
pub fn open(device: Device) -> Result<Box<dyn Rasteriser>, RasterError> {
    let rasteriser: Box<dyn Rasteriser> = match device {
        Device::Cpu => Box::new(SoftwareRasteriser::new()),
        Device::Gpu => Box::new(GpuRasteriser::open(AdapterChoice::Hardware)?),
        Device::Auto => match GpuRasteriser::open(AdapterChoice::Hardware) {
            Ok(gpu) => Box::new(gpu),
            Err(reason) => {
                log::info!("renderer: device auto takes the software rasteriser ({reason})");
                Box::new(SoftwareRasteriser::new())
            }
        },
    };
    log::info!("renderer: {} renders", rasteriser.name());
    Ok(rasteriser)
}
