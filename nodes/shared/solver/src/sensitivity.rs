//! How the pose that least squares find depends on the pixels that they find it from: the gradient that a training needs to be
//! judged by its poses.
//!
//! The pose `T` with `g(T, pixels) = sum w J^T r = 0` moves by `dT = H^-1 sum w J^T dpixels` (implicit differentiation, weights and
//! J held, `H = sum w J^T J`), so that a loss `L(T)` has the slope `w J H^-1 dL/dT` by each pixel. The tangent is that of the other
//! solvers ([`retract`]), with the middle of the points as the object's origin.

use crate::normal::retract;
use nalgebra::{Matrix2x6, Matrix6, Point3, Translation3, Vector2, Vector3, Vector6};
use pseudoflow_geometry::{Intrinsics, Pose};

/// Surface points, the pixels that are said to show them, and the truth.
#[derive(Debug, Clone, Copy)]
pub struct PosedPixels<'a> {
    /// Surface points, metres, in any frame.
    pub points_m: &'a [Point3<f64>],
    /// Where they are said to be seen, pixels.
    pub pixels: &'a [[f64; 2]],
    /// Intrinsics of these pixels.
    pub camera: Intrinsics,
    /// From the points' frame to the camera's.
    pub truth: Pose,
    /// The object's diameter, metres.
    pub diameter_m: f64,
    /// Half weight of a residual of this length (Cauchy's loss), pixels.
    pub width_px: f64,
}

/// A pose's error and its slope.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseErrorSlope {
    /// ADD of the pose that the pixels say, diameters.
    pub add_of_diameter: f64,
    /// Its gradient by each pixel, diameters per pixel.
    pub by_pixel: Vec<[f64; 2]>,
}

/// Gauss-Newton steps from the truth: pixels of a training are near it, or say nothing that could be learnt from.
const STEPS: usize = 6;
/// Of the Hessian's diagonal, in the steps.
const DAMPING: f64 = 1e-6;
/// The same in the slope: directions that the points hardly determine (a turn of few points, say) must not dominate a training.
const SLOPE_DAMPING: f64 = 1e-2;
/// A step moves the object by at most this many diameters.
const LONGEST_STEP: f64 = 0.3;
/// Fewer points determine no pose.
const MIN_POINTS: usize = 12;

/// The error (ADD) of the pose that the pixels say under Cauchy's loss, and its gradient by the pixels; `None` where they say no
/// pose.
#[must_use]
pub fn pose_error_slope(of: &PosedPixels<'_>) -> Option<PoseErrorSlope> {
    if of.points_m.len() < MIN_POINTS || of.points_m.len() != of.pixels.len() {
        return None;
    }
    // A turn about the middle of the points: about a far origin it would look like a shift.
    let middle = of.points_m.iter().fold(Vector3::zeros(), |sum, p| sum + p.coords) / of.points_m.len() as f64;
    let points_m: Vec<Point3<f64>> = of.points_m.iter().map(|p| p - middle).collect();
    let of = PosedPixels { points_m: &points_m, truth: of.truth * Translation3::from(middle), ..*of };
    let mut pose = of.truth;
    for _ in 0..STEPS {
        let step = of.step(&pose)?;
        pose = retract(&pose, &step);
    }
    let (hessian, _) = of.normal_equations(&pose)?;
    let (add_m, by_pose) = of.add(&pose);
    let pull = damped(&hessian, SLOPE_DAMPING).cholesky()?.solve(&by_pose) / of.diameter_m;
    let slope = |(point, pixel): (&Point3<f64>, &[f64; 2])| {
        let (jacobian, _, weight) = of.linearised(&pose, point, pixel)?;
        Some((weight * jacobian * pull).into())
    };
    let by_pixel: Vec<[f64; 2]> = of.points_m.iter().zip(of.pixels).map(slope).collect::<Option<_>>()?;
    let found = PoseErrorSlope { add_of_diameter: add_m / of.diameter_m, by_pixel };
    (found.add_of_diameter.is_finite() && found.by_pixel.iter().flatten().all(|v| v.is_finite())).then_some(found)
}

fn damped(hessian: &Matrix6<f64>, share: f64) -> Matrix6<f64> {
    hessian + Matrix6::from_diagonal(&(hessian.diagonal() * share))
}

impl PosedPixels<'_> {
    /// J, residual and weight of one point; `None` behind the camera.
    fn linearised(
        &self,
        pose: &Pose,
        point: &Point3<f64>,
        pixel: &[f64; 2],
    ) -> Option<(Matrix2x6<f64>, Vector2<f64>, f64)> {
        let p = pose * point;
        let seen = self.camera.project(&p)?;
        let residual = Vector2::new(seen.x - pixel[0], seen.y - pixel[1]);
        let arm = pose.rotation * point.coords;
        let row = |focal: f64, axis: Vector3<f64>, coordinate: f64| {
            let by_point = (axis - Vector3::z() * (coordinate / p.z)) * (focal / p.z);
            let by_turn = arm.cross(&by_point);
            [by_point.x, by_point.y, by_point.z, by_turn.x, by_turn.y, by_turn.z]
        };
        let rows = [row(self.camera.fx, Vector3::x(), p.x), row(self.camera.fy, Vector3::y(), p.y)];
        let jacobian = Matrix2x6::from_fn(|r, c| rows[r][c]);
        let weight = 1.0 / (1.0 + residual.norm_squared() / (self.width_px * self.width_px));
        Some((jacobian, residual, weight))
    }

    fn normal_equations(&self, pose: &Pose) -> Option<(Matrix6<f64>, Vector6<f64>)> {
        let mut sums = (Matrix6::zeros(), Vector6::zeros());
        for (point, pixel) in self.points_m.iter().zip(self.pixels) {
            let (jacobian, residual, weight) = self.linearised(pose, point, pixel)?;
            sums.0 += weight * jacobian.transpose() * jacobian;
            sums.1 += weight * jacobian.transpose() * residual;
        }
        Some(sums)
    }

    fn step(&self, pose: &Pose) -> Option<Vector6<f64>> {
        let (hessian, gradient) = self.normal_equations(pose)?;
        let step = -damped(&hessian, DAMPING).cholesky()?.solve(&gradient);
        let length = step.fixed_rows::<3>(0).norm() / self.diameter_m + 0.5 * step.fixed_rows::<3>(3).norm();
        step.iter().all(|v| v.is_finite()).then(|| step * (LONGEST_STEP / length.max(LONGEST_STEP)))
    }

    /// Mean distance of the points from where they truly are, metres, and its gradient by the tangent.
    fn add(&self, pose: &Pose) -> (f64, Vector6<f64>) {
        let (mut sum, mut gradient) = (0.0, Vector6::zeros());
        for point in self.points_m {
            let off = pose * point - self.truth * point;
            let Some(towards) = off.try_normalize(1e-9) else { continue };
            let by_turn = (pose.rotation * point.coords).cross(&towards);
            sum += off.norm();
            gradient += Vector6::new(towards.x, towards.y, towards.z, by_turn.x, by_turn.y, by_turn.z);
        }
        let n = self.points_m.len() as f64;
        (sum / n, gradient / n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{CAMERA, Scene};

    struct Case {
        points_m: Vec<Point3<f64>>,
        pixels: Vec<[f64; 2]>,
        truth: Pose,
    }

    fn case(noise_px: f64) -> Case {
        let scene = Scene::solid(60, 3).noisy(noise_px);
        Case {
            points_m: scene.points.iter().map(|p| Point3::from(*p).cast()).collect(),
            pixels: scene.pixels.iter().map(|p| p.map(f64::from)).collect(),
            truth: scene.pose,
        }
    }

    impl Case {
        fn of(&self, width_px: f64) -> PosedPixels<'_> {
            let Self { points_m, pixels, truth } = self;
            PosedPixels { points_m, pixels, camera: CAMERA, truth: *truth, diameter_m: 0.2, width_px }
        }
    }

    #[test]
    fn the_slope_is_the_finite_difference() {
        // So wide a loss that weights do not change with the pixels, and few enough pixels off that J hardly does.
        let mut case = case(0.5);
        let found = pose_error_slope(&case.of(1e6)).unwrap();
        assert!(found.add_of_diameter > 1e-4);
        let step = 1e-3;
        for (i, axis) in [(0, 0), (7, 1), (23, 0), (59, 1)] {
            let at = case.pixels[i][axis];
            let error = |case: &mut Case, value: f64| {
                case.pixels[i][axis] = value;
                pose_error_slope(&case.of(1e6)).unwrap().add_of_diameter
            };
            let difference = (error(&mut case, at + step) - error(&mut case, at - step)) / (2.0 * step);
            case.pixels[i][axis] = at;
            // The slope's damping of a hundredth is part of it.
            let largest = found.by_pixel.iter().flatten().fold(0.0_f64, |m, v| m.max(v.abs()));
            assert!((found.by_pixel[i][axis] - difference).abs() < 0.05 * largest, "{i} {axis}: {difference}");
        }
    }

    #[test]
    fn contracted_pixels_say_too_far_and_the_slope_stretches_them() {
        let mut case = case(0.0);
        let middle = case.pixels.iter().fold([0.0; 2], |m, p| [m[0] + p[0] / 60.0, m[1] + p[1] / 60.0]);
        for pixel in &mut case.pixels {
            *pixel = [0, 1].map(|k| middle[k] + 0.97 * (pixel[k] - middle[k]));
        }
        let found = pose_error_slope(&case.of(3.0)).unwrap();
        // 3 % of 0.8 m by 0.2 m.
        assert!((found.add_of_diameter - 0.12).abs() < 0.02, "{}", found.add_of_diameter);
        // Downhill is outwards.
        let outwards = case.pixels.iter().zip(&found.by_pixel);
        let sum: f64 = outwards.map(|(p, s)| -(s[0] * (p[0] - middle[0]) + s[1] * (p[1] - middle[1]))).sum();
        assert!(sum > 0.0);
    }

    #[test]
    fn too_few_points_say_nothing() {
        let case = case(0.0);
        let few = PosedPixels { points_m: &case.points_m[..8], pixels: &case.pixels[..8], ..case.of(3.0) };
        assert_eq!(pose_error_slope(&few), None);
        let nowhere = vec![[f64::NAN; 2]; 60];
        assert_eq!(pose_error_slope(&PosedPixels { pixels: &nowhere, ..case.of(3.0) }), None);
    }
}
