use pseudoflow_imaging::raster::RasterError;
use std::sync::{Arc, Mutex};
use wgpu::{Adapter, AdapterInfo, DeviceType};

/// Which adapters count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AdapterChoice {
    /// Graphics hardware only (discrete before integrated before virtual).
    Hardware,
    /// Drivers that compute on the CPU (lavapipe) as well, where there is no hardware. For tests.
    Any,
}

/// A device, its queue and the errors that it reported.
pub(crate) struct Gpu {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    pub(crate) name: String,
    failure: Arc<Mutex<Option<String>>>,
}

/// The names of all adapters here, for messages.
#[must_use]
pub fn adapters() -> Vec<String> {
    enumerate().iter().map(|a| describe(&a.get_info())).collect()
}

/// Vulkan, Metal and DirectX first; OpenGL, whose drivers print about missing displays, only where these offer nothing.
fn enumerate() -> Vec<Adapter> {
    let of = |backends: wgpu::Backends| {
        let descriptor =
            wgpu::InstanceDescriptor { backends, ..wgpu::InstanceDescriptor::new_without_display_handle() };
        pollster::block_on(wgpu::Instance::new(descriptor).enumerate_adapters(backends))
    };
    Some(of(wgpu::Backends::PRIMARY)).filter(|found| !found.is_empty()).unwrap_or_else(|| of(wgpu::Backends::GL))
}

fn describe(info: &AdapterInfo) -> String {
    format!("{} ({:?}, {:?}, driver {} {})", info.name, info.backend, info.device_type, info.driver, info.driver_info)
}

/// Lower is better.
fn rank(info: &AdapterInfo) -> u8 {
    match info.device_type {
        DeviceType::DiscreteGpu => 0,
        DeviceType::IntegratedGpu => 1,
        DeviceType::VirtualGpu => 2,
        DeviceType::Other => 3,
        DeviceType::Cpu => 4,
    }
}

impl Gpu {
    pub(crate) fn open(choice: AdapterChoice) -> Result<Self, RasterError> {
        let counts = |a: &&Adapter| choice == AdapterChoice::Any || a.get_info().device_type != DeviceType::Cpu;
        let offered = enumerate();
        let Some(adapter) = offered.iter().filter(counts).min_by_key(|a| rank(&a.get_info())) else {
            let names: Vec<String> = offered.iter().map(|a| describe(&a.get_info())).collect();
            let what = format!("no graphics adapter; the drivers offer {names:?}");
            return Err(RasterError::Device { device: "wgpu".into(), what });
        };
        let name = describe(&adapter.get_info());
        let error = |what: String| RasterError::Device { device: name.clone(), what };
        let limits = wgpu::Limits::default().using_resolution(adapter.limits());
        let descriptor = wgpu::DeviceDescriptor { required_limits: limits, ..Default::default() };
        let (device, queue) =
            pollster::block_on(adapter.request_device(&descriptor)).map_err(|e| error(e.to_string()))?;
        let failure = Arc::new(Mutex::new(None));
        let (on_error, on_loss) = (Arc::clone(&failure), Arc::clone(&failure));
        device.on_uncaptured_error(Arc::new(move |e: wgpu::Error| keep_first(&on_error, e.to_string())));
        device.set_device_lost_callback(move |reason, message| {
            if !matches!(reason, wgpu::DeviceLostReason::Destroyed) {
                keep_first(&on_loss, format!("the device was lost ({reason:?}): {message}"));
            }
        });
        Ok(Self { device, queue, name, failure })
    }

    pub(crate) fn error(&self, what: impl Into<String>) -> RasterError {
        RasterError::Device { device: self.name.clone(), what: what.into() }
    }

    /// What the device reported since the last call.
    pub(crate) fn check(&self) -> Result<(), RasterError> {
        let failure = self.failure.lock().ok().and_then(|mut f| f.take());
        failure.map_or(Ok(()), |what| Err(self.error(what)))
    }
}

fn keep_first(failure: &Mutex<Option<String>>, message: String) {
    if let Ok(mut kept) = failure.lock() {
        kept.get_or_insert(message);
    }
}
