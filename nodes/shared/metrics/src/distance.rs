//! Errors of a pose over the points of a model, in metres or pixels. `est` and `gt` are `camera_from_object`.
//! Sums run in a fixed order: the same input gives the same bits.

use crate::MatrixPose;
use crate::affine::Affine;
use crate::points::{Block, Bounds, LANES, ModelPoints};
use crate::simd::with_wide_vectors;
use pseudoflow_geometry::{Intrinsics, Pose};

/// ADD: mean distance of corresponding points, metres. Hinterstoisser et al., ACCV 2012, eq. 1 (there `m`);
/// bop_toolkit `pose_error.add`.
#[must_use]
pub fn add_m(points: &ModelPoints, est: &MatrixPose, gt: &MatrixPose) -> f64 {
    sum_of_norms(points, &Affine::difference(est, gt)) / points.count() as f64
}

/// ADI, also called ADD-S: mean distance from each point in the true pose to the nearest point in the estimated pose,
/// metres. Hinterstoisser et al., ACCV 2012, eq. 2; bop_toolkit `pose_error.adi`.
#[must_use]
pub fn adi_m(points: &ModelPoints, est: &MatrixPose, gt: &MatrixPose) -> f64 {
    let est_from_gt = Affine::relative(est, gt);
    let sum = match est.stretch() {
        None => sum_of_nearest(points, points, &est_from_gt),
        Some(stretch) => sum_of_nearest(points, &points.stretched(&stretch), &est_from_gt),
    };
    sum / points.count() as f64
}

/// MSSD: the largest distance of corresponding points, least over the symmetries, metres. Hodan et al., "BOP
/// Challenge 2020 on 6D Object Localization", ECCVW 2020, eq. 3; bop_toolkit `pose_error.mssd`.
///
/// `symmetries` are `object_from_object` transforms with the identity among them (`Symmetries::transforms(0.01)`).
#[must_use]
pub fn mssd_m(points: &ModelPoints, est: &MatrixPose, gt: &MatrixPose, symmetries: &[Pose]) -> f64 {
    let mut best = f32::INFINITY;
    for symmetry in symmetries {
        best = max_norm_squared(points, &Affine::difference(est, &gt.after(symmetry)), best);
    }
    f64::from(best).sqrt()
}

/// MSPD: the largest distance of projections of corresponding points, least over the symmetries, pixels of the
/// image. Hodan et al., ECCVW 2020, eq. 4; bop_toolkit `pose_error.mspd`. Its thresholds are for images 640 wide:
/// multiply with [`mspd_scale`]. A point in the camera plane makes it infinite.
#[must_use]
pub fn mspd_px(
    points: &ModelPoints,
    est: &MatrixPose,
    gt: &MatrixPose,
    intrinsics: &Intrinsics,
    symmetries: &[Pose],
) -> f64 {
    let mut best = f32::INFINITY;
    for symmetry in symmetries {
        let gt = gt.after(symmetry);
        best = max_projected_squared(points, &Projected::new(est, &gt, intrinsics), best);
    }
    f64::from(best).sqrt()
}

/// What MSPD is multiplied with before it is compared to thresholds: `640 / image width` (BOP Challenge 2019, where
/// the thresholds are 5 r to 50 r with r = width / 640).
#[must_use]
pub fn mspd_scale(image_width_px: u32) -> f64 {
    640.0 / f64::from(image_width_px)
}

/// Mean distance of the projections of corresponding points, pixels. Brachmann et al., CVPR 2016; bop_toolkit
/// `pose_error.proj`.
#[must_use]
pub fn projection_px(points: &ModelPoints, est: &MatrixPose, gt: &MatrixPose, intrinsics: &Intrinsics) -> f64 {
    sum_projected(points, &Projected::new(est, gt, intrinsics)) / points.count() as f64
}

/// Rotation error: the angle of the rotation between two poses, radians in `[0, pi]`. bop_toolkit `pose_error.re`, but
/// for the nearest rotations (of other matrices the toolkit's arc cosine is off by degrees).
#[must_use]
pub fn rotation_error_rad(est: &MatrixPose, gt: &MatrixPose) -> f64 {
    pseudoflow_geometry::rotation_angle_rad(&est.pose(), &gt.pose())
}

/// Translation error, metres. bop_toolkit `pose_error.te`.
#[must_use]
pub fn translation_error_m(est: &MatrixPose, gt: &MatrixPose) -> f64 {
    (est.translation_m() - gt.translation_m()).norm()
}

/// Whether a pose is right to 5 cm and 5 degrees (Shotton et al., CVPR 2013), for the nearest symmetric truth.
#[must_use]
pub fn within_5cm_5deg(est: &MatrixPose, gt: &MatrixPose, symmetries: &[Pose]) -> bool {
    symmetries
        .iter()
        .map(|s| gt.after(s))
        .any(|gt| translation_error_m(est, &gt) < 0.05 && rotation_error_rad(est, &gt) < 5_f64.to_radians())
}

/// The truth, turned by the symmetry that brings its rotation nearest to the estimate.
#[must_use]
pub fn nearest_symmetric(est: &MatrixPose, gt: &MatrixPose, symmetries: &[Pose]) -> MatrixPose {
    let turned = symmetries.iter().map(|s| gt.after(s));
    turned.min_by(|a, b| rotation_error_rad(est, a).total_cmp(&rotation_error_rad(est, b))).unwrap_or(*gt)
}

/// Blocks whose sums are kept in single precision before they are added in double.
const CHUNK: usize = 32;

#[inline(always)]
fn norms_squared(v: &Block) -> [f32; LANES] {
    let mut out = [0.0; LANES];
    for l in 0..LANES {
        out[l] = v.x[l] * v.x[l] + v.y[l] * v.y[l] + v.z[l] * v.z[l];
    }
    out
}

/// Adds per-point values over all points; `value` gives those of one block.
#[inline(always)]
fn sum_over_points(points: &ModelPoints, value: impl Fn(usize, &Block) -> [f32; LANES]) -> f64 {
    let mut total = 0.0;
    let whole = points.count() / LANES;
    for start in (0..whole).step_by(CHUNK) {
        let mut lanes = [0.0_f32; LANES];
        for k in start..(start + CHUNK).min(whole) {
            let values = value(k, &points.blocks[k]);
            for l in 0..LANES {
                lanes[l] += values[l];
            }
        }
        total += lanes.iter().map(|v| f64::from(*v)).sum::<f64>();
    }
    if whole < points.blocks.len() {
        let values = value(whole, &points.blocks[whole]);
        total += values[..points.lanes_of(whole)].iter().map(|v| f64::from(*v)).sum::<f64>();
    }
    total
}

/// The largest value over all points, given up (with what is found by then) once it reaches `limit`.
#[inline(always)]
fn max_over_points(points: &ModelPoints, limit: f32, value: impl Fn(&Block) -> [f32; LANES]) -> f32 {
    let mut lanes = [0.0_f32; LANES];
    for group in points.coarse_order.chunks(8) {
        for k in group {
            let values = value(&points.blocks[*k as usize]);
            for l in 0..LANES {
                lanes[l] = if values[l] > lanes[l] { values[l] } else { lanes[l] };
            }
        }
        if lanes.iter().any(|v| *v >= limit) {
            break;
        }
    }
    lanes.into_iter().fold(0.0, f32::max)
}

with_wide_vectors! {
    fn sum_of_norms(points: &ModelPoints, difference: &Affine) -> f64 {
        sum_over_points(points, |_, block| norms_squared(&difference.apply(block)).map(f32::sqrt))
    }
}

with_wide_vectors! {
    /// The largest squared length, or `limit` where it is not less.
    fn max_norm_squared(points: &ModelPoints, difference: &Affine, limit: f32) -> f32 {
        max_over_points(points, limit, |block| norms_squared(&difference.apply(block))).min(limit)
    }
}

/// What the distance between two projections of a point needs: the point in the true pose and its difference, both
/// with focal lengths multiplied in.
struct Projected {
    gt: Affine,
    difference: Affine,
    focal_squared: [f32; 2],
}

impl Projected {
    fn new(est: &MatrixPose, gt: &MatrixPose, intrinsics: &Intrinsics) -> Self {
        Self {
            gt: Affine::of(gt),
            difference: Affine::difference(est, gt),
            focal_squared: [intrinsics.fx, intrinsics.fy].map(|f| (f * f) as f32),
        }
    }

    /// Squared pixel distances. With `p' = p + d`, `x'/z' - x/z = (dx - x dz / z) / z'` has no cancellation.
    #[inline(always)]
    fn squared(&self, block: &Block) -> [f32; LANES] {
        let (p, d) = (self.gt.apply(block), self.difference.apply(block));
        let [fx2, fy2] = self.focal_squared;
        let mut out = [0.0; LANES];
        for l in 0..LANES {
            let slope = d.z[l] / p.z[l];
            let z = p.z[l] + d.z[l];
            let (u, v) = ((d.x[l] - p.x[l] * slope) / z, (d.y[l] - p.y[l] * slope) / z);
            let squared = u * u * fx2 + v * v * fy2;
            out[l] = if squared.is_nan() { f32::INFINITY } else { squared };
        }
        out
    }
}

with_wide_vectors! {
    fn max_projected_squared(points: &ModelPoints, projected: &Projected, limit: f32) -> f32 {
        max_over_points(points, limit, |block| projected.squared(block)).min(limit)
    }
}

with_wide_vectors! {
    fn sum_projected(points: &ModelPoints, projected: &Projected) -> f64 {
        sum_over_points(points, |_, block| projected.squared(block).map(f32::sqrt))
    }
}

with_wide_vectors! {
    /// Sum over the points of the distance from the moved point to the nearest of `targets`.
    fn sum_of_nearest(points: &ModelPoints, targets: &ModelPoints, est_from_gt: &Affine) -> f64 {
        sum_over_points(points, |k, block| nearest_squared(targets, k, &est_from_gt.apply(block)).map(f32::sqrt))
    }
}

/// Squared distances from 16 neighbouring points to the nearest points of the model. One walk down the tree serves
/// all 16: a box is skipped when no point is nearer to it than to its own nearest point so far. `hint` is a leaf that
/// is likely near.
#[inline(always)]
fn nearest_squared(points: &ModelPoints, hint: usize, queries: &Block) -> [f32; LANES] {
    let mut best = [f32::INFINITY; LANES];
    visit_leaf(&points.blocks[hint], queries, &mut best);
    let centre = [&queries.x, &queries.y, &queries.z].map(|c| c.iter().sum::<f32>() / LANES as f32);
    let mut stack = [1_usize; usize::BITS as usize];
    let mut depth = 1;
    while depth > 0 {
        depth -= 1;
        let node = stack[depth];
        if !any_nearer(&points.nodes[node], queries, &best) {
            continue;
        }
        if node >= points.leaves {
            if node - points.leaves != hint {
                visit_leaf(&points.blocks[node - points.leaves], queries, &mut best);
            }
            continue;
        }
        let [left, right] = [2 * node, 2 * node + 1];
        let right_first = points.nodes[right].distance_squared(centre) < points.nodes[left].distance_squared(centre);
        stack[depth] = if right_first { left } else { right };
        stack[depth + 1] = if right_first { right } else { left };
        depth += 2;
    }
    best
}

/// Whether a box is nearer to any of the points than the best of that point.
#[inline(always)]
fn any_nearer(bounds: &Bounds, queries: &Block, best: &[f32; LANES]) -> bool {
    let ([lx, ly, lz], [hx, hy, hz]) = (bounds.low, bounds.high);
    let mut nearer = [0_i32; LANES];
    for l in 0..LANES {
        let (x, y, z) = (queries.x[l], queries.y[l], queries.z[l]);
        let (dx, dy, dz) = (outside(x, lx, hx), outside(y, ly, hy), outside(z, lz, hz));
        nearer[l] = i32::from(dx * dx + dy * dy + dz * dz < best[l]);
    }
    nearer.into_iter().fold(0, |a, b| a | b) != 0
}

/// How far a coordinate is outside of an interval.
#[inline(always)]
fn outside(v: f32, low: f32, high: f32) -> f32 {
    let (below, above) = (low - v, v - high);
    let gap = if below > above { below } else { above };
    if gap > 0.0 { gap } else { 0.0 }
}

#[inline(always)]
fn visit_leaf(leaf: &Block, queries: &Block, best: &mut [f32; LANES]) {
    for j in 0..LANES {
        let (x, y, z) = (leaf.x[j], leaf.y[j], leaf.z[j]);
        for l in 0..LANES {
            let (dx, dy, dz) = (queries.x[l] - x, queries.y[l] - y, queries.z[l] - z);
            let squared = dx * dx + dy * dy + dz * dz;
            best[l] = if squared < best[l] { squared } else { best[l] };
        }
    }
}

#[cfg(test)]
mod tests;
