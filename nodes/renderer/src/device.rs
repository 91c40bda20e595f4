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

/// Opens the rasteriser that a configuration asks for.
///
/// # Errors
/// `gpu` without an adapter.
pub fn open(device: Device) -> Result<Box<dyn Rasteriser>, RasterError> {
    match device {
        Device::Auto | Device::Cpu => Ok(Box::new(SoftwareRasteriser::new())),
        Device::Gpu => Err(RasterError::Device { device: "gpu".into(), what: "no adapter".into() }),
    }
}
