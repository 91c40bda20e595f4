//! Smooth normals, and whether a mesh is closed and which way round it is.

use std::collections::HashMap;

/// What the triangles say about the surface, with vertices at the same place counted as one.
pub(crate) struct Topology {
    /// For each vertex the first vertex at its place (texture seams double vertices).
    pub(crate) welded: Vec<u32>,
    /// Every edge is shared by exactly two triangles that agree on the orientation.
    pub(crate) closed: bool,
    /// Closed, with triangles clockwise as seen from outside.
    pub(crate) inside_out: bool,
}

impl Topology {
    pub(crate) fn of(vertices: &[[f32; 3]], triangles: &[[u32; 3]]) -> Self {
        let welded = weld(vertices);
        let closed = is_closed(triangles, &welded);
        let inside_out = closed && signed_volume(vertices, triangles) < 0.0;
        Self { welded, closed, inside_out }
    }
}

fn weld(vertices: &[[f32; 3]]) -> Vec<u32> {
    let mut first: HashMap<[u32; 3], u32> = HashMap::with_capacity(vertices.len());
    let place = |v: &[f32; 3]| v.map(|c| (c + 0.0).to_bits()); // + 0.0 makes -0 and 0 one
    vertices.iter().enumerate().map(|(i, v)| *first.entry(place(v)).or_insert(i as u32)).collect()
}

fn is_closed(triangles: &[[u32; 3]], welded: &[u32]) -> bool {
    let mut balance: HashMap<(u32, u32), (u32, u32)> = HashMap::new();
    for t in triangles {
        let t = t.map(|i| welded[i as usize]);
        if t[0] == t[1] || t[1] == t[2] || t[2] == t[0] {
            continue; // no area, no edge
        }
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            let entry = balance.entry((a.min(b), a.max(b))).or_default();
            if a < b { entry.0 += 1 } else { entry.1 += 1 }
        }
    }
    !balance.is_empty() && balance.values().all(|&(there, back)| there == back)
}

fn signed_volume(vertices: &[[f32; 3]], triangles: &[[u32; 3]]) -> f64 {
    let p = |i: u32| vertices[i as usize].map(f64::from);
    let six_volumes = triangles.iter().map(|t| dot(p(t[0]), cross(p(t[1]), p(t[2]))));
    six_volumes.sum()
}

/// The sum of the normals of the adjacent triangles, weighted by area, normalised; over welded vertices.
pub(crate) fn smooth(vertices: &[[f32; 3]], triangles: &[[u32; 3]], welded: &[u32]) -> Vec<[f32; 3]> {
    let mut sums = vec![[0.0_f64; 3]; vertices.len()];
    for t in triangles {
        let [a, b, c] = t.map(|i| vertices[i as usize].map(f64::from));
        let normal = cross(sub(b, a), sub(c, a));
        for i in t {
            let sum = &mut sums[welded[*i as usize] as usize];
            (0..3).for_each(|k| sum[k] += normal[k]);
        }
    }
    welded.iter().map(|&w| unit(sums[w as usize])).collect()
}

/// Given normals at length one; where one is missing (zero or not finite) the smooth normal stands in.
pub(crate) fn normalised(
    normals: &[[f32; 3]],
    vertices: &[[f32; 3]],
    triangles: &[[u32; 3]],
    welded: &[u32],
) -> Vec<[f32; 3]> {
    let good = |n: &[f32; 3]| n.iter().all(|c| c.is_finite()) && n.iter().any(|c| c.abs() > 1e-12);
    if normals.iter().all(good) {
        return normals.iter().map(|n| unit(n.map(f64::from))).collect();
    }
    let smooth = smooth(vertices, triangles, welded);
    normals.iter().zip(smooth).map(|(n, s)| if good(n) { unit(n.map(f64::from)) } else { s }).collect()
}

fn unit(v: [f64; 3]) -> [f32; 3] {
    let length = dot(v, v).sqrt();
    if length > 0.0 { v.map(|c| (c / length) as f32) } else { [0.0, 0.0, 1.0] }
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
