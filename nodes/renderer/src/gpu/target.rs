use super::adapter::Gpu;
use super::object::GpuObject;
use super::pipeline::{COLOUR_FORMAT, DEPTH_FORMAT, METRIC_FORMAT, Pipelines, ViewUniform};
use pseudoflow_imaging::BACKGROUND_GREY;
use pseudoflow_imaging::raster::{RasterError, Rendering};
use std::sync::mpsc;

/// Layers of one size to draw into, and the buffer through which they are read back.
pub(crate) struct Target {
    size: (u32, u32),
    depth: wgpu::TextureView,
    layers: Vec<Layer>,
    buffers: Option<Buffers>,
}

struct Layer {
    colour: wgpu::Texture,
    metric: wgpu::Texture,
}

struct Buffers {
    uniforms: wgpu::Buffer,
    views: wgpu::BindGroup,
    readback: wgpu::Buffer,
}

/// Distance of two uniforms in their buffer: the alignment that every adapter accepts.
const UNIFORM_STRIDE: u64 = 256;
/// Rows that are read back start at multiples of this.
const ROW_ALIGNMENT: u32 = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT;

impl Target {
    pub(crate) fn new(device: &wgpu::Device, size: (u32, u32)) -> Self {
        let depth = texture(device, size, DEPTH_FORMAT, wgpu::TextureUsages::RENDER_ATTACHMENT);
        Self { size, depth: view(&depth), layers: Vec::new(), buffers: None }
    }

    /// Makes room for `count` views.
    pub(crate) fn reserve(&mut self, device: &wgpu::Device, pipelines: &Pipelines, count: usize) {
        if self.layers.len() >= count && self.buffers.is_some() {
            return;
        }
        let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC;
        while self.layers.len() < count {
            let colour = texture(device, self.size, COLOUR_FORMAT, usage);
            self.layers.push(Layer { colour, metric: texture(device, self.size, METRIC_FORMAT, usage) });
        }
        let buffer = |label, size, usage| {
            let mapped_at_creation = false;
            device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation })
        };
        let uniform_usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        let uniforms = buffer("views", UNIFORM_STRIDE * count as u64, uniform_usage);
        let readback_usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        let readback = buffer("readback", self.view_bytes() * count as u64, readback_usage);
        let size = wgpu::BufferSize::new(size_of::<ViewUniform>() as u64);
        let binding = wgpu::BufferBinding { buffer: &uniforms, offset: 0, size };
        let views = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("views"),
            layout: &pipelines.view_layout,
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::Buffer(binding) }],
        });
        self.buffers = Some(Buffers { uniforms, views, readback });
    }

    pub(crate) fn upload(&self, queue: &wgpu::Queue, uniforms: impl Iterator<Item = ViewUniform>) {
        let Some(buffers) = &self.buffers else { return };
        for (i, uniform) in uniforms.enumerate() {
            queue.write_buffer(&buffers.uniforms, UNIFORM_STRIDE * i as u64, bytemuck::bytes_of(&uniform));
        }
    }

    pub(crate) fn draw(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        layer: usize,
        object: &GpuObject,
        pipelines: &Pipelines,
    ) {
        let (Some(buffers), Some(planes)) = (&self.buffers, self.layers.get(layer)) else { return };
        let (colour, metric) = (view(&planes.colour), view(&planes.metric));
        let grey = f64::from(BACKGROUND_GREY) / 255.0;
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("view"),
            color_attachments: &[
                cleared(&colour, wgpu::Color { r: grey, g: grey, b: grey, a: 0.0 }),
                cleared(&metric, wgpu::Color::TRANSPARENT),
            ],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &self.depth,
                depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Discard }),
                stencil_ops: None,
            }),
            ..Default::default()
        });
        pass.set_pipeline(if object.closed { &pipelines.closed } else { &pipelines.open });
        pass.set_bind_group(0, &buffers.views, &[(UNIFORM_STRIDE as usize * layer) as u32]);
        pass.set_bind_group(1, &object.surface, &[]);
        pass.set_vertex_buffer(0, object.corners.slice(..));
        pass.set_index_buffer(object.indices.slice(..), wgpu::IndexFormat::Uint32);
        pass.draw_indexed(0..object.index_count, 0, 0..1);
    }

    pub(crate) fn copy_out(&self, encoder: &mut wgpu::CommandEncoder, count: usize) {
        let Some(buffers) = &self.buffers else { return };
        let planes = self.layers.iter().take(count).flat_map(|l| [&l.colour, &l.metric]);
        for (i, plane) in planes.enumerate() {
            let layout = wgpu::TexelCopyBufferLayout {
                offset: self.plane_bytes() * i as u64,
                bytes_per_row: Some(self.row_bytes()),
                rows_per_image: None,
            };
            let to = wgpu::TexelCopyBufferInfo { buffer: &buffers.readback, layout };
            encoder.copy_texture_to_buffer(plane.as_image_copy(), to, extent(self.size));
        }
    }

    /// Waits for the device and reads what it drew.
    pub(crate) fn read(&self, gpu: &Gpu, count: usize) -> Result<Vec<Rendering>, RasterError> {
        let Some(buffers) = &self.buffers else { return Ok(Vec::new()) };
        let slice = buffers.readback.slice(..self.view_bytes() * count as u64);
        let (sender, receiver) = mpsc::channel();
        slice.map_async(wgpu::MapMode::Read, move |result| drop(sender.send(result)));
        gpu.device.poll(wgpu::PollType::wait_indefinitely()).map_err(|e| gpu.error(e.to_string()))?;
        match receiver.recv() {
            Ok(Ok(())) => {}
            _ => return gpu.check().and(Err(gpu.error("the rendering cannot be read back"))),
        }
        let renderings = {
            let bytes = slice.get_mapped_range().map_err(|e| gpu.error(e.to_string()))?;
            let planes: Vec<&[u8]> = bytes.chunks_exact(self.plane_bytes() as usize).collect();
            planes.chunks_exact(2).map(|pair| self.unpack(pair[0], pair[1])).collect()
        };
        buffers.readback.unmap();
        Ok(renderings)
    }

    fn unpack(&self, colour: &[u8], metric: &[u8]) -> Rendering {
        let mut out = Rendering::new(self.size.0, self.size.1);
        let (width, stride) = (self.size.0 as usize, self.row_bytes() as usize);
        let rgb = out.rgb.as_chunks_mut::<3>().0;
        for y in 0..self.size.1 as usize {
            let row = y * width..(y + 1) * width;
            let colours = colour[y * stride..].as_chunks::<4>().0;
            let depths = metric[y * stride..].as_chunks::<4>().0;
            for (x, i) in row.enumerate() {
                let [r, g, b, a] = colours[x];
                rgb[i] = [r, g, b];
                out.mask[i] = u8::from(a != 0);
                out.depth_m[i] = f32::from_le_bytes(depths[x]);
            }
        }
        out
    }

    fn row_bytes(&self) -> u32 {
        (4 * self.size.0).next_multiple_of(ROW_ALIGNMENT)
    }

    fn plane_bytes(&self) -> u64 {
        u64::from(self.row_bytes()) * u64::from(self.size.1)
    }

    fn view_bytes(&self) -> u64 {
        2 * self.plane_bytes()
    }
}

fn extent((width, height): (u32, u32)) -> wgpu::Extent3d {
    wgpu::Extent3d { width, height, depth_or_array_layers: 1 }
}

fn texture(
    device: &wgpu::Device,
    size: (u32, u32),
    format: wgpu::TextureFormat,
    usage: wgpu::TextureUsages,
) -> wgpu::Texture {
    device.create_texture(&wgpu::TextureDescriptor {
        label: Some("target"),
        size: extent(size),
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage,
        view_formats: &[],
    })
}

fn view(texture: &wgpu::Texture) -> wgpu::TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

fn cleared(view: &wgpu::TextureView, to: wgpu::Color) -> Option<wgpu::RenderPassColorAttachment<'_>> {
    let ops = wgpu::Operations { load: wgpu::LoadOp::Clear(to), store: wgpu::StoreOp::Store };
    Some(wgpu::RenderPassColorAttachment { view, depth_slice: None, resolve_target: None, ops })
}
