//! The device switch: what computes, for training and for the engine of the flow node. Resolved here and nowhere else.
//!
//! `auto` takes the first of CUDA, a Vulkan adapter that is graphics hardware, the processor, and logs which. A device
//! that was named is that device or an error: nothing falls back to the processor by itself. A driver that computes on
//! the processor (lavapipe, llvmpipe) is slower than the kernels of this crate and is taken only by its number,
//! `vulkan:N`.

#[cfg(any(feature = "vulkan", feature = "cuda"))]
mod gpu;
#[cfg(all(test, feature = "vulkan"))]
mod proof;
#[cfg(test)]
mod tests;

use crate::error::{NetworkError, Result};
use burn::tensor::Device;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use std::fmt::{Display, Formatter};
use std::str::FromStr;

/// Which device computes; written `auto`, `cpu`, `vulkan`, `vulkan:1`, `cuda` or `cuda:1`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum ComputeDevice {
    /// The best one that is compiled in and present.
    #[default]
    Auto,
    /// The processor, with the kernels of this crate.
    Cpu,
    /// A Vulkan adapter by its number; without one the first that is graphics hardware.
    Vulkan(Option<u16>),
    /// An NVIDIA GPU by its number; without one the first.
    Cuda(Option<u16>),
}

/// A device that is there.
#[derive(Debug, Clone)]
pub struct OpenDevice {
    /// For tensors; without autodiff.
    pub device: Device,
    /// Which one it is: never `Auto`, and with its number.
    pub choice: ComputeDevice,
    /// What it calls itself.
    pub name: String,
}

impl Display for OpenDevice {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} ({})", self.choice, self.name)
    }
}

impl ComputeDevice {
    /// Finds and opens the device, and logs which one it is.
    ///
    /// # Errors
    /// It is not compiled in, not there, or refuses to compute: the message lists what is there and what to do.
    pub fn open(self) -> Result<OpenDevice> {
        let open = match self {
            Self::Auto => auto(),
            Self::Cpu => Ok(cpu()),
            Self::Vulkan(number) => vulkan(number),
            Self::Cuda(number) => cuda(number),
        }?;
        log::info!("device {self}: {open} computes");
        Ok(open)
    }

    /// The GPU that `auto` would take, if there is one. Opens it.
    #[must_use]
    pub fn gpu_of_auto() -> Option<OpenDevice> {
        let attempts = [(COMPILED_CUDA, cuda as fn(_) -> _), (COMPILED_VULKAN, vulkan)];
        for (_, open) in attempts.into_iter().filter(|(compiled, _)| *compiled) {
            match open(None) {
                Ok(device) => return Some(device),
                Err(reason) => log::info!("device auto: {reason}"),
            }
        }
        None
    }
}

const COMPILED_CUDA: bool = cfg!(feature = "cuda");
const COMPILED_VULKAN: bool = cfg!(feature = "vulkan");

fn auto() -> Result<OpenDevice> {
    Ok(ComputeDevice::gpu_of_auto().unwrap_or_else(cpu))
}

fn cpu() -> OpenDevice {
    let name = format!("own kernels, {} threads", rayon::current_num_threads());
    OpenDevice { device: Device::flex(), choice: ComputeDevice::Cpu, name }
}

#[cfg(feature = "vulkan")]
use gpu::vulkan;

#[cfg(feature = "cuda")]
use gpu::cuda;

#[cfg(not(feature = "vulkan"))]
fn vulkan(number: Option<u16>) -> Result<OpenDevice> {
    Err(not_compiled(ComputeDevice::Vulkan(number), "vulkan"))
}

#[cfg(not(feature = "cuda"))]
fn cuda(number: Option<u16>) -> Result<OpenDevice> {
    Err(not_compiled(ComputeDevice::Cuda(number), "cuda"))
}

#[allow(dead_code, reason = "a build with both features lacks neither")]
fn not_compiled(asked: ComputeDevice, feature: &str) -> NetworkError {
    let problem = format!(
        "is not part of this binary; build it with `cargo build --release --features {feature}`, or use `cpu` \
         (docs/gpu.md)"
    );
    NetworkError::Device { device: asked.to_string(), problem }
}

impl Display for ComputeDevice {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Cpu => f.write_str("cpu"),
            Self::Vulkan(None) => f.write_str("vulkan"),
            Self::Vulkan(Some(number)) => write!(f, "vulkan:{number}"),
            Self::Cuda(None) => f.write_str("cuda"),
            Self::Cuda(Some(number)) => write!(f, "cuda:{number}"),
        }
    }
}

impl FromStr for ComputeDevice {
    type Err = NetworkError;

    fn from_str(text: &str) -> Result<Self> {
        let (kind, number) = match text.split_once(':') {
            Some((kind, number)) => (kind, Some(number.parse().map_err(|_| unknown(text))?)),
            None => (text, None),
        };
        match (kind, number) {
            ("auto", None) => Ok(Self::Auto),
            ("cpu", None) => Ok(Self::Cpu),
            ("vulkan", number) => Ok(Self::Vulkan(number)),
            ("cuda", number) => Ok(Self::Cuda(number)),
            _ => Err(unknown(text)),
        }
    }
}

fn unknown(text: &str) -> NetworkError {
    let problem = "is no device; write auto, cpu, vulkan, vulkan:N, cuda or cuda:N (N counts from 0)".into();
    NetworkError::Device { device: text.into(), problem }
}

impl TryFrom<String> for ComputeDevice {
    type Error = NetworkError;

    fn try_from(text: String) -> Result<Self> {
        text.parse()
    }
}

impl From<ComputeDevice> for String {
    fn from(device: ComputeDevice) -> Self {
        device.to_string()
    }
}

impl JsonSchema for ComputeDevice {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "ComputeDevice".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "Which device computes: auto, cpu, vulkan, vulkan:N, cuda or cuda:N.",
            "type": "string",
            "pattern": "^(auto|cpu|(vulkan|cuda)(:[0-9]+)?)$",
        })
    }
}
