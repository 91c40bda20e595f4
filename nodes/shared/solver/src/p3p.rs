//! Pose from three points.
//!
//! The distances from the camera are where two quadrics of the law of cosines meet (Persson and Nordberg, "Lambda
//! Twist", ECCV 2018, section 3). A member of their pencil that falls apart into two planes comes from one real
//! root of a cubic; the planes are read off the degenerate conic as in Richter-Gebert, "Perspectives on Projective
//! Geometry", section 11.3. Each plane leaves a quadratic for the ratio of two distances.

use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use pseudoflow_geometry::Pose;

/// Poses `camera_from_object` that map three object points (metres) onto three unit viewing rays (camera frame), all in
/// front of the camera. Up to four; `out` holds them, the return value says how many. Points on a line or rays that
/// coincide give none.
pub fn p3p(points_in_object: &[Point3<f64>; 3], rays: &[Vector3<f64>; 3], out: &mut [Pose; 4]) -> usize {
    let Some(problem) = Problem::new(points_in_object, rays) else { return 0 };
    let mut count = 0;
    for plane in problem.planes().into_iter().flatten() {
        for distances in problem.distances_on(&plane).into_iter().flatten() {
            if count == out.len() {
                break;
            }
            if let Some(pose) = problem.pose(&distances) {
                out[count] = pose;
                count += 1;
            }
        }
    }
    count
}

/// Sides of the triangle: (i, j) in the order of `side2` and `cosine`.
const SIDES: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

struct Problem<'a> {
    points: &'a [Point3<f64>; 3],
    rays: &'a [Vector3<f64>; 3],
    /// Squared sides of the triangle.
    side2: [f64; 3],
    /// Cosines of the angles between the rays.
    cosine: [f64; 3],
    /// Inverse of (side 01, side 02, their cross product) as columns.
    inverse_frame: Matrix3<f64>,
}

impl<'a> Problem<'a> {
    fn new(points: &'a [Point3<f64>; 3], rays: &'a [Vector3<f64>; 3]) -> Option<Self> {
        let side2 = SIDES.map(|(i, j)| (points[i] - points[j]).norm_squared());
        let cosine = SIDES.map(|(i, j)| rays[i].dot(&rays[j]));
        let (a, b) = (points[1] - points[0], points[2] - points[0]);
        let normal = a.cross(&b);
        let longest2 = side2.iter().copied().fold(0.0, f64::max);
        let thin = normal.norm_squared() <= 1e-8 * longest2 * longest2;
        if thin || !(longest2.is_finite() && cosine.iter().all(|c| *c < 1.0 - 1e-12)) {
            return None;
        }
        let inverse_frame = Matrix3::from_columns(&[a, b, normal]).try_inverse()?;
        Some(Self { points, rays, side2, cosine, inverse_frame })
    }

    /// The quadric `d^T M d = |side|^2` of a side.
    fn quadric(&self, side: usize) -> Matrix3<f64> {
        let (i, j) = SIDES[side];
        let mut m = Matrix3::zeros();
        m[(i, i)] = 1.0;
        m[(j, j)] = 1.0;
        m[(i, j)] = -self.cosine[side];
        m[(j, i)] = -self.cosine[side];
        m
    }

    /// Two homogeneous quadrics that the distances lie on, scaled by the sides.
    fn pencil(&self) -> [Matrix3<f64>; 2] {
        let scale = 1.0 / self.side2[2].max(self.side2[0]).max(self.side2[1]);
        let s = self.side2.map(|v| v * scale);
        let base = self.quadric(2);
        [self.quadric(0) * s[2] - base * s[0], self.quadric(1) * s[2] - base * s[1]]
    }

    /// The normals of the two planes through the origin on which the distances lie.
    fn planes(&self) -> [Option<Vector3<f64>>; 2] {
        let [d1, d2] = self.pencil();
        let (c0, c3) = (d1.determinant(), d2.determinant());
        let (a1, a2) = (adjugate(&d1), adjugate(&d2));
        let (c1, c2) = ((a1 * d2).trace(), (a2 * d1).trace());
        // det(d1 + g d2) = c0 + c1 g + c2 g^2 + c3 g^3; with the larger end coefficient leading.
        let degenerate = if c3.abs() >= c0.abs() {
            real_root(c2 / c3, c1 / c3, c0 / c3).map(|g| d1 + d2 * g)
        } else {
            real_root(c1 / c0, c2 / c0, c3 / c0).map(|g| d2 + d1 * g)
        };
        match degenerate.and_then(|conic| split(&conic)) {
            Some([a, b]) => [Some(a), Some(b)],
            None => [None, None],
        }
    }

    /// Distances on a plane through the origin: one is a sum of the two others, whose ratio solves a quadratic.
    fn distances_on(&self, plane: &Vector3<f64>) -> [Option<Vector3<f64>>; 2] {
        let k = plane.iamax();
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        let (mut p, mut q) = (Vector3::zeros(), Vector3::zeros());
        (p[i], p[k]) = (1.0, -plane[i] / plane[k]);
        (q[j], q[k]) = (1.0, -plane[j] / plane[k]);
        // Distances are proportional to p + tau q; either quadric will do, so take the one less flat on the plane.
        let coefficients = self.pencil().map(|d| [q.dot(&(d * q)), 2.0 * p.dot(&(d * q)), p.dot(&(d * p))]);
        let size = |c: &[f64; 3]| c.iter().map(|v| v.abs()).sum::<f64>();
        let best = if size(&coefficients[0]) > size(&coefficients[1]) { coefficients[0] } else { coefficients[1] };
        quadratic_roots(best).map(|tau| self.scaled(&(p + q * tau?)))
    }

    /// The distances of a direction, scaled by the longest side and polished by Newton's method.
    fn scaled(&self, direction: &Vector3<f64>) -> Option<Vector3<f64>> {
        let direction = if direction.sum() < 0.0 { -direction } else { *direction };
        let side = if self.side2[0] >= self.side2[1].max(self.side2[2]) {
            0
        } else {
            1 + usize::from(self.side2[2] > self.side2[1])
        };
        let unit = direction.dot(&(self.quadric(side) * direction));
        if direction.min() <= 0.0 || unit <= 0.0 {
            return None;
        }
        let mut d = direction * (self.side2[side] / unit).sqrt();
        for _ in 0..3 {
            d -= self.newton_step(&d)?;
        }
        (d.min() > 0.0).then_some(d)
    }

    fn newton_step(&self, d: &Vector3<f64>) -> Option<Vector3<f64>> {
        let (mut jacobian, mut error) = (Matrix3::zeros(), Vector3::zeros());
        for (row, &(i, j)) in SIDES.iter().enumerate() {
            let c = self.cosine[row];
            error[row] = d[i] * d[i] + d[j] * d[j] - 2.0 * c * d[i] * d[j] - self.side2[row];
            jacobian[(row, i)] = 2.0 * (d[i] - c * d[j]);
            jacobian[(row, j)] = 2.0 * (d[j] - c * d[i]);
        }
        Some(jacobian.try_inverse()? * error)
    }

    /// The pose that puts the points at these distances along their rays.
    fn pose(&self, distances: &Vector3<f64>) -> Option<Pose> {
        let seen = [0, 1, 2].map(|i| self.rays[i] * distances[i]);
        let (a, b) = (seen[1] - seen[0], seen[2] - seen[0]);
        let matrix = Matrix3::from_columns(&[a, b, a.cross(&b)]) * self.inverse_frame;
        let off = (matrix * matrix.transpose() - Matrix3::identity()).amax();
        if off.is_nan() || off > 1e-5 {
            return None;
        }
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
        let translation = seen[0] - rotation * self.points[0].coords;
        Some(Pose::from_parts(Translation3::from(translation), rotation))
    }
}

fn adjugate(m: &Matrix3<f64>) -> Matrix3<f64> {
    let (r0, r1, r2) = (m.row(0).transpose(), m.row(1).transpose(), m.row(2).transpose());
    Matrix3::from_columns(&[r1.cross(&r2), r2.cross(&r0), r0.cross(&r1)])
}

/// A real root of x^3 + a x^2 + b x + c, polished by Newton's method.
fn real_root(a: f64, b: f64, c: f64) -> Option<f64> {
    let (p, q) = (b - a * a / 3.0, a * (2.0 * a * a - 9.0 * b) / 27.0 + c);
    let discriminant = q * q / 4.0 + p * p * p / 27.0;
    let depressed = if discriminant >= 0.0 {
        // One real root: add numbers of the same sign, so that nothing cancels.
        let u = (-q / 2.0 - discriminant.sqrt().copysign(q)).cbrt();
        if u == 0.0 { 0.0 } else { u - p / (3.0 * u) }
    } else {
        let radius = (-p / 3.0).sqrt();
        let angle = (-q / (2.0 * radius.powi(3))).clamp(-1.0, 1.0).acos();
        2.0 * radius * (angle / 3.0).cos()
    };
    let mut x = depressed - a / 3.0;
    for _ in 0..2 {
        let slope = (3.0 * x + 2.0 * a) * x + b;
        let step = (((x + a) * x + b) * x + c) / slope;
        if step.is_finite() {
            x -= step;
        }
    }
    x.is_finite().then_some(x)
}

/// The two real lines that a degenerate conic consists of; `None` when they are not real.
fn split(conic: &Matrix3<f64>) -> Option<[Vector3<f64>; 2]> {
    let cross = -adjugate(conic);
    let i = cross.diagonal().imax();
    let beta2 = cross[(i, i)];
    if beta2.is_nan() || beta2 <= 0.0 {
        return None;
    }
    let meet: Vector3<f64> = cross.column(i) / beta2.sqrt();
    let rank_one = conic + meet.cross_matrix();
    let (row, column) = rank_one.iamax_full();
    Some([rank_one.row(row).transpose(), rank_one.column(column).into()])
}

/// Real roots of c0 x^2 + c1 x + c2 without cancellation.
fn quadratic_roots([a, b, c]: [f64; 3]) -> [Option<f64>; 2] {
    let discriminant = b * b - 4.0 * a * c;
    if discriminant.is_nan() || discriminant < 0.0 {
        return [None, None];
    }
    let q = -0.5 * (b + discriminant.sqrt().copysign(b));
    [q / a, c / q].map(|root| Some(root).filter(|r| r.is_finite()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random_pose;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn one_of_the_poses_is_the_true_one(
            coordinates in proptest::array::uniform9(-0.1_f64..0.1), seed in 0_u64..10_000
        ) {
            let c = coordinates;
            let points = [0, 3, 6].map(|i| Point3::new(c[i], c[i + 1], c[i + 2]));
            let area = (points[1] - points[0]).cross(&(points[2] - points[0])).norm();
            prop_assume!(area > 1e-3);
            let truth = random_pose(seed);
            let rays = points.map(|p| (truth * p).coords.normalize());
            let mut out = [Pose::identity(); 4];
            let count = p3p(&points, &rays, &mut out);
            prop_assert!(count > 0);
            for pose in &out[..count] {
                for (p, ray) in points.iter().zip(&rays) {
                    prop_assert!(((pose * p).coords.normalize() - ray).norm() < 1e-6);
                }
            }
            let off = |p: &Pose| (p.translation.vector - truth.translation.vector).norm()
                + p.rotation.angle_to(&truth.rotation);
            let best = out[..count].iter().map(off).fold(f64::INFINITY, f64::min);
            // Near the cylinder of danger two solutions meet and lose half of the digits.
            prop_assert!(best < 1e-3, "off by {best}");
        }
    }

    #[test]
    fn points_on_a_line_and_nan_give_none() {
        let line = [0.0, 0.1, 0.2].map(|x| Point3::new(x, x, 0.0));
        let rays = line.map(|p| (p.coords + Vector3::z()).normalize());
        let mut out = [Pose::identity(); 4];
        assert_eq!(p3p(&line, &rays, &mut out), 0);
        let nan = [Point3::new(f64::NAN, 0.0, 0.0), Point3::new(0.1, 0.0, 0.0), Point3::new(0.0, 0.1, 0.0)];
        assert_eq!(p3p(&nan, &rays, &mut out), 0);
        let triangle = [Point3::origin(), Point3::new(0.1, 0.0, 0.0), Point3::new(0.0, 0.1, 0.0)];
        assert_eq!(p3p(&triangle, &[Vector3::repeat(f64::NAN); 3], &mut out), 0);
    }
}
