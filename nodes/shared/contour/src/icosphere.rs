//! Directions spread evenly over the sphere.

use std::collections::BTreeMap;

/// The corners of an icosahedron whose faces are divided in four `divisions` times: 12, 42, 162, 642, 2562 unit vectors.
pub(crate) fn directions(divisions: u32) -> Vec<[f32; 3]> {
    let (mut corners, mut faces) = icosahedron();
    for _ in 0..divisions {
        let mut middles = BTreeMap::new();
        let mut divided = Vec::with_capacity(4 * faces.len());
        for [a, b, c] in faces {
            let mut middle = |i: usize, j: usize| {
                *middles.entry((i.min(j), i.max(j))).or_insert_with(|| {
                    corners.push(unit(std::array::from_fn(|k| corners[i][k] + corners[j][k])));
                    corners.len() - 1
                })
            };
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            divided.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
        }
        faces = divided;
    }
    corners.into_iter().map(|c| c.map(|v| v as f32)).collect()
}

fn icosahedron() -> (Vec<[f64; 3]>, Vec<[usize; 3]>) {
    let golden = (1.0 + 5.0_f64.sqrt()) / 2.0;
    let mut corners = Vec::with_capacity(12);
    for (i, j, k) in [(0, 1, 2), (1, 2, 0), (2, 0, 1)] {
        for (a, b) in [(1.0, golden), (1.0, -golden), (-1.0, golden), (-1.0, -golden)] {
            let mut corner = [0.0; 3];
            (corner[i], corner[j], corner[k]) = (0.0, a, b);
            corners.push(unit(corner));
        }
    }
    // Neighbours are 63.4 degrees apart, all others further.
    let near = |a: usize, b: usize| (0..3).map(|k| corners[a][k] * corners[b][k]).sum::<f64>() > 0.4;
    let mut faces = Vec::with_capacity(20);
    for a in 0..12 {
        for b in a + 1..12 {
            faces.extend((b + 1..12).filter(|&c| near(a, b) && near(b, c) && near(a, c)).map(|c| [a, b, c]));
        }
    }
    (corners, faces)
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = v.iter().map(|c| c * c).sum::<f64>().sqrt();
    v.map(|c| c / length)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_direction_has_a_near_neighbour() {
        let all = directions(3);
        assert_eq!(all.len(), 642);
        let dot = |a: &[f32; 3], b: &[f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let probes = directions(4);
        assert_eq!(probes.len(), 2562);
        for probe in &probes {
            assert!((dot(probe, probe) - 1.0).abs() < 1e-5);
            let nearest = all.iter().map(|d| dot(d, probe)).fold(-1.0, f32::max);
            assert!(nearest > 5.3_f32.to_radians().cos(), "{nearest}");
        }
    }
}
