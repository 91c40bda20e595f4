use super::adapter::Gpu;
use super::pipeline::Pipelines;
use bytemuck::{Pod, Zeroable};
use pseudoflow_imaging::raster::{PLAIN_ALBEDO, RasterError};
use pseudoflow_imaging::{Level, Mesh, Texture};
use wgpu::util::DeviceExt;

/// A vertex as the shader reads it.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct Corner {
    position: [f32; 3],
    normal: [f32; 3],
    uv: [f32; 2],
    colour: [u8; 4],
}

/// A mesh in the device's memory.
pub(crate) struct GpuObject {
    pub(crate) corners: wgpu::Buffer,
    pub(crate) indices: wgpu::Buffer,
    pub(crate) index_count: u32,
    pub(crate) surface: wgpu::BindGroup,
    pub(crate) closed: bool,
    textured: bool,
}

impl GpuObject {
    pub(crate) fn upload(gpu: &Gpu, pipelines: &Pipelines, mesh: &Mesh) -> Result<Self, RasterError> {
        let limits = gpu.device.limits();
        let side = mesh.texture.as_ref().map_or(1, |t| t.levels()[0].width.max(t.levels()[0].height));
        if side > limits.max_texture_dimension_2d {
            return Err(gpu.error(format!("the texture has {side} texels a side: scale it down")));
        }
        let bytes = (mesh.vertices_m.len() * size_of::<Corner>()).max(mesh.triangles.len() * 12) as u64;
        if bytes > limits.max_buffer_size {
            return Err(gpu.error(format!("the mesh has {} triangles: decimate it", mesh.triangles.len())));
        }
        let corners: Vec<Corner> = (0..mesh.vertices_m.len()).map(|i| corner(mesh, i)).collect();
        let buffer = |contents: &[u8], usage| {
            gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: None, contents, usage })
        };
        Ok(Self {
            corners: buffer(bytemuck::cast_slice(&corners), wgpu::BufferUsages::VERTEX),
            indices: buffer(bytemuck::cast_slice(&mesh.triangles), wgpu::BufferUsages::INDEX),
            index_count: 3 * mesh.triangles.len() as u32,
            surface: surface(gpu, pipelines, mesh.texture.as_ref()),
            closed: mesh.closed,
            textured: mesh.texture.is_some(),
        })
    }

    pub(crate) fn textured(&self) -> bool {
        self.textured
    }
}

fn corner(mesh: &Mesh, i: usize) -> Corner {
    let plain = (PLAIN_ALBEDO * 255.0).round() as u8;
    let [r, g, b] = mesh.colours.get(i).copied().unwrap_or([plain; 3]);
    Corner {
        position: mesh.vertices_m[i],
        normal: mesh.normals[i],
        uv: mesh.texcoords.get(i).copied().unwrap_or_default(),
        colour: [r, g, b, 255],
    }
}

/// The texture with all its levels and its sampler; one white texel for meshes without.
fn surface(gpu: &Gpu, pipelines: &Pipelines, texture: Option<&Texture>) -> wgpu::BindGroup {
    let white = [Level { width: 1, height: 1, data: vec![[255; 4]] }];
    let levels = texture.map_or(&white[..], Texture::levels);
    let on_device = gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some("surface"),
        size: extent(&levels[0]),
        mip_level_count: levels.len() as u32,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba8Unorm,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    });
    for (mip_level, level) in levels.iter().enumerate() {
        let mut to = on_device.as_image_copy();
        to.mip_level = mip_level as u32;
        let layout =
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * level.width), rows_per_image: None };
        gpu.queue.write_texture(to, bytemuck::cast_slice(&level.data), layout, extent(level));
    }
    let mode = match texture.is_some_and(Texture::repeats) {
        true => wgpu::AddressMode::Repeat,
        false => wgpu::AddressMode::ClampToEdge,
    };
    let sampler = gpu.device.create_sampler(&wgpu::SamplerDescriptor {
        address_mode_u: mode,
        address_mode_v: mode,
        mag_filter: wgpu::FilterMode::Linear,
        min_filter: wgpu::FilterMode::Linear,
        mipmap_filter: wgpu::MipmapFilterMode::Linear,
        ..Default::default()
    });
    let view = on_device.create_view(&wgpu::TextureViewDescriptor::default());
    gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("surface"),
        layout: &pipelines.surface_layout,
        entries: &[
            wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(&view) },
            wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::Sampler(&sampler) },
        ],
    })
}

fn extent(level: &Level) -> wgpu::Extent3d {
    wgpu::Extent3d { width: level.width, height: level.height, depth_or_array_layers: 1 }
}
