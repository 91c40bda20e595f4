//! Where a pixel's ray meets a triangle, and what the surface is like there: depth, texture coordinates and normals come
//! from the intersection in camera space, which is perspective-correct and holds for clipped triangles as well.

use super::surface::{Surface, unit};
use crate::Mesh;

/// Where a pixel's ray meets a triangle.
pub(super) struct Hit {
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
    pub(super) fn new(corners: [[f32; 3]; 3], ray: [f64; 2], step: [f64; 2]) -> Self {
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

pub(super) fn surface(mesh: &Mesh, corners: [u32; 3], hit: &Hit, item: usize, rotation: &[[f32; 3]; 3]) -> Surface {
    let corners = corners.map(|c| c as usize);
    let normal = unit(blend(&hit.weights, corners.map(|c| mesh.normals[c])));
    let sign = if hit.front { 1.0 } else { -1.0 };
    let normal_in_camera = rotation.map(|row| sign * super::surface::dot(row, normal));
    Surface {
        item,
        albedo: albedo(mesh, corners, hit),
        openness: match mesh.openness.is_empty() {
            true => 1.0,
            false => blend(&hit.weights, corners.map(|c| [f32::from(mesh.openness[c]) / 255.0]))[0],
        },
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
