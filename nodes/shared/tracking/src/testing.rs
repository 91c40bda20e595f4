//! Things to be looked at, for tests.

use pseudoflow_imaging::{Mesh, MeshParts};
use std::path::Path;

/// A mesh with finer faces, whose corners have colours of their own.
pub(crate) fn spotted(mesh: &Mesh) -> Mesh {
    let mut parts = MeshParts::default();
    let mut state = 12345_u32;
    let mut grey = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    const N: usize = 12;
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|i| mesh.vertices_m[i as usize]);
        let first = parts.vertices_m.len() as u32;
        let index = |i: usize, j: usize| first + (i * (2 * N + 3 - i) / 2 + j) as u32;
        for i in 0..=N {
            for j in 0..=N - i {
                let (u, v) = (i as f32 / N as f32, j as f32 / N as f32);
                parts.vertices_m.push([0, 1, 2].map(|k| a[k] + u * (b[k] - a[k]) + v * (c[k] - a[k])));
                parts.colours.push([grey(), grey(), grey()]);
            }
        }
        for i in 0..N {
            for j in 0..N - i {
                parts.triangles.push([index(i, j), index(i + 1, j), index(i, j + 1)]);
                if j + 1 < N - i {
                    parts.triangles.push([index(i + 1, j), index(i + 1, j + 1), index(i, j + 1)]);
                }
            }
        }
    }
    Mesh::new(parts, Path::new("(spotted)")).unwrap()
}
