//! What is nearest at each sample of a scene: a z-buffer of items and triangles, shaded later and only where asked.
//!
//! Coverage is exact in fixed point (1/256 pixel, top-left rule), so that triangles which share an edge neither
//! overlap nor leave a gap.

use super::NEAR_M;
use super::hit::{Hit, surface};
use super::software::{Item, MAX_ITEMS, Scene};
use super::surface::Surface;
use pseudoflow_geometry::Intrinsics;

/// Which triangle of which item is nearest at each sample. Its buffers are used again from one scene to the next.
#[derive(Debug, Default)]
pub struct Scratch {
    vertices: Vec<Vertex>,
    /// First vertex and rotation of each item.
    frames: Vec<(usize, [[f32; 3]; 3])>,
    inverse_depth: Vec<f32>,
    triangle: Vec<u32>,
    owner: Vec<u8>,
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

impl Scratch {
    /// Finds what is nearest at each of the scene's `width x height` samples; what was there before is forgotten.
    pub fn cover(&mut self, scene: &Scene<'_>) {
        let samples = scene.width as usize * scene.height as usize;
        let Self { vertices, frames, inverse_depth, triangle, owner } = self;
        vertices.clear();
        frames.clear();
        inverse_depth.clear();
        inverse_depth.resize(samples, 0.0);
        triangle.clear();
        triangle.resize(samples, 0);
        owner.clear();
        owner.resize(samples, 0);
        for (index, item) in scene.items.iter().take(MAX_ITEMS).enumerate() {
            let first = vertices.len();
            if is_beside(item, scene) {
                frames.push((first, [[0.0; 3]; 3]));
                continue;
            }
            frames.push((first, transform(item, &scene.intrinsics, vertices)));
            let mut target = Target {
                inverse_depth,
                triangle,
                owner,
                label: (index + 1) as u8,
                cull: item.mesh.closed,
                width: scene.width as i32,
                height: scene.height as i32,
            };
            let vertices = &vertices[first..];
            for (number, corners) in item.mesh.triangles.iter().enumerate() {
                let [a, b, c] = *corners;
                let corners = [vertices[a as usize], vertices[b as usize], vertices[c as usize]];
                if corners.iter().all(|v| v.inverse_depth > 0.0) {
                    target.draw(&corners, number as u32);
                } else if corners.iter().any(|v| v.inverse_depth > 0.0) {
                    draw_clipped(&mut target, &corners, number as u32, &scene.intrinsics);
                }
            }
        }
    }

    /// For each sample 0 where nothing is, else n for the n-th item, counted from 1.
    #[must_use]
    pub fn owners(&self) -> &[u8] {
        &self.owner
    }

    /// 1 / z of each sample, 1/m; 0 where nothing is. Good to 1e-4 relative; [`Scratch::surface_at`] is exact.
    #[must_use]
    pub fn inverse_depths(&self) -> &[f32] {
        &self.inverse_depth
    }

    /// The triangle of its owner's mesh at each sample; meaningless where nothing is.
    #[must_use]
    pub fn triangles(&self) -> &[u32] {
        &self.triangle
    }

    /// The surface that owns a sample, as the ray through `(x, y)` meets its triangle; where the ray misses, the nearest
    /// point of the triangle in barycentric coordinates. `scene` must be the one that was covered; textures are filtered
    /// for a footprint of `footprint` samples. The sample must have an owner.
    #[must_use]
    pub fn surface_at(&self, scene: &Scene<'_>, sample: usize, [x, y]: [f64; 2], footprint: f64) -> Surface {
        let item = usize::from(self.owner[sample]).max(1) - 1;
        let mesh = scene.items[item].mesh;
        let (first, rotation) = &self.frames[item];
        let k = &scene.intrinsics;
        let step = [1.0 / k.fx, 1.0 / k.fy];
        let ray = [(x - k.cx) * step[0], (y - k.cy) * step[1]];
        let step = step.map(|s| s * footprint);
        let corners = mesh.triangles[self.triangle[sample] as usize];
        let hit = Hit::new(corners.map(|c| self.vertices[first + c as usize].in_camera), ray, step);
        surface(mesh, corners, &hit, item, rotation)
    }
}

/// Whether all of an item lies before the camera and beyond one side of the samples, as its bounding box does.
fn is_beside(item: &Item<'_>, scene: &Scene<'_>) -> bool {
    let corners = item.mesh.box_corners_m().map(|c| item.camera_from_object * c);
    if corners.iter().any(|c| c.z < NEAR_M) {
        return false;
    }
    let k = &scene.intrinsics;
    let seen = corners.map(|c| [k.fx * c.x / c.z + k.cx, k.fy * c.y / c.z + k.cy]);
    let sizes = [scene.width, scene.height].map(f64::from);
    (0..2).any(|a| seen.iter().all(|at| at[a] < -1.0) || seen.iter().all(|at| at[a] > sizes[a]))
}

/// Appends the item's vertices; its rotation.
fn transform(item: &Item<'_>, k: &Intrinsics, vertices: &mut Vec<Vertex>) -> [[f32; 3]; 3] {
    let m = item.camera_from_object.rotation.to_rotation_matrix();
    let (m, t) = (m.matrix(), item.camera_from_object.translation.vector);
    let row = |i: usize, v: &[f32; 3]| {
        let [x, y, z] = [f64::from(v[0]), f64::from(v[1]), f64::from(v[2])];
        (m[(i, 0)] * x + m[(i, 1)] * y + m[(i, 2)] * z + t[i]) as f32
    };
    vertices.extend(item.mesh.vertices_m.iter().map(|v| place([row(0, v), row(1, v), row(2, v)], k)));
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[(i, j)] as f32))
}

fn place(in_camera: [f32; 3], k: &Intrinsics) -> Vertex {
    let [x, y, z] = [f64::from(in_camera[0]), f64::from(in_camera[1]), f64::from(in_camera[2])];
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
    owner: &'a mut [u8],
    label: u8,
    cull: bool,
    width: i32,
    height: i32,
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
        let edges = [Edge::new(&b, &c, x0, y0), Edge::new(&c, &a, x0, y0), Edge::new(&a, &b, x0, y0)];
        let plane = Plane::new(&a, &b, &c, area);
        self.fill(&edges, &plane, (x0, x1, y0, y1), number);
    }

    fn fill(&mut self, edges: &[Edge; 3], plane: &Plane, (x0, x1, y0, y1): (i32, i32, i32, i32), number: u32) {
        let mut row = edges.each_ref().map(|e| e.value);
        for y in y0..=y1 {
            let line = (y * self.width) as usize;
            if x1 - x0 >= WIDE_PX {
                if let Some((from, to)) = span(edges, &row, x1 - x0) {
                    self.fill_span(line, (x0 + from, x0 + to), plane.at(x0 + from, y), plane.step_x, number);
                }
            } else {
                self.fill_row(edges, row, line, (x0, x1), (plane.at(x0, y), plane.step_x), number);
            }
            (0..3).for_each(|k| row[k] += edges[k].step_y);
        }
    }

    fn fill_row(
        &mut self,
        edges: &[Edge; 3],
        mut w: [i64; 3],
        line: usize,
        (x0, x1): (i32, i32),
        (mut inverse_depth, step): (f64, f64),
        number: u32,
    ) {
        for x in x0..=x1 {
            if w[0] | w[1] | w[2] >= 0 {
                self.put(line + x as usize, inverse_depth as f32, number);
            }
            (0..3).for_each(|k| w[k] += edges[k].step_x);
            inverse_depth += step;
        }
    }

    /// The samples from `from` to `to` of a line, all of which lie in the triangle.
    fn fill_span(&mut self, line: usize, (from, to): (i32, i32), mut inverse_depth: f64, step: f64, number: u32) {
        for x in from..=to {
            self.put(line + x as usize, inverse_depth as f32, number);
            inverse_depth += step;
        }
    }

    fn put(&mut self, sample: usize, inverse_depth: f32, number: u32) {
        if inverse_depth > self.inverse_depth[sample] {
            self.inverse_depth[sample] = inverse_depth;
            self.triangle[sample] = number;
            self.owner[sample] = self.label;
        }
    }
}

/// In rows at least this long the part inside a triangle is found by division, not by trying each sample.
const WIDE_PX: i32 = 24;

/// First and last step from 0 to `last` for which no edge function is negative.
fn span(edges: &[Edge; 3], row: &[i64; 3], last: i32) -> Option<(i32, i32)> {
    let (mut from, mut to) = (0_i64, i64::from(last));
    for (edge, &value) in edges.iter().zip(row) {
        match edge.step_x {
            0 if value < 0 => return None,
            0 => {}
            // value + n step >= 0 from n = ceil(-value / step) on.
            step if step > 0 => from = from.max((-value).div_euclid(step) + i64::from((-value).rem_euclid(step) != 0)),
            step => to = to.min(value.div_euclid(-step)),
        }
    }
    (from <= to).then_some((from as i32, to as i32))
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
