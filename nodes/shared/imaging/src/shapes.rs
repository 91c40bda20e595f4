//! Simple meshes: occluders for synthetic scenes, and shapes whose depth is known for tests.

use crate::{ImagingError, Mesh, MeshParts};
use std::path::Path;

/// A closed box around the origin; `extents_m` are its edge lengths.
///
/// # Errors
/// When a length is not finite.
pub fn cuboid(extents_m: [f32; 3], colour: [u8; 3]) -> Result<Mesh, ImagingError> {
    let mut parts = MeshParts::default();
    for axis in 0..3 {
        for side in [-1.0_f32, 1.0] {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let start = parts.vertices_m.len() as u32;
            for (a, b) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                let mut corner = [0.0; 3];
                (corner[axis], corner[u], corner[v]) = (side, a, b);
                parts.vertices_m.push(std::array::from_fn(|k| corner[k] * extents_m[k] / 2.0));
                parts.normals.push(std::array::from_fn(|k| if k == axis { side } else { 0.0 }));
                parts.colours.push(colour);
            }
            let corners = if side > 0.0 { [0, 1, 2, 3] } else { [0, 3, 2, 1] }.map(|i| start + i);
            parts.triangles.push([corners[0], corners[1], corners[2]]);
            parts.triangles.push([corners[0], corners[2], corners[3]]);
        }
    }
    Mesh::new(parts, Path::new("(cuboid)"))
}

/// A closed sphere around the origin, cut into `2 rings` meridians and `rings` parallels (at least 3).
///
/// # Errors
/// When the radius is not finite.
pub fn sphere(radius_m: f32, rings: u32, colour: [u8; 3]) -> Result<Mesh, ImagingError> {
    let rings = rings.max(3);
    let meridians = 2 * rings;
    let mut parts = MeshParts::default();
    for ring in 0..=rings {
        let polar = std::f64::consts::PI * f64::from(ring) / f64::from(rings);
        for meridian in 0..meridians {
            let turn = std::f64::consts::TAU * f64::from(meridian) / f64::from(meridians);
            // The poles are one place each, so that the sphere is closed.
            let radius = if ring == 0 || ring == rings { 0.0 } else { polar.sin() };
            let normal = [radius * turn.cos(), radius * turn.sin(), polar.cos()].map(|c| c as f32);
            parts.normals.push(normal);
            parts.vertices_m.push(normal.map(|c| c * radius_m));
            parts.colours.push(colour);
        }
    }
    for ring in 0..rings {
        for meridian in 0..meridians {
            let at = |r: u32, m: u32| r * meridians + m % meridians;
            let (a, b) = (at(ring, meridian), at(ring, meridian + 1));
            let (c, d) = (at(ring + 1, meridian), at(ring + 1, meridian + 1));
            parts.triangles.extend([[a, c, d], [a, d, b]]);
        }
    }
    Mesh::new(parts, Path::new("(sphere)"))
}

/// A square facing down the z axis (towards a camera that looks along z), with a texture: `side_m` wide, its
/// centre at the origin, the texture's top row at the lowest y.
///
/// # Errors
/// When the side is not finite.
pub fn textured_square(side_m: f32, texture: crate::RgbImage) -> Result<Mesh, ImagingError> {
    let h = side_m / 2.0;
    let parts = MeshParts {
        vertices_m: vec![[-h, -h, 0.0], [h, -h, 0.0], [h, h, 0.0], [-h, h, 0.0]],
        normals: vec![[0.0, 0.0, -1.0]; 4],
        texcoords: vec![[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]],
        colours: Vec::new(),
        triangles: vec![[0, 2, 1], [0, 3, 2]],
        texture: Some(texture),
    };
    Mesh::new(parts, Path::new("(square)"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_and_spheres_are_closed_and_of_their_size() {
        let cuboid = cuboid([0.03, 0.04, 0.12], [9; 3]).unwrap();
        assert!(cuboid.closed && (cuboid.diameter_m() - 0.13).abs() < 1e-7);
        assert_eq!(cuboid.hull_points().len(), 8, "one of the three vertices at each corner");
        let sphere = sphere(0.05, 32, [9; 3]).unwrap();
        assert!(sphere.closed && (sphere.diameter_m() - 0.1).abs() < 1e-4);
    }

    #[test]
    fn an_inside_out_mesh_is_turned() {
        let good = cuboid([0.1; 3], [9; 3]).unwrap();
        let mut triangles = good.triangles.clone();
        triangles.iter_mut().for_each(|t| t.swap(0, 1));
        let parts = MeshParts { vertices_m: good.vertices_m.clone(), triangles, ..MeshParts::default() };
        let turned = Mesh::new(parts, Path::new("x")).unwrap();
        for (vertex, normal) in turned.vertices_m.iter().zip(&turned.normals) {
            assert!(vertex.iter().zip(normal).map(|(a, b)| a * b).sum::<f32>() > 0.0, "outwards");
        }
    }
}
