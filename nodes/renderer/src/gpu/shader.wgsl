// The same rendering as the software rasteriser of pseudoflow-imaging: pixel centres at whole numbers, near plane at
// near_m, depth test on 1 / z, ambient light and one headlight, texture footprints with up to MAX_TAPS samples.

struct View {
    // Rows of camera_from_object.
    x_row: vec4<f32>,
    y_row: vec4<f32>,
    z_row: vec4<f32>,
    // fx, fy, cx, cy, pixels.
    intrinsics: vec4<f32>,
    // Width, height, pixels.
    size_px: vec2<f32>,
    // Ambient, headlight.
    light: vec2<f32>,
    near_m: f32,
    // 1 where the texture counts, 0 where the vertex colour does.
    textured: f32,
    padding: vec2<f32>,
}

const MAX_TAPS: f32 = 4.0;

@group(0) @binding(0) var<uniform> view: View;
@group(1) @binding(0) var surface: texture_2d<f32>;
@group(1) @binding(1) var surface_sampler: sampler;

struct Corner {
    @location(0) position: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) uv: vec2<f32>,
    @location(3) colour: vec4<f32>,
}

struct Fragment {
    @builtin(position) clip: vec4<f32>,
    @location(0) point_in_camera: vec3<f32>,
    @location(1) normal_in_camera: vec3<f32>,
    @location(2) uv: vec2<f32>,
    @location(3) colour: vec3<f32>,
}

@vertex
fn project(corner: Corner) -> Fragment {
    let p = vec4<f32>(corner.position, 1.0);
    let n = vec4<f32>(corner.normal, 0.0);
    var out: Fragment;
    out.point_in_camera = vec3<f32>(dot(view.x_row, p), dot(view.y_row, p), dot(view.z_row, p));
    out.normal_in_camera = vec3<f32>(dot(view.x_row, n), dot(view.y_row, n), dot(view.z_row, n));
    out.uv = corner.uv;
    out.colour = corner.colour.rgb;
    // A pixel's centre lies half a pixel inside its left and top edge, where the framebuffer starts to count.
    let q = out.point_in_camera;
    let pixel_z = view.intrinsics.xy * q.xy + (view.intrinsics.zw + 0.5) * q.z;
    let ndc_z = 2.0 * pixel_z / view.size_px - vec2<f32>(q.z);
    out.clip = vec4<f32>(ndc_z.x, -ndc_z.y, view.near_m, q.z);
    return out;
}

struct Pixel {
    @location(0) colour: vec4<f32>,
    @location(1) depth_m: f32,
}

@fragment
fn shade(fragment: Fragment, @builtin(front_facing) front: bool) -> Pixel {
    // Derivatives want uniform control flow: sample first.
    let texel = sample_footprint(fragment.uv);
    let albedo = mix(fragment.colour, texel, view.textured);
    let normal = normalize(fragment.normal_in_camera) * select(-1.0, 1.0, front);
    let to_camera = -normalize(fragment.point_in_camera);
    let facing = max(dot(normal, to_camera), 0.0);
    var out: Pixel;
    out.colour = vec4<f32>(albedo * (view.light.x + view.light.y * facing), 1.0);
    out.depth_m = fragment.point_in_camera.z;
    return out;
}

fn sample_footprint(uv: vec2<f32>) -> vec3<f32> {
    let size = vec2<f32>(textureDimensions(surface, 0));
    let along_x = dpdxFine(uv);
    let along_y = dpdyFine(uv);
    let length_x = length(along_x * size);
    let length_y = length(along_y * size);
    let x_is_major = length_x >= length_y;
    let major = max(length_x, length_y);
    let minor = min(length_x, length_y);
    let axis = select(along_y, along_x, x_is_major);
    // floor(x + 0.5): round() of WGSL rounds halves to even.
    let taps = clamp(floor(major / max(minor, 1e-6) + 0.5), 1.0, MAX_TAPS);
    let level = log2(max(major / taps, 1.0));
    var sum = vec3<f32>(0.0);
    for (var tap = 0.0; tap < taps; tap += 1.0) {
        let at = uv + ((tap + 0.5) / taps - 0.5) * axis;
        // Texture rows run downwards, v upwards.
        sum += textureSampleLevel(surface, surface_sampler, vec2<f32>(at.x, 1.0 - at.y), level).rgb;
    }
    return sum / taps;
}
