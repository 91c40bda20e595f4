//! Other things in the scene: boxes, tins, cards, balls, fingers. Low-polygon meshes of random shape.

use super::random::Draw;
use pseudoflow_imaging::{ImagingError, Mesh, MeshParts};
use rand::Rng;
use std::path::Path;

/// Sides of a turned shape.
const SEGMENTS: usize = 20;

/// A random shape, `size_m` long, around its origin.
pub(super) fn draw_shape(rng: &mut impl Rng, size_m: f32) -> Result<Mesh, ImagingError> {
    let half = size_m / 2.0;
    match rng.below(5) {
        0 => cuboid(half * rng.uniform32(0.3, 1.0), half * rng.uniform32(0.2, 0.8), half),
        1 => cuboid(half * rng.uniform32(0.4, 1.0), half * 0.03, half),
        2 => turned(&tin(half * rng.uniform32(0.25, 0.9), half)),
        3 => turned(&ball(half * rng.uniform32(0.4, 1.0), half)),
        _ => finger(half * rng.uniform32(0.15, 0.4), half),
    }
}

/// A box or card, which shows a picture.
pub(super) fn draw_card(rng: &mut impl Rng, size_m: f32) -> Result<Mesh, ImagingError> {
    let half = size_m / 2.0;
    let thick = if rng.chance(0.5) { 0.03 } else { rng.uniform32(0.2, 0.8) };
    cuboid(half, half * rng.uniform32(0.4, 1.0), half * thick)
}

/// A colour of skin, sRGB 0 to 1; `red` is its brightest part.
pub(super) fn skin(rng: &mut impl Rng, red: f32) -> [f32; 3] {
    let (green, blue) = (rng.uniform32(0.6, 0.8), rng.uniform32(0.7, 0.95));
    [red, red * green, red * green * blue]
}

/// A finger or a rod along z with round ends.
pub(super) fn finger(radius_m: f32, half_m: f32) -> Result<Mesh, ImagingError> {
    let ring = |i: usize, sign: f32| {
        let angle = std::f32::consts::FRAC_PI_2 * i as f32 / 4.0;
        [radius_m * angle.sin(), sign * (half_m - radius_m + radius_m * angle.cos())]
    };
    let mut profile: Vec<[f32; 2]> = (0..=4).map(|i| ring(i, -1.0)).collect();
    profile.extend((0..=4).rev().map(|i| ring(i, 1.0)));
    turned(&profile)
}

fn tin(radius_m: f32, half_m: f32) -> Vec<[f32; 2]> {
    let rim = radius_m * 0.96;
    vec![
        [0.0, -half_m],
        [rim, -half_m],
        [radius_m, -0.96 * half_m],
        [radius_m, 0.96 * half_m],
        [rim, half_m],
        [0.0, half_m],
    ]
}

fn ball(radius_m: f32, half_m: f32) -> Vec<[f32; 2]> {
    let ring = |i: usize| {
        let angle = std::f32::consts::PI * i as f32 / 10.0;
        [radius_m * angle.sin(), -half_m * angle.cos()]
    };
    (0..=10).map(ring).collect()
}

/// The surface of revolution about z of a profile (radius, z) that goes upwards.
fn turned(profile: &[[f32; 2]]) -> Result<Mesh, ImagingError> {
    let mut parts = MeshParts::default();
    for [radius, z] in profile {
        // The poles of a ball are one point, also where the sine of pi is not quite zero.
        let radius = if radius.abs() < 1e-6 { 0.0 } else { *radius };
        parts.vertices_m.extend((0..SEGMENTS).map(|s| {
            let (sin, cos) = (std::f32::consts::TAU * s as f32 / SEGMENTS as f32).sin_cos();
            [radius * cos + 0.0, radius * sin + 0.0, *z]
        }));
    }
    for ring in 0..profile.len() - 1 {
        for s in 0..SEGMENTS {
            let at = |ring: usize, s: usize| (ring * SEGMENTS + s % SEGMENTS) as u32;
            let (a, b, c, d) = (at(ring, s), at(ring, s + 1), at(ring + 1, s + 1), at(ring + 1, s));
            parts.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    Mesh::new(parts, Path::new("(turned shape)"))
}

/// A cuboid with sharp edges, from its half sides.
fn cuboid(x: f32, y: f32, z: f32) -> Result<Mesh, ImagingError> {
    let mut parts = MeshParts::default();
    for axis in 0..3 {
        for sign in [-1.0_f32, 1.0] {
            let first = parts.vertices_m.len() as u32;
            for (u, v) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                let mut corner = [0.0; 3];
                (corner[axis], corner[(axis + 1) % 3], corner[(axis + 2) % 3]) = (sign, u, v);
                let mut normal = [0.0; 3];
                normal[axis] = sign;
                parts.vertices_m.push([corner[0] * x, corner[1] * y, corner[2] * z]);
                parts.normals.push(normal);
            }
            let [a, b, c, d] = [0, 1, 2, 3].map(|i| first + i);
            let faces = if sign > 0.0 { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] };
            parts.triangles.extend(faces);
        }
    }
    Mesh::new(parts, Path::new("(cuboid)"))
}

/// A square in the plane z = 0, seen from +z, `half_m` to each side.
pub(super) fn sheet(half_m: f32) -> Result<Mesh, ImagingError> {
    let corner = |x: f32, y: f32| [x * half_m, y * half_m, 0.0];
    let parts = MeshParts {
        vertices_m: vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..MeshParts::default()
    };
    Mesh::new(parts, Path::new("(sheet)"))
}

#[cfg(test)]
mod tests {
    use super::super::random::stream;
    use super::*;

    #[test]
    fn shapes_are_closed_and_as_long_as_asked() {
        for index in 0..40 {
            let mesh = draw_shape(&mut stream(5, index), 0.2).unwrap();
            assert!(mesh.closed, "shape {index}");
            let (low, high) = mesh.bounds_m();
            assert!(((high - low).z - 0.2).abs() < 1e-3, "shape {index}: {low} {high}");
        }
    }
}
