//! The names of devices that compute, as commands and graphs write them.

use crate::error::{NetworkError, Result};
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

#[cfg(test)]
mod tests;
