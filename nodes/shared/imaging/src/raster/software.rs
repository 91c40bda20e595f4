//! The software rasteriser: transform, cover (z-buffer of triangle numbers), then shade what is visible.
//!
//! Coverage is exact in fixed point (1/256 pixel, top-left rule), so that triangles which share an edge neither
//! overlap nor leave a gap. Depth, texture coordinates and normals come from the intersection of the pixel's ray
//! with the triangle in camera space, which is perspective-correct and holds for clipped triangles as well.

use super::surface::{Headlight, Shader, Surface, unit};
use super::{NEAR_M, RasterError, Rasteriser, Rendering, View, check_view};
use crate::{BACKGROUND_GREY, Mesh, RgbImage};
use pseudoflow_geometry::{Intrinsics, Pose};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

/// An object in a scene.
#[derive(Debug, Clone, Copy)]
pub struct Item<'a> {
    /// Its mesh.
    pub mesh: &'a Mesh,
    /// Its pose, metres.
    pub camera_from_object: Pose,
}

/// What lies behind the objects.
#[derive(Debug, Clone, Copy)]
pub enum Background<'a> {
    /// One colour.
    Colour([u8; 3]),
    /// An image; where its size differs from the rendering's, its top left part, repeated.
    Image(&'a RgbImage),
}

/// Most objects in a scene: the mask has one byte a pixel.
pub const MAX_ITEMS: usize = 255;

/// Several objects before one camera; nearer ones hide farther ones.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a> {
    /// The objects, at most [`MAX_ITEMS`]; further ones are not drawn.
    pub items: &'a [Item<'a>],
    /// The camera.
    pub intrinsics: Intrinsics,
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// What lies behind.
    pub background: Background<'a>,
}

/// Buffers that [`render_scene`] uses again from one call to the next.
#[derive(Debug, Default)]
pub struct Scratch {
    vertices: Vec<Vertex>,
    inverse_depth: Vec<f32>,
    triangle: Vec<u32>,
}

/// A vertex in the camera's frame and on the screen.
#[derive(Debug, Clone, Copy)]
struct Vertex {
    in_camera: [f32; 3],
    /// Screen position in 1/256 pixel.
    x: i32,
    y: i32,
    /// 1 / z; 0 when before the near plane.
    inverse_depth: f32,
}

const NEAR: f32 = NEAR_M as f32;
const SUBPIXEL_BITS: u32 = 8;
const SUBPIXELS: f64 = 256.0;
/// Screen positions further out are moved here; the products of two still fit an i64.
const FARTHEST: f64 = (1 << 29) as f64;

/// Draws a scene into `out`, which takes the scene's size.
pub fn render_scene<S: Shader>(scene: &Scene<'_>, shader: &S, scratch: &mut Scratch, out: &mut Rendering) {
    let pixels = scene.width as usize * scene.height as usize;
    if (out.width(), out.height()) != (scene.width, scene.height) {
        *out = Rendering::new(scene.width, scene.height);
    }
    out.mask.fill(0);
    out.depth_m.fill(0.0);
    fill_background(scene, &mut out.rgb);
    scratch.inverse_depth.clear();
    scratch.inverse_depth.resize(pixels, 0.0);
    scratch.triangle.clear();
    scratch.triangle.resize(pixels, 0);
    for (index, item) in scene.items.iter().take(MAX_ITEMS).enumerate() {
        // One item is covered and shaded before the next, so that only one item's vertices are kept; a pixel that
        // a nearer item takes later is shaded again.
        transform(item, &scene.intrinsics, &mut scratch.vertices);
        let label = (index + 1) as u8;
        let drawn = cover(item.mesh, scene, scratch, &mut out.mask, label);
        shade(item, index, label, drawn, scene, shader, scratch, out);
    }
}

/// Draws only where a scene's objects are and how far: `mask` and `depth_m` (metres along the optical axis, 0 where nothing is)
/// take the scene's size. The masks are those of [`render_scene`]; the depth is that of the screen's planes, which agrees with it
/// to single precision.
pub fn render_depth(scene: &Scene<'_>, scratch: &mut Scratch, mask: &mut Vec<u8>, depth_m: &mut Vec<f32>) {
    let pixels = scene.width as usize * scene.height as usize;
    mask.clear();
    mask.resize(pixels, 0);
    scratch.inverse_depth.clear();
    scratch.inverse_depth.resize(pixels, 0.0);
    scratch.triangle.resize(pixels, 0);
    for (index, item) in scene.items.iter().take(MAX_ITEMS).enumerate() {
        transform(item, &scene.intrinsics, &mut scratch.vertices);
        cover(item.mesh, scene, scratch, mask, (index + 1) as u8);
    }
    depth_m.clear();
    depth_m.extend(scratch.inverse_depth.iter().map(|i| if *i > 0.0 { 1.0 / i } else { 0.0 }));
}

fn fill_background(scene: &Scene<'_>, rgb: &mut RgbImage) {
    match scene.background {
        Background::Colour(colour) => rgb.as_chunks_mut::<3>().0.fill(colour),
        Background::Image(image) if image.width() > 0 && image.height() > 0 => {
            for (x, y, pixel) in rgb.enumerate_pixels_mut() {
                *pixel = *image.get_pixel(x % image.width(), y % image.height());
            }
        }
        Background::Image(_) => rgb.fill(BACKGROUND_GREY),
    }
}

fn transform(item: &Item<'_>, k: &Intrinsics, vertices: &mut Vec<Vertex>) {
    let m = item.camera_from_object.rotation.to_rotation_matrix();
    let (m, t) = (m.matrix(), item.camera_from_object.translation.vector);
    vertices.clear();
    vertices.extend(item.mesh.vertices_m.iter().map(|v| {
        let v = v.map(f64::from);
        let [x, y, z] = [0, 1, 2].map(|i| m[(i, 0)] * v[0] + m[(i, 1)] * v[1] + m[(i, 2)] * v[2] + t[i]);
        place([x as f32, y as f32, z as f32], k)
    }));
}

fn place(in_camera: [f32; 3], k: &Intrinsics) -> Vertex {
    let [x, y, z] = in_camera.map(f64::from);
    if in_camera[2] < NEAR {
        return Vertex { in_camera, x: 0, y: 0, inverse_depth: 0.0 };
    }
    let inverse = 1.0 / z;
    let fixed = |v: f64| {
        let v = (v * SUBPIXELS).clamp(-FARTHEST, FARTHEST);
        (v + 0.5_f64.copysign(v)) as i32
    };
    let (x, y) = (fixed(k.fx * x * inverse + k.cx), fixed(k.fy * y * inverse + k.cy));
    Vertex { in_camera, x, y, inverse_depth: inverse as f32 }
}

/// The pixels that an item may have drawn: columns, then rows.
type Drawn = (std::ops::Range<usize>, std::ops::Range<usize>);

fn cover(mesh: &Mesh, scene: &Scene<'_>, scratch: &mut Scratch, mask: &mut [u8], label: u8) -> Drawn {
    let Scratch { vertices, inverse_depth, triangle } = scratch;
    let mut target = Target {
        inverse_depth,
        triangle,
        mask,
        label,
        cull: mesh.closed,
        width: scene.width as i32,
        height: scene.height as i32,
        low: (i32::MAX, i32::MAX),
        high: (-1, -1),
    };
    for (number, corners) in mesh.triangles.iter().enumerate() {
        let corners = corners.map(|i| vertices[i as usize]);
        if corners.iter().all(|v| v.inverse_depth > 0.0) {
            target.draw(&corners, number as u32);
        } else if corners.iter().any(|v| v.inverse_depth > 0.0) {
            draw_clipped(&mut target, &corners, number as u32, &scene.intrinsics);
        }
    }
    let range = |low: i32, high: i32| low.max(0) as usize..(high + 1).max(0) as usize;
    (range(target.low.0, target.high.0), range(target.low.1, target.high.1))
}

/// Cuts a triangle at the near plane and draws the polygon that remains as a fan.
fn draw_clipped(target: &mut Target<'_>, corners: &[Vertex; 3], number: u32, k: &Intrinsics) {
    let mut polygon: Vec<Vertex> = Vec::with_capacity(4);
    for i in 0..3 {
        let (from, to) = (corners[i], corners[(i + 1) % 3]);
        if from.inverse_depth > 0.0 {
            polygon.push(from);
        }
        if (from.inverse_depth > 0.0) != (to.inverse_depth > 0.0) {
            let (a, b) = (from.in_camera, to.in_camera);
            let t = (NEAR - a[2]) / (b[2] - a[2]);
            let mut cut: [f32; 3] = std::array::from_fn(|j| a[j] + t * (b[j] - a[j]));
            cut[2] = NEAR;
            polygon.push(place(cut, k));
        }
    }
    for i in 2..polygon.len() {
        target.draw(&[polygon[0], polygon[i - 1], polygon[i]], number);
    }
}

struct Target<'a> {
    inverse_depth: &'a mut [f32],
    triangle: &'a mut [u32],
    mask: &'a mut [u8],
    label: u8,
    cull: bool,
    width: i32,
    height: i32,
    low: (i32, i32),
    high: (i32, i32),
}

impl Target<'_> {
    fn draw(&mut self, corners: &[Vertex; 3], number: u32) {
        let [a, mut b, mut c] = *corners;
        let fixed_one = 1 << SUBPIXEL_BITS;
        let first = |p: i32, q: i32, r: i32| (p.min(q).min(r) + fixed_one - 1) >> SUBPIXEL_BITS;
        let last = |p: i32, q: i32, r: i32| p.max(q).max(r) >> SUBPIXEL_BITS;
        let (x0, x1) = (first(a.x, b.x, c.x).max(0), last(a.x, b.x, c.x).min(self.width - 1));
        let (y0, y1) = (first(a.y, b.y, c.y).max(0), last(a.y, b.y, c.y).min(self.height - 1));
        if x0 > x1 || y0 > y1 {
            return;
        }
        let twice_area = |b: &Vertex, c: &Vertex| {
            i64::from(b.x - a.x) * i64::from(c.y - a.y) - i64::from(b.y - a.y) * i64::from(c.x - a.x)
        };
        // In coordinates with y down, counter-clockwise triangles seen from their front have a negative area.
        let mut area = twice_area(&b, &c);
        if area == 0 || (area > 0 && self.cull) {
            return;
        }
        if area < 0 {
            std::mem::swap(&mut b, &mut c);
            area = -area;
        }
        self.low = (self.low.0.min(x0), self.low.1.min(y0));
        self.high = (self.high.0.max(x1), self.high.1.max(y1));
        let edges = [Edge::new(&b, &c, x0, y0), Edge::new(&c, &a, x0, y0), Edge::new(&a, &b, x0, y0)];
        let plane = Plane::new(&a, &b, &c, area);
        self.fill(&edges, &plane, (x0, x1, y0, y1), number);
    }

    fn fill(&mut self, edges: &[Edge; 3], plane: &Plane, (x0, x1, y0, y1): (i32, i32, i32, i32), number: u32) {
        let mut row = edges.each_ref().map(|e| e.value);
        for y in y0..=y1 {
            let mut w = row;
            let line = (y * self.width) as usize;
            let mut inverse_depth = plane.at(x0, y);
            for x in x0..=x1 {
                if w[0] | w[1] | w[2] >= 0 {
                    let i = line + x as usize;
                    if inverse_depth as f32 > self.inverse_depth[i] {
                        self.inverse_depth[i] = inverse_depth as f32;
                        self.triangle[i] = number;
                        self.mask[i] = self.label;
                    }
                }
                (0..3).for_each(|k| w[k] += edges[k].step_x);
                inverse_depth += plane.step_x;
            }
            (0..3).for_each(|k| row[k] += edges[k].step_y);
        }
    }
}

/// An edge function: not negative where a pixel centre is inside or on a top or left edge.
struct Edge {
    value: i64,
    step_x: i64,
    step_y: i64,
}

impl Edge {
    fn new(from: &Vertex, to: &Vertex, x0: i32, y0: i32) -> Self {
        let (dx, dy) = (i64::from(to.x - from.x), i64::from(to.y - from.y));
        let (px, py) = (i64::from(x0) << SUBPIXEL_BITS, i64::from(y0) << SUBPIXEL_BITS);
        let top_left = dy < 0 || (dy == 0 && dx > 0);
        let value = dx * (py - i64::from(from.y)) - dy * (px - i64::from(from.x)) - i64::from(!top_left);
        Self { value, step_x: -dy << SUBPIXEL_BITS, step_y: dx << SUBPIXEL_BITS }
    }
}

/// 1 / z over the screen, which is linear.
struct Plane {
    origin: (f64, f64, f64),
    step_x: f64,
    step_y: f64,
}

impl Plane {
    fn new(a: &Vertex, b: &Vertex, c: &Vertex, twice_area: i64) -> Self {
        let d = |p: i32, q: i32| f64::from(p - q);
        let (ab, ac) = (b.inverse_depth - a.inverse_depth, c.inverse_depth - a.inverse_depth);
        let (ab, ac) = (f64::from(ab), f64::from(ac));
        let scale = SUBPIXELS / twice_area as f64;
        Self {
            origin: (f64::from(a.x) / SUBPIXELS, f64::from(a.y) / SUBPIXELS, f64::from(a.inverse_depth)),
            step_x: (ab * d(c.y, a.y) - ac * d(b.y, a.y)) * scale,
            step_y: (ac * d(b.x, a.x) - ab * d(c.x, a.x)) * scale,
        }
    }

    fn at(&self, x: i32, y: i32) -> f64 {
        let (x0, y0, value) = self.origin;
        value + self.step_x * (f64::from(x) - x0) + self.step_y * (f64::from(y) - y0)
    }
}

fn shade<S: Shader>(
    item: &Item<'_>,
    index: usize,
    label: u8,
    (columns, rows): Drawn,
    scene: &Scene<'_>,
    shader: &S,
    scratch: &Scratch,
    out: &mut Rendering,
) {
    let k = &scene.intrinsics;
    let m = item.camera_from_object.rotation.to_rotation_matrix();
    let rotation: [[f32; 3]; 3] = [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[(i, j)] as f32));
    let step = [1.0 / k.fx, 1.0 / k.fy];
    let pixels = out.rgb.as_chunks_mut::<3>().0;
    for y in rows {
        for x in columns.clone() {
            let i = y * scene.width as usize + x;
            if out.mask[i] != label {
                continue;
            }
            let ray = [(x as f64 - k.cx) * step[0], (y as f64 - k.cy) * step[1]];
            let corners = item.mesh.triangles[scratch.triangle[i] as usize];
            let hit = Hit::new(corners.map(|c| scratch.vertices[c as usize].in_camera), ray, step);
            out.depth_m[i] = hit.point[2];
            let surface = surface(item.mesh, corners, &hit, index, &rotation);
            pixels[i] = shader.shade(&surface).map(|c| (c * 255.0 + 0.5).clamp(0.0, 255.0) as u8);
        }
    }
}

/// Where a pixel's ray meets a triangle.
struct Hit {
    /// Barycentric coordinates, in [0, 1], sum 1.
    weights: [f32; 3],
    /// The same one pixel further right and down, not bounded.
    weights_dx: [f32; 3],
    weights_dy: [f32; 3],
    /// In the camera's frame, metres.
    point: [f32; 3],
    front: bool,
}

impl Hit {
    /// `ray` is the pixel at z = 1, `step` the size of a pixel there.
    fn new(corners: [[f32; 3]; 3], ray: [f64; 2], step: [f64; 2]) -> Self {
        let v = corners.map(|c| c.map(f64::from));
        // The volume of the tetrahedron (ray, v_j, v_k) is proportional to the weight of v_i.
        let n = [cross(v[1], v[2]), cross(v[2], v[0]), cross(v[0], v[1])];
        let volumes = n.map(|n| n[0] * ray[0] + n[1] * ray[1] + n[2]);
        let total: f64 = volumes.iter().sum();
        let scale = 1.0 / total;
        let mut weights = volumes.map(|b| b * scale);
        if !weights.iter().all(|w| (0.0..=1.0).contains(w)) {
            // The fixed-point outline reaches 1/512 pixel over the triangle; edge-on that could be far away.
            let bounded = weights.map(|w| if w.is_nan() { 0.0 } else { w.clamp(0.0, 1.0) });
            let sum: f64 = bounded.iter().sum();
            weights = if sum > 0.0 { bounded.map(|w| w / sum) } else { [1.0 / 3.0; 3] };
        }
        let moved = |axis: usize| {
            let volumes: [f64; 3] = std::array::from_fn(|i| volumes[i] + n[i][axis] * step[axis]);
            let moved_total: f64 = volumes.iter().sum();
            // Where the neighbour's ray misses the plane, the footprint is without bound.
            let scale = 1.0 / moved_total;
            let ahead = moved_total * total > 0.0;
            volumes.map(|b| if ahead { (b * scale) as f32 } else { 1.0 })
        };
        let point = std::array::from_fn(|i| (0..3).map(|j| weights[j] * v[j][i]).sum::<f64>() as f32);
        Self {
            weights: weights.map(|w| w as f32),
            weights_dx: moved(0),
            weights_dy: moved(1),
            point,
            front: total < 0.0,
        }
    }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn blend<const N: usize>(weights: &[f32; 3], values: [[f32; N]; 3]) -> [f32; N] {
    std::array::from_fn(|k| weights[0] * values[0][k] + weights[1] * values[1][k] + weights[2] * values[2][k])
}

fn surface(mesh: &Mesh, corners: [u32; 3], hit: &Hit, item: usize, rotation: &[[f32; 3]; 3]) -> Surface {
    let corners = corners.map(|c| c as usize);
    let normal = unit(blend(&hit.weights, corners.map(|c| mesh.normals[c])));
    let sign = if hit.front { 1.0 } else { -1.0 };
    let normal_in_camera = rotation.map(|row| sign * super::surface::dot(row, normal));
    Surface {
        item,
        albedo: albedo(mesh, corners, hit),
        point_in_camera: hit.point,
        point_in_object: blend(&hit.weights, corners.map(|c| mesh.vertices_m[c])),
        normal_in_camera,
        to_camera: unit(hit.point.map(|c| -c)),
    }
}

/// What a mesh without texture and colours looks like.
pub const PLAIN_ALBEDO: f32 = 200.0 / 255.0;

fn albedo(mesh: &Mesh, corners: [usize; 3], hit: &Hit) -> [f32; 3] {
    if let Some(texture) = &mesh.texture {
        let uv = corners.map(|c| mesh.texcoords[c]);
        let at = blend(&hit.weights, uv);
        let towards = |weights: &[f32; 3]| {
            let there = blend(weights, uv);
            [there[0] - at[0], there[1] - at[1]]
        };
        texture.sample(at, towards(&hit.weights_dx), towards(&hit.weights_dy))
    } else if mesh.colours.is_empty() {
        [PLAIN_ALBEDO; 3]
    } else {
        blend(&hit.weights, corners.map(|c| mesh.colours[c].map(|v| f32::from(v) / 255.0)))
    }
}

/// [`Rasteriser`] on the CPU. Views are rendered in parallel; each by one thread, so the bytes do not depend on it.
#[derive(Debug, Default)]
pub struct SoftwareRasteriser {
    objects: BTreeMap<u32, Arc<Mesh>>,
    /// Buffers that no render uses at the moment.
    scratch: Mutex<Vec<Scratch>>,
}

impl SoftwareRasteriser {
    /// A rasteriser that knows no object yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Renders one view with any shader.
    ///
    /// # Errors
    /// As [`Rasteriser::render`].
    pub fn render_with<S: Shader>(&self, index: usize, view: &View, shader: &S) -> Result<Rendering, RasterError> {
        check_view(index, view)?;
        let mesh = self.objects.get(&view.object_id).ok_or_else(|| RasterError::UnknownObject {
            object_id: view.object_id,
            known: self.objects.keys().copied().collect(),
        })?;
        let scene = Scene {
            items: &[Item { mesh, camera_from_object: view.camera_from_object }],
            intrinsics: view.intrinsics,
            width: view.width,
            height: view.height,
            background: Background::Colour([BACKGROUND_GREY; 3]),
        };
        let mut scratch = self.scratch.lock().ok().and_then(|mut pool| pool.pop()).unwrap_or_default();
        let mut out = Rendering::new(view.width, view.height);
        render_scene(&scene, shader, &mut scratch, &mut out);
        if let Ok(mut pool) = self.scratch.lock() {
            pool.push(scratch);
        }
        Ok(out)
    }
}

impl Rasteriser for SoftwareRasteriser {
    fn name(&self) -> String {
        "software rasteriser (CPU)".to_owned()
    }

    fn add_object(&mut self, object_id: u32, mesh: &Arc<Mesh>) -> Result<(), RasterError> {
        self.objects.insert(object_id, Arc::clone(mesh));
        Ok(())
    }

    fn render(&self, views: &[View]) -> Result<Vec<Rendering>, RasterError> {
        let one = |(i, view)| self.render_with(i, view, &Headlight::default());
        match views.len() {
            1 => Ok(vec![one((0, &views[0]))?]),
            _ => views.par_iter().enumerate().map(one).collect(),
        }
    }
}
