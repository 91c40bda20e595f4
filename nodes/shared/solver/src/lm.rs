use crate::normal::{NormalEquations, accumulate, retract};
use crate::points::PointSet;
use nalgebra::{Matrix6, Vector6};
use pseudoflow_geometry::{Intrinsics, Pose};

/// When Levenberg-Marquardt stops.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    /// Passes over the points, at most.
    pub(crate) passes: usize,
    /// A step that moves the projections by less than this (weighted root mean square) is the last, pixels.
    pub(crate) step_px: f64,
}

/// Minimises Tukey's loss of the reprojection error from `start` by iteratively reweighted Levenberg-Marquardt
/// (damping relative to the diagonal). The cost never rises; no point in reach leaves the pose as it is.
pub(crate) fn refine(points: &PointSet, camera: &Intrinsics, start: &Pose, width_px: f64, limits: Limits) -> Pose {
    let mut pose = *start;
    let mut at = accumulate(points, camera, &pose, width_px);
    let mut damping = 1e-6;
    for _ in 1..limits.passes {
        let Some(step) = damped_step(&at, damping) else { break };
        let moved_px = (step.dot(&(at.hessian * step)) / at.weight.max(1e-12)).max(0.0).sqrt();
        let trial = retract(&pose, &step);
        let there = accumulate(points, camera, &trial, width_px);
        if there.cost < at.cost {
            (pose, at) = (trial, there);
            damping = (damping * 0.1).max(1e-9);
        } else {
            damping *= 100.0;
        }
        if moved_px < limits.step_px || damping > 1e6 {
            break;
        }
    }
    pose
}

/// Solves `(H + damping diag H) step = -g`; `None` when H is not positive definite or not finite.
fn damped_step(at: &NormalEquations, damping: f64) -> Option<Vector6<f64>> {
    let diagonal = at.hessian.diagonal();
    if !diagonal.iter().all(|d| *d > 0.0 && d.is_finite()) {
        return None;
    }
    let damped = at.hessian + Matrix6::from_diagonal(&(diagonal * damping));
    let step = -damped.cholesky()?.solve(&at.gradient);
    step.iter().all(|v| v.is_finite()).then_some(step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{CAMERA, Scene, point_set};
    use nalgebra::Point3;

    /// Residuals of one point at a pose, pixels.
    fn residual(pose: &Pose, p: &Point3<f64>, pixel: [f64; 2]) -> [f64; 2] {
        let seen = CAMERA.project(&(pose * p)).unwrap();
        [seen.x - pixel[0], seen.y - pixel[1]]
    }

    #[test]
    fn the_jacobian_is_the_finite_difference() {
        let scene = Scene::solid(1, 7);
        let pose = scene.pose;
        let (p, pixel) = (Point3::new(0.03, -0.05, 0.02).cast::<f32>(), [140.0_f32, 121.0]);
        let points = point_set(&[[p.x, p.y, p.z]], &[pixel]);
        // So wide a loss that every weight is 1: H = J^T J and g = J^T r of this one point.
        let at = accumulate(&points, &CAMERA, &pose, 1e9);
        let (p, pixel) = (p.cast::<f64>(), pixel.map(f64::from));
        let r = residual(&pose, &p, pixel);
        let step = 1e-6;
        let jacobian = nalgebra::Matrix2x6::<f64>::from_fn(|row, column| {
            let mut tangent = Vector6::zeros();
            tangent[column] = step;
            let (ahead, behind) = (retract(&pose, &tangent), retract(&pose, &-tangent));
            (residual(&ahead, &p, pixel)[row] - residual(&behind, &p, pixel)[row]) / (2.0 * step)
        });
        let expected = jacobian.transpose() * jacobian;
        assert!((at.hessian - expected).amax() < 1e-6 * expected.amax(), "{} {expected}", at.hessian);
        let gradient = jacobian.transpose() * nalgebra::Vector2::from(r);
        assert!((at.gradient - gradient).amax() < 1e-6 * gradient.amax());
    }

    #[test]
    fn the_gradient_is_that_of_the_cost() {
        let scene = Scene::solid(400, 3).noisy(1.0).with_outliers(0.3);
        let points = point_set(&scene.points, &scene.pixels);
        let (width, step) = (4.0, 1e-6);
        let at = accumulate(&points, &CAMERA, &scene.pose, width);
        for k in 0..6 {
            let mut tangent = Vector6::zeros();
            tangent[k] = step;
            let cost = |t: &Vector6<f64>| accumulate(&points, &CAMERA, &retract(&scene.pose, t), width).cost;
            let slope = (cost(&tangent) - cost(&-tangent)) / (2.0 * step);
            // cost = 1 - s^3, ds/dr^2 = -1/c^2: d cost = (6 / c^2) w r dr.
            let expected = 6.0 / (width * width) * at.gradient[k];
            assert!((slope - expected).abs() < 1e-4 * (1.0 + expected.abs()), "{k}: {slope} {expected}");
        }
    }

    #[test]
    fn vector_instructions_do_not_change_a_bit() {
        // On a machine with AVX2 the two are different code; elsewhere this holds trivially.
        let scene = Scene::solid(1003, 3).noisy(1.0).with_outliers(0.3);
        let points = point_set(&scene.points, &scene.pixels);
        let bits = |at: NormalEquations| {
            let sums = at.hessian.iter().chain(at.gradient.iter()).chain([&at.cost, &at.weight]);
            sums.map(|v| v.to_bits()).collect::<Vec<_>>()
        };
        let plain = crate::normal::accumulate_lanes(&points, &CAMERA, &scene.pose, 4.0);
        assert_eq!(bits(accumulate(&points, &CAMERA, &scene.pose, 4.0)), bits(plain));
    }

    #[test]
    fn exact_data_are_solved_exactly() {
        let scene = Scene::solid(200, 5);
        let points = point_set(&scene.points, &scene.pixels);
        let start = retract(&scene.pose, &Vector6::new(0.004, -0.003, 0.01, 0.05, -0.04, 0.06));
        let limits = Limits { passes: 30, step_px: 1e-9 };
        let found = refine(&points, &CAMERA, &start, 60.0, limits);
        assert!((found.translation.vector - scene.pose.translation.vector).norm() < 1e-6);
        assert!(found.rotation.angle_to(&scene.pose.rotation) < 1e-5);
    }

    #[test]
    fn with_no_point_in_reach_the_pose_stays() {
        let scene = Scene::solid(50, 5);
        let points = point_set(&scene.points, &vec![[9e4; 2]; 50]);
        let limits = Limits { passes: 30, step_px: 1e-9 };
        assert_eq!(refine(&points, &CAMERA, &scene.pose, 3.0, limits), scene.pose);
    }
}
