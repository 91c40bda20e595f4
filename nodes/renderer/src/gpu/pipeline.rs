use super::object::Corner;
use bytemuck::{Pod, Zeroable};
use pseudoflow_imaging::raster::{Headlight, NEAR_M, View};

pub(crate) const COLOUR_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
pub(crate) const METRIC_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Float;
pub(crate) const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// `View` of the shader.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct ViewUniform {
    rows: [[f32; 4]; 3],
    intrinsics: [f32; 4],
    size_px: [f32; 2],
    light: [f32; 2],
    near_m: f32,
    textured: f32,
    padding: [f32; 2],
}

impl ViewUniform {
    pub(crate) fn new(view: &View, light: &Headlight, textured: bool) -> Self {
        let m = view.camera_from_object.to_homogeneous();
        let k = view.intrinsics;
        Self {
            rows: [0, 1, 2].map(|i| [0, 1, 2, 3].map(|j| m[(i, j)] as f32)),
            intrinsics: [k.fx, k.fy, k.cx, k.cy].map(|v| v as f32),
            size_px: [view.width as f32, view.height as f32],
            light: [light.ambient, light.headlight],
            near_m: NEAR_M as f32,
            textured: f32::from(u8::from(textured)),
            padding: [0.0; 2],
        }
    }
}

/// What does not depend on objects and sizes.
pub(crate) struct Pipelines {
    pub(crate) view_layout: wgpu::BindGroupLayout,
    pub(crate) surface_layout: wgpu::BindGroupLayout,
    /// For meshes that are closed: triangles seen from behind are skipped.
    pub(crate) closed: wgpu::RenderPipeline,
    /// For all others.
    pub(crate) open: wgpu::RenderPipeline,
}

impl Pipelines {
    pub(crate) fn new(device: &wgpu::Device) -> Self {
        let view_layout = view_layout(device);
        let surface_layout = surface_layout(device);
        let shader = device.create_shader_module(wgpu::include_wgsl!("shader.wgsl"));
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("raster"),
            bind_group_layouts: &[Some(&view_layout), Some(&surface_layout)],
            immediate_size: 0,
        });
        let pipeline = |cull_mode| pipeline(device, &layout, &shader, cull_mode);
        Self { closed: pipeline(Some(wgpu::Face::Back)), open: pipeline(None), view_layout, surface_layout }
    }
}

fn view_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let ty = wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Uniform,
        has_dynamic_offset: true,
        min_binding_size: wgpu::BufferSize::new(size_of::<ViewUniform>() as u64),
    };
    let visibility = wgpu::ShaderStages::VERTEX_FRAGMENT;
    let entries = &[wgpu::BindGroupLayoutEntry { binding: 0, visibility, ty, count: None }];
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some("view"), entries })
}

fn surface_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let texture = wgpu::BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Float { filterable: true },
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    let sampler = wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering);
    let entry =
        |binding, ty| wgpu::BindGroupLayoutEntry { binding, visibility: wgpu::ShaderStages::FRAGMENT, ty, count: None };
    let entries = &[entry(0, texture), entry(1, sampler)];
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some("surface"), entries })
}

fn pipeline(
    device: &wgpu::Device,
    layout: &wgpu::PipelineLayout,
    shader: &wgpu::ShaderModule,
    cull_mode: Option<wgpu::Face>,
) -> wgpu::RenderPipeline {
    let attributes = wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3, 2 => Float32x2, 3 => Unorm8x4];
    let corners = wgpu::VertexBufferLayout {
        array_stride: size_of::<Corner>() as u64,
        step_mode: wgpu::VertexStepMode::Vertex,
        attributes: &attributes,
    };
    let target = |format| Some(wgpu::ColorTargetState { format, blend: None, write_mask: wgpu::ColorWrites::ALL });
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("raster"),
        layout: Some(layout),
        vertex: wgpu::VertexState {
            module: shader,
            entry_point: Some("project"),
            compilation_options: Default::default(),
            buffers: &[Some(corners)],
        },
        primitive: wgpu::PrimitiveState { front_face: wgpu::FrontFace::Ccw, cull_mode, ..Default::default() },
        depth_stencil: Some(wgpu::DepthStencilState {
            format: DEPTH_FORMAT,
            depth_write_enabled: Some(true),
            // The clip depth is near / z: larger is nearer.
            depth_compare: Some(wgpu::CompareFunction::Greater),
            stencil: Default::default(),
            bias: Default::default(),
        }),
        multisample: Default::default(),
        fragment: Some(wgpu::FragmentState {
            module: shader,
            entry_point: Some("shade"),
            compilation_options: Default::default(),
            targets: &[target(COLOUR_FORMAT), target(METRIC_FORMAT)],
        }),
        multiview_mask: None,
        cache: None,
    })
}
