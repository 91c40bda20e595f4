use nalgebra::{Isometry3, Matrix3, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6};

/// A rigid transform, named `a_from_b`: `a_from_b * point_in_b` is the point in `a`. Metres.
pub type Pose = Isometry3<f64>;

/// Why twelve numbers are not a pose.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PoseError {
    /// A number is NaN or infinite.
    #[error("the pose has a number that is not finite")]
    NotFinite,
    /// The matrix is not orthonormal, or mirrors.
    #[error(
        "the 3 x 3 matrix is not a rotation: R R^T differs from 1 by {orthogonality:.2e}, det R = {determinant:.4}"
    )]
    NotRotation {
        /// Largest absolute entry of `R R^T - 1`.
        orthogonality: f64,
        /// Determinant.
        determinant: f64,
    },
}

/// From a row-major rotation matrix and a translation in metres.
///
/// # Errors
/// When a number is not finite, or the matrix is further than 1e-2 from a rotation (files round to few digits;
/// what is nearer is projected onto the nearest rotation).
pub fn pose_from_row_major(rotation: &[f64; 9], translation_m: &[f64; 3]) -> Result<Pose, PoseError> {
    if rotation.iter().chain(translation_m).any(|v| !v.is_finite()) {
        return Err(PoseError::NotFinite);
    }
    let matrix = Matrix3::from_row_slice(rotation);
    let orthogonality = (matrix * matrix.transpose() - Matrix3::identity()).amax();
    let determinant = matrix.determinant();
    if orthogonality > 1e-2 || determinant < 0.0 {
        return Err(PoseError::NotRotation { orthogonality, determinant });
    }
    let nearest = nearest_rotation(&matrix);
    Ok(Pose::from_parts(
        Translation3::from(Vector3::from(*translation_m)),
        UnitQuaternion::from_rotation_matrix(&nearest),
    ))
}

/// The rotation nearest to a matrix in the Frobenius norm (orthogonal Procrustes).
fn nearest_rotation(matrix: &Matrix3<f64>) -> Rotation3<f64> {
    let svd = matrix.svd(true, true);
    let (u, v_t) = (svd.u.expect("asked for"), svd.v_t.expect("asked for"));
    let sign = (u * v_t).determinant().signum();
    Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t)
}

/// The rotation matrix of a pose, row-major.
#[must_use]
pub fn rotation_row_major(pose: &Pose) -> [f64; 9] {
    let m = pose.rotation.to_rotation_matrix();
    std::array::from_fn(|i| m[(i / 3, i % 3)])
}

/// From a quaternion x, y, z, w (any length but zero) and a translation in metres.
///
/// # Errors
/// When a number is not finite or the quaternion has no length.
pub fn pose_from_quaternion(rotation_xyzw: &[f64; 4], translation_m: &[f64; 3]) -> Result<Pose, PoseError> {
    let length = rotation_xyzw.iter().map(|v| v * v).sum::<f64>().sqrt();
    if !length.is_finite() || length < 1e-9 || translation_m.iter().any(|v| !v.is_finite()) {
        return Err(PoseError::NotFinite);
    }
    let rotation = UnitQuaternion::from_quaternion(Quaternion::from(*rotation_xyzw));
    Ok(Pose::from_parts(Translation3::from(Vector3::from(*translation_m)), rotation))
}

/// The rotation of a pose as a unit quaternion x, y, z, w.
#[must_use]
pub fn quaternion_xyzw(pose: &Pose) -> [f64; 4] {
    pose.rotation.coords.into()
}

/// The angle of the rotation from `a` to `b`, radians in `[0, pi]`.
#[must_use]
pub fn rotation_angle_rad(a: &Pose, b: &Pose) -> f64 {
    a.rotation.angle_to(&b.rotation)
}

/// Exponential map of SE(3). Tangent order as in ROS covariances: translation (m) first, rotation (rad) second.
///
/// ```
/// use nalgebra::Vector6;
/// use pseudoflow_geometry::{exp_se3, log_se3};
///
/// let tangent = Vector6::new(0.1, 0.0, -0.2, 0.0, 0.5, 0.0);
/// assert!((log_se3(&exp_se3(&tangent)) - tangent).norm() < 1e-12);
/// ```
#[must_use]
pub fn exp_se3(tangent: &Vector6<f64>) -> Pose {
    let rho = Vector3::new(tangent[0], tangent[1], tangent[2]);
    let phi = Vector3::new(tangent[3], tangent[4], tangent[5]);
    let rotation = UnitQuaternion::from_scaled_axis(phi);
    Pose::from_parts(Translation3::from(left_jacobian(&phi) * rho), rotation)
}

/// Logarithm of SE(3), the inverse of [`exp_se3`] for rotations under pi.
#[must_use]
pub fn log_se3(pose: &Pose) -> Vector6<f64> {
    let phi = pose.rotation.scaled_axis();
    let inverse = left_jacobian(&phi).try_inverse().unwrap_or_else(Matrix3::identity);
    let rho = inverse * pose.translation.vector;
    Vector6::new(rho.x, rho.y, rho.z, phi.x, phi.y, phi.z)
}

/// Left Jacobian of SO(3) (Barfoot, State Estimation for Robotics, eq. 7.77b).
fn left_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    let angle = phi.norm();
    let hat = phi.cross_matrix();
    if angle < 1e-6 {
        return Matrix3::identity() + 0.5 * hat + hat * hat / 6.0;
    }
    let (sin, cos) = angle.sin_cos();
    Matrix3::identity() + hat * ((1.0 - cos) / angle.powi(2)) + hat * hat * ((angle - sin) / angle.powi(3))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_inverts_exp() {
        for tangent in [Vector6::new(0.1, -0.3, 0.2, 0.5, -1.0, 0.3), Vector6::repeat(1e-9), Vector6::zeros()] {
            assert!((log_se3(&exp_se3(&tangent)) - tangent).norm() < 1e-9);
        }
    }

    #[test]
    fn row_major_round_trip() {
        let pose = exp_se3(&Vector6::new(0.1, -0.3, 0.2, 0.5, -1.0, 0.3));
        let back = pose_from_row_major(&rotation_row_major(&pose), &[0.1, 0.2, 0.3]).unwrap();
        assert!(rotation_angle_rad(&back, &pose) < 1e-9);
    }

    #[test]
    fn quaternions_round_trip() {
        let pose = exp_se3(&Vector6::new(0.1, -0.3, 0.2, 0.5, -1.0, 0.3));
        let back = pose_from_quaternion(&quaternion_xyzw(&pose), &pose.translation.vector.into()).unwrap();
        assert!((back.to_homogeneous() - pose.to_homogeneous()).norm() < 1e-12);
        assert_eq!(pose_from_quaternion(&[0.0; 4], &[0.0; 3]), Err(PoseError::NotFinite));
    }

    #[test]
    fn a_mirror_and_a_nan_are_refused() {
        let mirror = [1., 0., 0., 0., 1., 0., 0., 0., -1.];
        assert!(matches!(pose_from_row_major(&mirror, &[0.; 3]), Err(PoseError::NotRotation { .. })));
        let mut nan = mirror;
        nan[0] = f64::NAN;
        assert_eq!(pose_from_row_major(&nan, &[0.; 3]), Err(PoseError::NotFinite));
    }
}
