//! EPnP: pose from any number of points in linear time (Lepetit, Moreno-Noguer and Fua, IJCV 2009).

use nalgebra::{
    Matrix3, Matrix6x5, Point2, Point3, Rotation3, SMatrix, SVector, SymmetricEigen, Translation3, UnitQuaternion,
    Vector3, Vector4, Vector6,
};
use pseudoflow_geometry::{Intrinsics, Pose};

/// Why EPnP gives no pose.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum EpnpError {
    /// Fewer than four points, or as many points as pixels is not so.
    #[error("EPnP needs at least 4 points with one pixel each, got {points} points and {pixels} pixels")]
    Count {
        /// Count of points.
        points: usize,
        /// Count of pixels.
        pixels: usize,
    },
    /// A point, a pixel or the camera has a number that is not finite.
    #[error("EPnP got a number that is not finite")]
    NotFinite,
    /// The points lie on a line or coincide.
    #[error("EPnP can't tell the rotation about the line on which all points lie")]
    Collinear,
    /// No candidate puts the points in front of the camera.
    #[error("EPnP found no pose with the points in front of the camera")]
    NoPose,
}

type Matrix12 = SMatrix<f64, 12, 12>;
type Vector12 = SVector<f64, 12>;

/// Below this ratio of the smallest to the largest extent the points count as a plane.
const PLANAR: f64 = 1e-4;
/// Up to this ratio both the planar and the general form are tried.
const NEARLY_PLANAR: f64 = 0.1;
/// Below this ratio of the second to the largest extent the points count as a line.
const LINEAR: f64 = 1e-6;

/// The pose `camera_from_object` of `points_in_object` (metres, n >= 4) seen at `pixels`. Points in a plane are handled
/// with three control points in place of four. Least squares without any robustness: one outlier spoils it. Does not
/// allocate.
///
/// # Errors
/// See [`EpnpError`].
pub fn epnp(
    points_in_object: &[Point3<f64>],
    pixels: &[Point2<f64>],
    intrinsics: &Intrinsics,
) -> Result<Pose, EpnpError> {
    if points_in_object.len() < 4 || points_in_object.len() != pixels.len() {
        return Err(EpnpError::Count { points: points_in_object.len(), pixels: pixels.len() });
    }
    let finite = |v: &[f64]| v.iter().all(|v| v.is_finite());
    let all_finite = points_in_object.iter().all(|p| finite(p.coords.as_slice()))
        && pixels.iter().all(|p| finite(p.coords.as_slice()))
        && finite(&intrinsics.to_row_major());
    if !all_finite || intrinsics.fx <= 0.0 || intrinsics.fy <= 0.0 {
        return Err(EpnpError::NotFinite);
    }
    let data = Data { points: points_in_object, pixels, intrinsics };
    let (axes, extents) = data.principal_axes().ok_or(EpnpError::NotFinite)?;
    if extents[1] <= LINEAR * extents[0] {
        return Err(EpnpError::Collinear);
    }
    let flatness = extents[2] / extents[0];
    let general = (flatness > PLANAR).then(|| data.solve(&axes, 4)).flatten();
    let planar = (flatness < NEARLY_PLANAR).then(|| data.solve(&axes, 3)).flatten();
    let best = [general, planar].into_iter().flatten().min_by(|a, b| a.error.total_cmp(&b.error));
    best.map(|c| c.pose).ok_or(EpnpError::NoPose)
}

struct Data<'a> {
    points: &'a [Point3<f64>],
    pixels: &'a [Point2<f64>],
    intrinsics: &'a Intrinsics,
}

/// A pose and its sum of squared reprojection errors, pixels^2.
struct Candidate {
    pose: Pose,
    error: f64,
}

/// Centroid and principal directions scaled by their standard deviations, metres, longest first.
struct Axes {
    centre: Point3<f64>,
    directions: [Vector3<f64>; 3],
}

/// Null vectors as control points: `points[k][j]` is control point j in null vector k.
type NullPoints = [[Vector3<f64>; 4]; 4];

impl Data<'_> {
    fn principal_axes(&self) -> Option<(Axes, [f64; 3])> {
        let n = self.points.len() as f64;
        let centre = Point3::from(self.points.iter().fold(Vector3::zeros(), |sum, p| sum + p.coords) / n);
        let scatter = self.points.iter().fold(Matrix3::zeros(), |sum, p| sum + (p - centre) * (p - centre).transpose());
        let eigen = SymmetricEigen::try_new(scatter / n, 1e-15, 200)?;
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let extents = order.map(|i| eigen.eigenvalues[i].max(0.0).sqrt());
        let directions = [0, 1, 2].map(|k| eigen.eigenvectors.column(order[k]) * extents[k]);
        Some((Axes { centre, directions }, extents))
    }

    /// EPnP with the centroid and the first `controls - 1` axes as control points.
    fn solve(&self, axes: &Axes, controls: usize) -> Option<Candidate> {
        let null = null_points(&self.normal_matrix(axes, controls)?)?;
        let distances = Distances::new(axes, &null, controls);
        distances
            .starts()
            .into_iter()
            .flatten()
            .filter_map(|betas| self.candidate(axes, &null, &distances.polish(betas), controls))
            .min_by(|a, b| a.error.total_cmp(&b.error))
    }

    /// M^T M (equation 7) with the rows in pixels. For a plane the unused control point gets a weight that keeps it out
    /// of the null space.
    fn normal_matrix(&self, axes: &Axes, controls: usize) -> Option<Matrix12> {
        let k = self.intrinsics;
        let mut blocks = [[Matrix3::zeros(); 4]; 4];
        let dual = self.dual_directions(axes, controls);
        for (point, pixel) in self.points.iter().zip(self.pixels) {
            let (x, y) = ((pixel.x - k.cx) / k.fx, (pixel.y - k.cy) / k.fy);
            let (fx2, fy2) = (k.fx * k.fx, k.fy * k.fy);
            let (zx, zy) = (-fx2 * x, -fy2 * y);
            let block = Matrix3::new(fx2, 0.0, zx, 0.0, fy2, zy, zx, zy, fx2 * x * x + fy2 * y * y);
            let offset = point - axes.centre;
            let a = dual.map(|d| d.dot(&offset));
            let alphas = [1.0 - a[0] - a[1] - a[2], a[0], a[1], a[2]];
            for i in 0..controls {
                for j in i..controls {
                    blocks[i][j] += block * (alphas[i] * alphas[j]);
                }
            }
        }
        let mut matrix = Matrix12::zeros();
        for i in 0..controls {
            for j in 0..controls {
                let block = if i <= j { blocks[i][j] } else { blocks[j][i].transpose() };
                matrix.fixed_view_mut::<3, 3>(3 * i, 3 * j).copy_from(&block);
            }
        }
        let scale = matrix.trace();
        if !scale.is_finite() || scale <= 0.0 {
            return None;
        }
        matrix /= scale;
        for i in 3 * controls..12 {
            matrix[(i, i)] = 10.0;
        }
        Some(matrix)
    }

    /// Vectors whose products with a point's offset are its coordinates along the axes in use.
    fn dual_directions(&self, axes: &Axes, controls: usize) -> [Vector3<f64>; 3] {
        std::array::from_fn(|i| {
            let d = axes.directions[i];
            if i + 1 < controls { d / d.norm_squared() } else { Vector3::zeros() }
        })
    }

    /// The pose of the control points `sum_k beta_k null_k`: Procrustes on the points, which lie along principal
    /// axes, so that their correlation is the sum over the axes.
    fn candidate(&self, axes: &Axes, null: &NullPoints, betas: &Vector4<f64>, controls: usize) -> Option<Candidate> {
        let mut seen = [0, 1, 2, 3].map(|j| (0..4).fold(Vector3::zeros(), |sum, k| sum + null[k][j] * betas[k]));
        if seen[0].z < 0.0 {
            seen = seen.map(|p| -p);
        }
        let correlation = (1..controls)
            .fold(Matrix3::zeros(), |sum, j| sum + (seen[j] - seen[0]) * axes.directions[j - 1].transpose());
        let rotation = UnitQuaternion::from_rotation_matrix(&rotation_of(&correlation)?);
        let translation = seen[0] - rotation * axes.centre.coords;
        let pose = Pose::from_parts(Translation3::from(translation), rotation);
        self.reprojection_error(&pose).map(|error| Candidate { pose, error })
    }

    /// Sum of squared errors, pixels^2; `None` with a point behind the camera.
    fn reprojection_error(&self, pose: &Pose) -> Option<f64> {
        let mut sum = 0.0;
        for (point, pixel) in self.points.iter().zip(self.pixels) {
            sum += (self.intrinsics.project(&(pose * point))? - pixel).norm_squared();
        }
        sum.is_finite().then_some(sum)
    }
}

/// The rotation nearest to a correlation matrix of rank 2 or 3.
fn rotation_of(correlation: &Matrix3<f64>) -> Option<Rotation3<f64>> {
    if !correlation.iter().all(|v| v.is_finite()) {
        return None;
    }
    let svd = correlation.try_svd(true, true, 1e-15, 200)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    let sign = (u * v_t).determinant().signum();
    Some(Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t))
}

/// The four eigenvectors of the smallest eigenvalues, smallest first.
fn null_points(matrix: &Matrix12) -> Option<NullPoints> {
    let eigen = SymmetricEigen::try_new(*matrix, 1e-15, 500)?;
    let mut order: [usize; 12] = std::array::from_fn(|i| i);
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    Some([0, 1, 2, 3].map(|k| {
        let v: Vector12 = eigen.eigenvectors.column(order[k]).into();
        [0, 1, 2, 3].map(|j| Vector3::new(v[3 * j], v[3 * j + 1], v[3 * j + 2]))
    }))
}

/// Pairs of control points; those among the first three come first.
const PAIRS: [(usize, usize); 6] = [(0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3)];

/// The distances between control points, which fix the betas (section 3.3 of the paper).
struct Distances {
    /// Differences of null vector k over pair p, zero for unused pairs.
    difference: [[Vector3<f64>; 6]; 4],
    /// Squared distances in the object, metres^2.
    squared: Vector6<f64>,
    /// How many betas the pairs can determine.
    betas: usize,
}

impl Distances {
    fn new(axes: &Axes, null: &NullPoints, controls: usize) -> Self {
        let pairs = if controls == 4 { 6 } else { 3 };
        let controls_m = [0, 1, 2, 3].map(|j| if j == 0 { Vector3::zeros() } else { axes.directions[j - 1] });
        let mut out = Self { difference: [[Vector3::zeros(); 6]; 4], squared: Vector6::zeros(), betas: controls };
        for (p, &(i, j)) in PAIRS.iter().enumerate().take(pairs) {
            out.squared[p] = (controls_m[i] - controls_m[j]).norm_squared();
            for k in 0..controls {
                out.difference[k][p] = null[k][i] - null[k][j];
            }
        }
        out
    }

    /// Starting betas from linear systems in some of the products of two betas.
    fn starts(&self) -> [Option<Vector4<f64>>; 3] {
        let one = self.linear(&[(0, 0), (0, 1), (0, 2), (0, 3)][..self.betas]).map(|b| {
            let first = b[0].abs().sqrt();
            let others = if first > 0.0 { b[0].signum() / first } else { 0.0 };
            Vector4::new(first, b[1] * others, b[2] * others, b[3] * others)
        });
        let two = self.linear(&[(0, 0), (0, 1), (1, 1)]).map(|b| first_two(&b));
        let three =
            (self.betas == 4).then(|| self.linear(&[(0, 0), (0, 1), (1, 1), (0, 2), (1, 2)])).flatten().map(|b| {
                let mut betas = first_two(&b);
                betas[2] = if betas[0].abs() > 0.0 { b[3] * b[0].signum() / betas[0] } else { 0.0 };
                betas
            });
        [one, two, three]
    }

    /// Least squares in the products `beta_k beta_l` of the given pairs (k, l).
    fn linear(&self, products: &[(usize, usize)]) -> Option<SVector<f64, 5>> {
        let mut matrix = Matrix6x5::zeros();
        for (column, &(k, l)) in products.iter().enumerate() {
            for p in 0..6 {
                let product = self.difference[k][p].dot(&self.difference[l][p]);
                matrix[(p, column)] = if k == l { product } else { 2.0 * product };
            }
        }
        let svd = matrix.try_svd(true, true, 1e-15, 200)?;
        let limit = svd.singular_values.max() * 1e-12;
        let solution = svd.solve(&self.squared, limit.max(f64::MIN_POSITIVE)).ok()?;
        solution.iter().all(|v| v.is_finite()).then_some(solution)
    }

    /// Gauss-Newton on the squared distances (section 3.4), lightly damped where they do not fix all betas.
    fn polish(&self, mut betas: Vector4<f64>) -> Vector4<f64> {
        for _ in 0..10 {
            let (mut hessian, mut gradient) = (nalgebra::Matrix4::zeros(), Vector4::zeros());
            for p in 0..6 {
                let sum = (0..4).fold(Vector3::zeros(), |sum, k| sum + self.difference[k][p] * betas[k]);
                let slope = Vector4::from_fn(|k, _| 2.0 * self.difference[k][p].dot(&sum));
                hessian += slope * slope.transpose();
                gradient += slope * (sum.norm_squared() - self.squared[p]);
            }
            let damping = 1e-10 * hessian.trace() + f64::MIN_POSITIVE;
            let Some(cholesky) = (hessian + nalgebra::Matrix4::identity() * damping).cholesky() else { break };
            let step = cholesky.solve(&gradient);
            if !step.iter().all(|v| v.is_finite()) {
                break;
            }
            betas -= step;
        }
        betas
    }
}

/// Betas 0 and 1 from (b00, b01, b11), whose signs may be those of the other half space.
fn first_two(b: &SVector<f64, 5>) -> Vector4<f64> {
    let second = if b[0] * b[2] > 0.0 { b[2].abs().sqrt() } else { 0.0 };
    let sign = if b[0] * b[1] < 0.0 { -1.0 } else { 1.0 };
    Vector4::new(sign * b[0].abs().sqrt(), second, 0.0, 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{CAMERA, Scene};
    use proptest::prelude::*;

    fn run(scene: &Scene) -> Result<Pose, EpnpError> {
        let points: Vec<_> = scene.points.iter().map(|p| Point3::from(*p).cast::<f64>()).collect();
        let pixels: Vec<_> = scene.pixels.iter().map(|p| Point2::from(*p).cast::<f64>()).collect();
        epnp(&points, &pixels, &CAMERA)
    }

    proptest! {
        #[test]
        fn exact_points_give_the_pose(seed in 0_u64..100_000, n in 6_usize..60) {
            let scene = Scene::solid(n, seed);
            let off = scene.add_m(&run(&scene).unwrap());
            prop_assert!(off < 2e-4, "{off}");
        }

        #[test]
        fn noise_moves_the_pose_little(seed in 0_u64..100_000) {
            let scene = Scene::solid(200, seed).noisy(1.0);
            let off = scene.add_m(&run(&scene).unwrap());
            prop_assert!(off < 0.02, "{off}");
        }

        #[test]
        fn a_plane_is_reprojected_well(seed in 0_u64..100_000, n in 6_usize..60, thickness in 0.0_f64..1e-3) {
            // A plane seen nearly face on has a mirrored twin, so the judge is the image, not the pose.
            let scene = Scene::in_box(n, seed, [0.06, 0.05, thickness]);
            let pose = run(&scene).unwrap();
            let error = scene.points.iter().zip(&scene.pixels).map(|(p, q)| {
                let seen = CAMERA.project(&(pose * Point3::from(*p).cast::<f64>())).unwrap();
                (seen - Point2::from(*q).cast::<f64>()).norm()
            }).fold(0.0, f64::max);
            prop_assert!(error < 1.5, "{error}");
        }
    }

    #[test]
    fn four_points_are_enough() {
        let solved = (0..50).filter(|&seed| {
            let scene = Scene::solid(4, seed);
            run(&scene).is_ok_and(|pose| scene.add_m(&pose) < 1e-3)
        });
        // Four points have several exact poses, EPnP reports one of them.
        assert!(solved.count() > 25);
    }

    #[test]
    fn bad_input_is_named() {
        assert!(matches!(run(&Scene::solid(3, 1)), Err(EpnpError::Count { points: 3, .. })));
        assert_eq!(run(&Scene::in_box(30, 1, [0.05, 0.0, 0.0])), Err(EpnpError::Collinear));
        let mut nan = Scene::solid(10, 1);
        nan.pixels[4][1] = f32::NAN;
        assert_eq!(run(&nan), Err(EpnpError::NotFinite));
    }
}
