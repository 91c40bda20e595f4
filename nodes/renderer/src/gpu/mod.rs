//! [`Rasteriser`] on a graphics adapter through wgpu, offscreen.

mod adapter;
mod object;
mod pipeline;
mod target;

pub use adapter::{AdapterChoice, adapters};

use adapter::Gpu;
use object::GpuObject;
use pipeline::{Pipelines, ViewUniform};
use pseudoflow_imaging::Mesh;
use pseudoflow_imaging::raster::{Headlight, RasterError, Rasteriser, Rendering, View, check_view};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use target::Target;

/// Renders on a graphics adapter what [`pseudoflow_imaging::raster::SoftwareRasteriser`] renders on the CPU.
///
/// Views of one size are drawn into the layers of one target and read back together. The same views give the same
/// bytes on the same adapter and driver. Against the software rasteriser (golden tests, lavapipe): depth within
/// 0.1 mm away from edges, silhouettes within a pixel.
pub struct GpuRasteriser {
    gpu: Gpu,
    pipelines: Pipelines,
    objects: BTreeMap<u32, GpuObject>,
    /// By width and height; kept from call to call.
    targets: Mutex<BTreeMap<(u32, u32), Target>>,
    headlight: Headlight,
}

/// Views drawn and read back at a time.
const BATCH: usize = 32;

impl GpuRasteriser {
    /// Opens an adapter.
    ///
    /// # Errors
    /// [`RasterError::Device`] when there is no adapter of that kind, or it refuses to work.
    pub fn open(choice: AdapterChoice) -> Result<Self, RasterError> {
        let gpu = Gpu::open(choice)?;
        let pipelines = Pipelines::new(&gpu.device);
        gpu.check()?;
        let (objects, targets) = (BTreeMap::new(), Mutex::new(BTreeMap::new()));
        Ok(Self { gpu, pipelines, objects, targets, headlight: Headlight::default() })
    }

    fn object(&self, object_id: u32) -> Result<&GpuObject, RasterError> {
        let unknown = || RasterError::UnknownObject { object_id, known: self.objects.keys().copied().collect() };
        self.objects.get(&object_id).ok_or_else(unknown)
    }

    fn check_size(&self, view: &View) -> Result<(), RasterError> {
        let limit = self.gpu.device.limits().max_texture_dimension_2d;
        match view.width.max(view.height) > limit {
            true => Err(self.gpu.error(format!(
                "{} x {} pixels, but a side may have {limit} at most on this adapter",
                view.width, view.height
            ))),
            false => Ok(()),
        }
    }

    /// Renders views that all have one size, at most [`BATCH`].
    fn render_batch(&self, views: &[&View], size: (u32, u32)) -> Result<Vec<Rendering>, RasterError> {
        let mut targets = self.targets.lock().map_err(|_| self.gpu.error("a thread failed while rendering"))?;
        let target = targets.entry(size).or_insert_with(|| Target::new(&self.gpu.device, size));
        target.reserve(&self.gpu.device, &self.pipelines, views.len());
        let objects = views.iter().map(|v| self.object(v.object_id)).collect::<Result<Vec<_>, _>>()?;
        let uniforms = views.iter().zip(&objects).map(|(v, o)| ViewUniform::new(v, &self.headlight, o.textured()));
        target.upload(&self.gpu.queue, uniforms);
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        for (layer, object) in objects.iter().enumerate() {
            target.draw(&mut encoder, layer, object, &self.pipelines);
        }
        target.copy_out(&mut encoder, views.len());
        self.gpu.queue.submit([encoder.finish()]);
        let renderings = target.read(&self.gpu, views.len());
        self.gpu.check()?;
        renderings
    }
}

impl Rasteriser for GpuRasteriser {
    fn name(&self) -> String {
        self.gpu.name.clone()
    }

    fn add_object(&mut self, object_id: u32, mesh: &Arc<Mesh>) -> Result<(), RasterError> {
        let object = GpuObject::upload(&self.gpu, &self.pipelines, mesh)?;
        self.gpu.check()?;
        self.objects.insert(object_id, object);
        Ok(())
    }

    fn render(&self, views: &[View]) -> Result<Vec<Rendering>, RasterError> {
        let mut by_size: BTreeMap<(u32, u32), Vec<usize>> = BTreeMap::new();
        for (i, view) in views.iter().enumerate() {
            check_view(i, view)?;
            self.check_size(view)?;
            self.object(view.object_id)?;
            by_size.entry((view.width, view.height)).or_default().push(i);
        }
        let mut out: Vec<Option<Rendering>> = vec![None; views.len()];
        for (size, places) in by_size {
            for places in places.chunks(BATCH) {
                let batch: Vec<&View> = places.iter().map(|&i| &views[i]).collect();
                for (&i, rendering) in places.iter().zip(self.render_batch(&batch, size)?) {
                    out[i] = Some(rendering);
                }
            }
        }
        Ok(out.into_iter().flatten().collect())
    }
}
