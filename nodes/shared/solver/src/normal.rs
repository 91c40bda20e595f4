//! Linearised reprojection error under Tukey's loss: the sums that Levenberg-Marquardt and the covariance need.
//!
//! Tangent order: translation (x y z, m) first, rotation (x y z, rad) second, both in the camera's fixed axes, the
//! rotation about the *object's* origin: `t' = t + dt`, `R' = exp(dphi) R`. That is the order and the meaning of the
//! covariance in `geometry_msgs/PoseWithCovariance`, so that it needs no conversion.
//!
//! With q = R p, (X, Y, Z) = q + t and x = X / Z, y = Y / Z:
//! du/d(X, Y, Z) = a_u = fx / Z (1, 0, -x), dv/d(X, Y, Z) = a_v = fy / Z (0, 1, -y), and for either
//! dr/dt = a, dr/dphi = q x a.

use crate::lanes::{Doubles, with_avx2};
use crate::points::PointSet;
use nalgebra::{Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};
use pseudoflow_geometry::{Intrinsics, Pose};

/// Points of a block.
const LANES: usize = 8;

/// Points nearer to the camera plane than this are not seen, metres.
pub(crate) const Z_MIN_M: f64 = 1e-4;

/// `pose` moved by a tangent vector (order and meaning: see the module).
pub(crate) fn retract(pose: &Pose, tangent: &Vector6<f64>) -> Pose {
    let shift: Vector3<f64> = tangent.fixed_rows::<3>(0).into();
    let turn: Vector3<f64> = tangent.fixed_rows::<3>(3).into();
    let rotation = UnitQuaternion::from_scaled_axis(turn) * pose.rotation;
    // Renormalised, as products of unit quaternions drift.
    Pose::from_parts(
        Translation3::from(pose.translation.vector + shift),
        UnitQuaternion::new_normalize(rotation.into_inner()),
    )
}

/// A weighted least-squares problem around a pose: `hessian * step = -gradient`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NormalEquations {
    /// Sum of w J^T J.
    pub(crate) hessian: Matrix6<f64>,
    /// Sum of w J^T r.
    pub(crate) gradient: Vector6<f64>,
    /// Sum of `1 - (1 - r^2/c^2)^3` (Tukey's loss times 6 / c^2; 1 for an outlier).
    pub(crate) cost: f64,
    /// Sum of w.
    pub(crate) weight: f64,
}

/// The two matrices of the sandwich covariance `bread^-1 filling bread^-1` of an M-estimator.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sandwich {
    /// Sum of J^T (d psi / d r) J, `psi = w r`.
    pub(crate) bread: Matrix6<f64>,
    /// Sum of (J^T psi)(J^T psi)^T.
    pub(crate) filling: Matrix6<f64>,
}

/// Sums over all points; `width_px` is c of Tukey's loss.
pub(crate) fn accumulate(points: &PointSet, camera: &Intrinsics, pose: &Pose, width_px: f64) -> NormalEquations {
    with_avx2!(accumulate_lanes(points: &PointSet, camera: &Intrinsics, pose: &Pose, width_px: f64) -> NormalEquations)
}

/// Sandwich sums over all points.
pub(crate) fn sandwich(points: &PointSet, camera: &Intrinsics, pose: &Pose, width_px: f64) -> Sandwich {
    with_avx2!(sandwich_lanes(points: &PointSet, camera: &Intrinsics, pose: &Pose, width_px: f64) -> Sandwich)
}

/// Camera and pose, each number in all lanes.
struct PosedCamera {
    rotation: [[Doubles; 3]; 3],
    translation: [Doubles; 3],
    focal: [Doubles; 2],
    centre: [Doubles; 2],
    per_width2: Doubles,
}

/// Eight residuals and their derivatives.
struct Linear {
    /// Residuals, pixels: seen minus measured is negative of this, so `r = projected - measured`.
    residual: [Doubles; 2],
    /// Derivatives of u; the second is zero.
    du: [Doubles; 6],
    /// Derivatives of v; the first is zero.
    dv: [Doubles; 6],
    /// `max(0, 1 - r^2/c^2)`, zero behind the camera; the weight is its square.
    s: Doubles,
}

impl PosedCamera {
    #[inline(always)]
    fn new(camera: &Intrinsics, pose: &Pose, width_px: f64) -> Self {
        let s = Doubles::splat;
        let r = pose.rotation.to_rotation_matrix();
        Self {
            rotation: [0, 1, 2].map(|i| [s(r[(i, 0)]), s(r[(i, 1)]), s(r[(i, 2)])]),
            translation: [0, 1, 2].map(|i| s(pose.translation.vector[i])),
            focal: [s(camera.fx), s(camera.fy)],
            centre: [s(camera.cx), s(camera.cy)],
            per_width2: s(1.0 / (width_px * width_px)),
        }
    }

    #[inline(always)]
    fn linearise(&self, points: &PointSet, block: usize) -> Linear {
        let [x, y, z, u, v] = load(points, block);
        let (zero, one, z_min) = (Doubles::ZERO, Doubles::splat(1.0), Doubles::splat(Z_MIN_M));
        let mut q = self.rotation[0];
        for i in 0..3 {
            q[i] = self.rotation[i][0] * x + self.rotation[i][1] * y + self.rotation[i][2] * z;
        }
        let depth = q[2] + self.translation[2];
        let inverse = depth.max(z_min).recip();
        let (xn, yn) = ((q[0] + self.translation[0]) * inverse, (q[1] + self.translation[1]) * inverse);
        let ru = self.focal[0] * xn + self.centre[0] - u;
        let rv = self.focal[1] * yn + self.centre[1] - v;
        let s = (one - (ru * ru + rv * rv) * self.per_width2).max(zero).where_above(depth, z_min);
        let (au, av) = (self.focal[0] * inverse, self.focal[1] * inverse);
        let (bu, bv) = (zero - au * xn, zero - av * yn);
        Linear {
            residual: [ru, rv],
            du: [au, zero, bu, q[1] * bu, q[2] * au - q[0] * bu, zero - q[1] * au],
            dv: [zero, av, bv, q[1] * bv - q[2] * av, zero - q[0] * bv, q[0] * av],
            s,
        }
    }
}

/// The eight points of a block: x, y, z, u, v.
#[inline(always)]
fn load(points: &PointSet, block: usize) -> [Doubles; 5] {
    let mut out = [Doubles::ZERO; 5];
    let planes = [&points.x, &points.y, &points.z, &points.u, &points.v];
    for i in 0..5 {
        out[i] = Doubles::load(&planes[i].as_chunks().0[block]);
    }
    out
}

/// What [`accumulate`] compiles for the machine at hand.
#[inline(always)]
pub(crate) fn accumulate_lanes(points: &PointSet, camera: &Intrinsics, pose: &Pose, width_px: f64) -> NormalEquations {
    let view = PosedCamera::new(camera, pose, width_px);
    let one = Doubles::splat(1.0);
    let mut upper = [Doubles::ZERO; 21];
    let mut gradient = [Doubles::ZERO; 6];
    let (mut cost, mut weight) = (Doubles::ZERO, Doubles::ZERO);
    for block in 0..points.x.len() / LANES {
        let at = view.linearise(points, block);
        let w = at.s * at.s;
        cost += one - w * at.s;
        weight += w;
        let mut k = 0;
        for i in 0..6 {
            let (wu, wv) = (w * at.du[i], w * at.dv[i]);
            gradient[i] += wu * at.residual[0] + wv * at.residual[1];
            for j in i..6 {
                upper[k] += wu * at.du[j] + wv * at.dv[j];
                k += 1;
            }
        }
    }
    NormalEquations {
        hessian: symmetric(&upper),
        gradient: Vector6::from_fn(|i, _| gradient[i].sum()),
        cost: cost.sum(),
        weight: weight.sum(),
    }
}

#[inline(always)]
fn sandwich_lanes(points: &PointSet, camera: &Intrinsics, pose: &Pose, width_px: f64) -> Sandwich {
    let view = PosedCamera::new(camera, pose, width_px);
    let four_per_width2 = Doubles::splat(4.0) * view.per_width2;
    let (mut bread, mut filling) = ([Doubles::ZERO; 21], [Doubles::ZERO; 21]);
    for block in 0..points.x.len() / LANES {
        let at = view.linearise(points, block);
        let (w, bend) = (at.s * at.s, four_per_width2 * at.s);
        // d psi / d r = w 1 - (4 s / c^2) r r^T. Padding has huge residuals: they count only where s > 0.
        let ru = at.residual[0].where_above(at.s, Doubles::ZERO);
        let rv = at.residual[1].where_above(at.s, Doubles::ZERO);
        let mut pull = [Doubles::ZERO; 6];
        for i in 0..6 {
            pull[i] = at.du[i] * ru + at.dv[i] * rv;
        }
        let mut k = 0;
        for i in 0..6 {
            let (wu, wv, bent, squared) = (w * at.du[i], w * at.dv[i], bend * pull[i], w * w * pull[i]);
            for j in i..6 {
                bread[k] += wu * at.du[j] + wv * at.dv[j] - bent * pull[j];
                filling[k] += squared * pull[j];
                k += 1;
            }
        }
    }
    Sandwich { bread: symmetric(&bread), filling: symmetric(&filling) }
}

/// The symmetric matrix of an upper triangle, row by row, summed over the lanes.
fn symmetric(upper: &[Doubles; 21]) -> Matrix6<f64> {
    let mut out = Matrix6::zeros();
    let mut k = 0;
    for i in 0..6 {
        for j in i..6 {
            out[(i, j)] = upper[k].sum();
            out[(j, i)] = out[(i, j)];
            k += 1;
        }
    }
    out
}
