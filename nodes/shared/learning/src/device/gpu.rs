//! Devices of CubeCL: which are there, and whether one computes.

use super::{ComputeDevice, OpenDevice};
use crate::guard::guarded;
use burn::tensor::{Device, DeviceType, Tensor};
use pseudoflow_network::{NetworkError, Result};

#[cfg(feature = "vulkan")]
pub(super) fn vulkan(number: Option<u16>) -> Result<OpenDevice> {
    let mut devices = Device::enumerate(DeviceType::Vulkan).into_vec();
    // Numbers that stay what they are when a software driver is installed.
    devices.sort_by_key(is_software);
    let asked = ComputeDevice::Vulkan(number);
    let first = devices.iter().position(|device| !is_software(device));
    let Some(index) = number.map(usize::from).or(first) else {
        let found = match devices.len() {
            0 => "no Vulkan adapter answers; install the GPU's Vulkan driver and its loader (Debian: libvulkan1), \
                  or use `cpu`"
                .to_owned(),
            _ => "only a driver that computes on the processor is there (lavapipe); use `cpu`, which is faster, or \
                  name that driver: `vulkan:0`"
                .to_owned(),
        };
        return Err(NetworkError::Device { device: asked.to_string(), problem: found });
    };
    take(asked, &devices, index, |index| ComputeDevice::Vulkan(Some(index)))
}

/// Whether a Vulkan adapter computes on the processor.
#[cfg(feature = "vulkan")]
fn is_software(device: &Device) -> bool {
    use burn::backend::{CubeDevice, DispatchDevice, WgpuDeviceKind};
    match device.as_dispatch() {
        DispatchDevice::Cube(CubeDevice::Wgpu(wgpu)) => matches!(wgpu.kind, WgpuDeviceKind::Cpu),
        _ => false,
    }
}

#[cfg(feature = "cuda")]
pub(super) fn cuda(number: Option<u16>) -> Result<OpenDevice> {
    let devices = Device::enumerate(DeviceType::Cuda).into_vec();
    let asked = ComputeDevice::Cuda(number);
    if devices.is_empty() {
        let problem =
            "no NVIDIA GPU answers; install its driver (libcuda.so.1 must be found), or use `vulkan` or `cpu`";
        return Err(NetworkError::Device { device: asked.to_string(), problem: problem.into() });
    }
    take(asked, &devices, usize::from(number.unwrap_or(0)), |index| ComputeDevice::Cuda(Some(index)))
}

fn take(
    asked: ComputeDevice,
    devices: &[Device],
    index: usize,
    choice: impl Fn(u16) -> ComputeDevice,
) -> Result<OpenDevice> {
    let device = devices.get(index).ok_or_else(|| NetworkError::Device {
        device: asked.to_string(),
        problem: format!("has no number {index}; there are {}, counted from 0", devices.len()),
    })?;
    let name = guarded(&asked.to_string(), || try_out(device)).map_err(|error| NetworkError::Device {
        device: asked.to_string(),
        problem: format!("is there ({device:?}) but does not compute: {error}"),
    })?;
    Ok(OpenDevice { device: device.clone(), choice: choice(index as u16), name })
}

/// The device's name, after a sum that it had to compute.
fn try_out(device: &Device) -> Result<String> {
    let sum = Tensor::<1>::ones([8], device).sum();
    let sum = crate::loss::values(sum);
    assert_eq!(sum, [8.0], "eight ones make eight");
    Ok(device.identity().map_or_else(|| format!("{device:?}"), |identity| identity.name))
}
