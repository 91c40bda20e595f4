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

use burn::tensor::Device;
use pseudoflow_network::{ComputeDevice, NetworkError, Result};
use std::fmt::{Display, Formatter};

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

impl OpenDevice {
    /// Finds and opens a device, and logs which one it is.
    ///
    /// # Errors
    /// It is not compiled in, not there, or refuses to compute: the message lists what is there and what to do.
    pub fn open(choice: ComputeDevice) -> Result<Self> {
        let open = match choice {
            ComputeDevice::Auto => auto(),
            ComputeDevice::Cpu => Ok(cpu()),
            ComputeDevice::Vulkan(number) => vulkan(number),
            ComputeDevice::Cuda(number) => cuda(number),
        }?;
        log::info!("device {choice}: {open} computes");
        Ok(open)
    }

    /// The GPU that `auto` would take, if there is one. Opens it.
    #[must_use]
    pub fn gpu_of_auto() -> Option<Self> {
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
    Ok(OpenDevice::gpu_of_auto().unwrap_or_else(cpu))
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
