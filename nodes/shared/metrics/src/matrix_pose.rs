use nalgebra::{Matrix3, Vector3};
use pseudoflow_geometry::{Pose, PoseError, pose_from_row_major};

/// `camera_from_object` as a file gives it: a matrix that may be off a rotation in the third digit.
///
/// Official ground truth is (LM-O's driller by 2e-3), and bop_toolkit takes such matrices as they are, so the errors of
/// this crate do too: replacing them by the nearest rotation would move MSSD and VSD by more than 1e-4.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MatrixPose {
    matrix: Matrix3<f64>,
    translation_m: Vector3<f64>,
    nearest: Pose,
}

impl MatrixPose {
    /// From a row-major matrix and a translation in metres.
    ///
    /// # Errors
    /// When a number is not finite, or the matrix is further than 1e-2 from a rotation.
    pub fn from_row_major(rotation: &[f64; 9], translation_m: &[f64; 3]) -> Result<Self, PoseError> {
        let nearest = pose_from_row_major(rotation, translation_m)?;
        Ok(Self { matrix: Matrix3::from_row_slice(rotation), translation_m: Vector3::from(*translation_m), nearest })
    }

    /// The pose with the nearest rotation.
    #[must_use]
    pub fn pose(&self) -> Pose {
        self.nearest
    }

    /// The matrix as given.
    #[must_use]
    pub fn matrix(&self) -> &Matrix3<f64> {
        &self.matrix
    }

    /// The translation, metres.
    #[must_use]
    pub fn translation_m(&self) -> &Vector3<f64> {
        &self.translation_m
    }

    /// This pose after a transform of the object (a symmetry).
    #[must_use]
    pub fn after(&self, object_from_object: &Pose) -> Self {
        Self {
            matrix: self.matrix * object_from_object.rotation.to_rotation_matrix().matrix(),
            translation_m: self.matrix * object_from_object.translation.vector + self.translation_m,
            nearest: self.nearest * object_from_object,
        }
    }

    /// What the matrix does to the object before its nearest rotation turns it; `None` when it is a rotation (to
    /// 1e-7, the precision of the vertices).
    #[must_use]
    pub fn stretch(&self) -> Option<Matrix3<f64>> {
        let stretch = self.nearest.rotation.to_rotation_matrix().matrix().transpose() * self.matrix;
        Some(stretch).filter(|s| (s - Matrix3::identity()).amax() > 1e-7)
    }
}

impl From<Pose> for MatrixPose {
    fn from(pose: Pose) -> Self {
        let matrix = *pose.rotation.to_rotation_matrix().matrix();
        Self { matrix, translation_m: pose.translation.vector, nearest: pose }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn stretch_then_nearest_is_the_matrix() {
        let numbers = [0.999, 0.0, 0.001, 0.0, 1.001, 0.0, 0.0, 0.0, 1.0];
        let given = MatrixPose::from_row_major(&numbers, &[0.1, 0.2, 0.9]).unwrap();
        let p = Point3::new(0.03, -0.02, 0.05);
        let stretched = given.pose() * Point3::from(given.stretch().unwrap() * p.coords);
        let direct = Point3::from(given.matrix() * p.coords + given.translation_m());
        assert!((stretched - direct).norm() < 1e-15);
        assert_eq!(MatrixPose::from(given.pose()).stretch(), None);
    }
}
