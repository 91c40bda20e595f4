//! Normals that are smooth over rounded surfaces and break at edges.

use super::solid::Solid;
use std::collections::HashMap;

/// A solid whose vertices are doubled along its edges, with normals.
pub(super) struct Creased {
    pub(super) vertices: Vec<[f32; 3]>,
    pub(super) normals: Vec<[f32; 3]>,
    pub(super) texcoords: Vec<[f32; 2]>,
    pub(super) part: Vec<u8>,
    pub(super) triangles: Vec<[u32; 3]>,
}

/// Each corner of a triangle gets the mean normal of the faces around its place that are turned from its own face by less than
/// `angle_deg`, weighted by area; corners of one vertex with the same normal stay one vertex.
pub(super) fn split(solid: &Solid, angle_deg: f32) -> Creased {
    let least = angle_deg.to_radians().cos();
    let place = |i: u32| solid.vertices[i as usize].map(|c| (c * 1e6).round() as i64);
    let faces: Vec<[f32; 3]> = solid.triangles.iter().map(|t| cross(t.map(|i| solid.vertices[i as usize]))).collect();
    let mut around: HashMap<[i64; 3], Vec<usize>> = HashMap::new();
    for (face, triangle) in solid.triangles.iter().enumerate() {
        triangle.iter().for_each(|&i| around.entry(place(i)).or_default().push(face));
    }
    let mut known: HashMap<(u32, [i32; 3]), u32> = HashMap::new();
    let (vertices, normals) = (Vec::new(), Vec::new());
    let mut out = Creased { vertices, normals, texcoords: Vec::new(), part: Vec::new(), triangles: Vec::new() };
    for (face, triangle) in solid.triangles.iter().enumerate() {
        let own = unit(faces[face]);
        let corner = triangle.map(|i| {
            let near = around[&place(i)].iter().filter(|&&f| dot(unit(faces[f]), own) >= least);
            let sum = near.fold([0.0; 3], |sum, &f| std::array::from_fn(|k| sum[k] + faces[f][k]));
            let normal = unit(sum);
            *known.entry((i, normal.map(|c| (c * 512.0).round() as i32))).or_insert_with(|| {
                out.vertices.push(solid.vertices[i as usize]);
                out.normals.push(normal);
                out.texcoords.push(solid.texcoords[i as usize]);
                out.part.push(solid.part[i as usize]);
                out.vertices.len() as u32 - 1
            })
        });
        out.triangles.push(corner);
    }
    out
}

/// Normal of a triangle, twice its area long.
fn cross([a, b, c]: [[f32; 3]; 3]) -> [f32; 3] {
    let (u, v): ([f32; 3], [f32; 3]) = (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| c[k] - a[k]));
    [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn unit(v: [f32; 3]) -> [f32; 3] {
    let length = dot(v, v).sqrt();
    if length > 1e-20 { v.map(|c| c / length) } else { [0.0, 0.0, 1.0] }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A roof of two squares that meet at x = 0 at an angle.
    fn roof(height: f32) -> Solid {
        let vertices = vec![
            [-1.0, 0.0, 0.0],
            [0.0, 0.0, height],
            [1.0, 0.0, 0.0],
            [-1.0, 1.0, 0.0],
            [0.0, 1.0, height],
            [1.0, 1.0, 0.0],
        ];
        let triangles = vec![[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]];
        Solid { texcoords: vec![[0.0; 2]; 6], part: vec![0; 6], vertices, triangles }
    }

    #[test]
    fn edges_split_and_bends_do_not() {
        assert_eq!(split(&roof(0.1), 35.0).vertices.len(), 6);
        let sharp = split(&roof(1.0), 35.0);
        assert_eq!(sharp.vertices.len(), 8);
        assert!(sharp.normals.iter().all(|n| (n[0].abs() - n[2]).abs() < 1e-5));
    }
}
