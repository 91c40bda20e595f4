use nalgebra::{Matrix3, Point2, Point3};
use serde::{Deserialize, Serialize};

/// A pinhole camera without distortion, in pixels; pixel centres at integer coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point x, pixels.
    pub cx: f64,
    /// Principal point y, pixels.
    pub cy: f64,
}

/// Why nine numbers are not a camera matrix.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum IntrinsicsError {
    /// A number is NaN or infinite.
    #[error("camera matrix K has a number that is not finite: {0:?}")]
    NotFinite([f64; 9]),
    /// A focal length is zero or negative (ROS uses an all-zero K for "uncalibrated").
    #[error("camera matrix K has focal lengths {fx}, {fy}: both must be positive (is the camera calibrated?)")]
    Focal {
        /// K\[0\].
        fx: f64,
        /// K\[4\].
        fy: f64,
    },
    /// The matrix is skewed, or its last row is not 0 0 1.
    #[error("camera matrix K {0:?} is not of the form fx 0 cx, 0 fy cy, 0 0 1: rectify the images first")]
    NotPinhole([f64; 9]),
}

impl Intrinsics {
    /// From a row-major 3 x 3 camera matrix, as in `CameraInfo.k` and BOP's `cam_K`.
    ///
    /// # Errors
    /// When a number is not finite, a focal length is not positive, or the matrix has skew.
    pub fn from_row_major(k: &[f64; 9]) -> Result<Self, IntrinsicsError> {
        if k.iter().any(|v| !v.is_finite()) {
            return Err(IntrinsicsError::NotFinite(*k));
        }
        let [fx, skew, cx, a, fy, cy, b, c, one] = *k;
        if fx <= 0.0 || fy <= 0.0 {
            return Err(IntrinsicsError::Focal { fx, fy });
        }
        if skew.abs() > 1e-6 * fx || a != 0.0 || b != 0.0 || c != 0.0 || (one - 1.0).abs() > 1e-9 {
            return Err(IntrinsicsError::NotPinhole(*k));
        }
        Ok(Self { fx, fy, cx, cy })
    }

    /// The row-major 3 x 3 camera matrix.
    #[must_use]
    pub fn to_row_major(&self) -> [f64; 9] {
        [self.fx, 0.0, self.cx, 0.0, self.fy, self.cy, 0.0, 0.0, 1.0]
    }

    /// The 3 x 3 camera matrix.
    #[must_use]
    pub fn matrix(&self) -> Matrix3<f64> {
        Matrix3::from_row_slice(&self.to_row_major())
    }

    /// The pixel that sees a point, or `None` for a point at or behind the camera plane.
    #[must_use]
    pub fn project(&self, point_in_camera: &Point3<f64>) -> Option<Point2<f64>> {
        let z = point_in_camera.z;
        (z > 1e-9)
            .then(|| Point2::new(self.fx * point_in_camera.x / z + self.cx, self.fy * point_in_camera.y / z + self.cy))
    }

    /// The point at `depth_m` (along z, metres) that a pixel sees.
    #[must_use]
    pub fn unproject(&self, pixel: &Point2<f64>, depth_m: f64) -> Point3<f64> {
        Point3::new((pixel.x - self.cx) / self.fx * depth_m, (pixel.y - self.cy) / self.fy * depth_m, depth_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unproject_inverts_project() {
        let k = Intrinsics { fx: 590.0, fy: 580.0, cx: 321.7, cy: 241.2 };
        let p = Point3::new(0.1, -0.2, 0.9);
        let back = k.unproject(&k.project(&p).unwrap(), p.z);
        assert!((back - p).norm() < 1e-12);
        assert!(k.project(&Point3::new(0.0, 0.0, -1.0)).is_none());
    }

    #[test]
    fn a_bad_matrix_is_named() {
        let bad = |k: [f64; 9]| Intrinsics::from_row_major(&k).unwrap_err();
        assert!(matches!(bad([f64::NAN, 0., 0., 0., 1., 0., 0., 0., 1.]), IntrinsicsError::NotFinite(_)));
        assert!(matches!(bad([0.; 9]), IntrinsicsError::Focal { .. }));
        assert!(matches!(bad([1., 2., 0., 0., 1., 0., 0., 0., 1.]), IntrinsicsError::NotPinhole(_)));
    }
}
