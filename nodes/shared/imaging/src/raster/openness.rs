//! How much of its surroundings a surface sees: ambient occlusion of a mesh by itself.

use super::{Background, Item, Scene, Scratch};
use crate::Mesh;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use pseudoflow_geometry::{Intrinsics, Pose};

/// For each vertex the cosine-weighted share of `directions` directions, spread evenly over the sphere, in which nothing of the
/// mesh hides the surroundings, of 255. A depth map of `SIDE` squared is drawn from each direction; what lies
/// within 3 % of the radius before a vertex counts as its own surface.
#[must_use]
pub fn openness(mesh: &Mesh, directions: usize) -> Vec<u8> {
    let (low, high) = mesh.bounds_m();
    let (centre, radius_m) = (nalgebra::center(&low, &high), 0.5 * (high - low).norm().max(1e-6));
    let (mut seen, mut total) = (vec![0.0_f32; mesh.vertices_m.len()], vec![1e-6_f32; mesh.vertices_m.len()]);
    let mut scratch = Scratch::default();
    let half = SIDE as f64 / 2.0;
    let focal = half * DISTANCE / 1.05;
    let intrinsics = Intrinsics { fx: focal, fy: focal, cx: half - 0.5, cy: half - 0.5 };
    let bias_m = (0.03 * radius_m) as f32;
    for i in 0..directions {
        let z = 1.0 - (2.0 * i as f64 + 1.0) / directions as f64;
        let (sin, cos) = (2.399_963_229_728_653 * i as f64).sin_cos();
        let outward = Vector3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z);
        let helper = if outward.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
        let rotation = UnitQuaternion::face_towards(&-outward, &helper).inverse();
        let eye = centre.coords + outward * DISTANCE * radius_m;
        let pose = Pose::from_parts(Translation3::from(-(rotation * eye)), rotation);
        let item = Item { mesh, camera_from_object: pose };
        let (size, background) = (SIDE as u32, Background::Colour([0; 3]));
        scratch.cover(&Scene { items: &[item], intrinsics, width: size, height: size, background });
        let (outward, view) = (outward.cast::<f32>(), pose.cast::<f32>());
        for (vertex, (position, normal)) in mesh.vertices_m.iter().zip(&mesh.normals).enumerate() {
            let facing = outward.dot(&Vector3::from(*normal));
            if facing <= 0.05 {
                continue;
            }
            let p = view * nalgebra::Point3::from(*position);
            let at = |v: f32| ((focal as f32 * v / p.z + half as f32) as usize).min(SIDE - 1);
            let nearest = scratch.inverse_depths()[at(p.y) * SIDE + at(p.x)];
            total[vertex] += facing;
            seen[vertex] += if nearest <= 1.0 / (p.z - bias_m) { facing } else { 0.0 };
        }
    }
    // Vertices that no direction faces are left open.
    seen.iter().zip(&total).map(|(s, t)| if *t < 1e-3 { 255 } else { (255.0 * s / t + 0.5) as u8 }).collect()
}

/// Side of the depth maps, pixels.
const SIDE: usize = 96;
/// From where they are drawn, radii.
const DISTANCE: f64 = 20.0;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MeshParts;
    use std::path::Path;

    /// A cube of half side 1, and another one on top of it that stands on its middle.
    fn stack() -> Mesh {
        let corner = |i: usize, scale: f32, z: f32| {
            let sign = |bit: usize| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
            [scale * sign(0), scale * sign(1), z + scale * sign(2)]
        };
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let mut parts = MeshParts::default();
        for (scale, z) in [(1.0, 0.0), (0.5, 1.5)] {
            for quad in quads {
                let first = parts.vertices_m.len() as u32;
                parts.vertices_m.extend(quad.map(|i| corner(i, scale, z)));
                parts.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
            }
        }
        let normal = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| Vector3::from(parts.vertices_m[i as usize]));
            (b - a).cross(&(c - a)).normalize().into()
        };
        parts.normals = parts.triangles.chunks(2).flat_map(|pair| [normal(&pair[0]); 4]).collect();
        Mesh::new(parts, Path::new("(stack)")).unwrap()
    }

    #[test]
    fn corners_in_the_open_see_all_and_hollows_less() {
        let mesh = stack();
        let open = openness(&mesh, 96);
        let at = |i: usize| (mesh.vertices_m[i], mesh.normals[i], open[i]);
        for (position, normal, open) in (0..48).map(at) {
            let upper_side = position[2] == 1.0 && position[0].abs() < 0.6 && normal[2] == 0.0;
            match (upper_side, position[2]) {
                // The foot of the upper cube's sides looks onto the lower cube's top.
                (true, _) => assert!((90..220).contains(&open), "{position:?} {normal:?} {open}"),
                (_, z) if z < 0.0 => assert!(open > 245, "{position:?} {normal:?} {open}"),
                _ => {}
            }
        }
    }
}
