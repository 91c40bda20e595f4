//! Normals of what a depth image shows.

use pseudoflow_geometry::Intrinsics;

/// Unit normals of the surface seen in each pixel, camera axes, turned to the camera (n . ray < 0); zero where the depth
/// is 0. `depth_m` is row-major, `width` pixels in a row, seen by the camera `k` (K' for a crop).
///
/// Along each image axis the neighbour whose depth is nearer to the pixel's is taken, so that a normal does not mix the
/// two sides of a step in depth. Pixels without a neighbour face the camera. Rendering and run time share this function,
/// so a network sees the same normals in both.
#[must_use]
pub fn normals_from_depth(depth_m: &[f32], width: usize, k: &Intrinsics) -> Vec<[f32; 3]> {
    let height = depth_m.len() / width.max(1);
    let (inverse_fx, inverse_fy) = ((1.0 / k.fx) as f32, (1.0 / k.fy) as f32);
    let (cx, cy) = (k.cx as f32, k.cy as f32);
    let mut normals = vec![[0.0_f32; 3]; depth_m.len()];
    for (y, row) in normals.chunks_exact_mut(width).enumerate() {
        let above = (y > 0).then(|| &depth_m[(y - 1) * width..][..width]);
        let below = (y + 1 < height).then(|| &depth_m[(y + 1) * width..][..width]);
        let here = &depth_m[y * width..][..width];
        let ray_y = (y as f32 - cy) * inverse_fy;
        for (x, normal) in row.iter_mut().enumerate().filter(|(x, _)| here[*x] > 0.0) {
            let z = here[x];
            let ray_x = (x as f32 - cx) * inverse_fx;
            let left = x.checked_sub(1).map(|i| here[i]);
            let right = here.get(x + 1).copied();
            let (dz_dx, dz_dy) = (slope(z, left, right), slope(z, above.map(|r| r[x]), below.map(|r| r[x])));
            // The point is z (ray_x, ray_y, 1); its derivatives along the image axes span the surface.
            let along_x = [z * inverse_fx + ray_x * dz_dx, ray_y * dz_dx, dz_dx];
            let along_y = [ray_x * dz_dy, z * inverse_fy + ray_y * dz_dy, dz_dy];
            let n = [
                along_x[1] * along_y[2] - along_x[2] * along_y[1],
                along_x[2] * along_y[0] - along_x[0] * along_y[2],
                along_x[0] * along_y[1] - along_x[1] * along_y[0],
            ];
            let towards = n[0] * ray_x + n[1] * ray_y + n[2];
            let scale = -towards.signum() / (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt().max(1e-30);
            *normal = n.map(|c| c * scale);
        }
    }
    normals
}

/// Change of depth for a step of one pixel, from the neighbour whose depth is nearer.
fn slope(z: f32, before: Option<f32>, after: Option<f32>) -> f32 {
    let before = before.filter(|d| *d > 0.0).map(|d| z - d);
    let after = after.filter(|d| *d > 0.0).map(|d| d - z);
    match (before, after) {
        (Some(a), Some(b)) if a.abs() < b.abs() => a,
        (_, Some(b)) => b,
        (Some(a), None) => a,
        (None, None) => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slanted_plane_has_its_normal_everywhere_and_background_has_none() {
        let k = Intrinsics { fx: 100.0, fy: 110.0, cx: 15.5, cy: 14.0 };
        let n = [0.3_f32, -0.5, -(1.0_f32 - 0.34).sqrt()];
        // n . p = -0.8 with p = z ray.
        let depth = |i: usize| {
            let (x, y) = ((i % 32) as f32, (i / 32) as f32);
            if x < 3.0 { 0.0 } else { -0.8 / (n[0] * (x - 15.5) / 100.0 + n[1] * (y - 14.0) / 110.0 + n[2]) }
        };
        let depth_m: Vec<f32> = (0..32 * 30).map(depth).collect();
        for (i, found) in normals_from_depth(&depth_m, 32, &k).into_iter().enumerate() {
            if i % 32 < 3 {
                assert_eq!(found, [0.0; 3]);
            } else {
                // One-sided differences of z, which is not linear over the screen.
                (0..3).for_each(|c| assert!((found[c] - n[c]).abs() < 0.02, "{i}: {found:?}"));
            }
        }
    }

    #[test]
    fn a_step_in_depth_makes_no_normal_of_its_own() {
        let k = Intrinsics { fx: 100.0, fy: 100.0, cx: 7.5, cy: 7.5 };
        let depth_m: Vec<f32> = (0..16 * 16).map(|i| if i % 16 < 8 { 0.5 } else { 0.9 }).collect();
        assert!(normals_from_depth(&depth_m, 16, &k).iter().all(|n| n[2] < -0.999), "both sides face the camera");
    }
}
