//! What is known of a pose before the picture is looked at.

use crate::config::PriorConfig;
use crate::model::ContourModel;
use nalgebra::{Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};
use pseudoflow_geometry::Pose;

/// Spread of rough poses: each number has its own standard deviation, and the whole has tails (Student's t).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// The rough pose.
    pub camera_from_object: Pose,
    /// Inverse variances: translation of the object's middle (1/m^2), rotation (1/rad^2), camera axes.
    pub information: [f64; 6],
    /// Degrees of freedom of the tails.
    pub freedom: f64,
    /// The point about which it turns, metres in the object's frame: its middle.
    pub middle_m: Vector3<f64>,
}

/// `pose` moved by a tangent vector: translation (m) first, then rotation (rad), both in the camera's fixed axes, the
/// rotation about the object's origin, as in `pseudoflow-solver`.
#[must_use]
pub fn retract(pose: &Pose, tangent: &Vector6<f64>) -> Pose {
    let shift: Vector3<f64> = tangent.fixed_rows::<3>(0).into();
    let turn: Vector3<f64> = tangent.fixed_rows::<3>(3).into();
    let rotation = UnitQuaternion::from_scaled_axis(turn) * pose.rotation;
    Pose::from_parts(
        Translation3::from(pose.translation.vector + shift),
        UnitQuaternion::new_normalize(rotation.into_inner()),
    )
}

impl Prior {
    /// The prior of an object at a rough pose.
    #[must_use]
    pub fn new(config: &PriorConfig, rough: &Pose, model: &ContourModel, diameter_m: f64) -> Self {
        let of = |sigma: f64| 1.0 / (sigma * sigma);
        let (xy, z) = (of(config.xy * diameter_m), of(config.z * diameter_m));
        let turn = of(config.rotation_deg.to_radians());
        Self {
            camera_from_object: *rough,
            information: [xy, xy, z, turn, turn, turn],
            freedom: config.freedom,
            middle_m: model.centre_m().coords,
        }
    }

    /// How far a pose is away: shift of the middle and turn, camera axes.
    fn difference(&self, pose: &Pose) -> Vector6<f64> {
        let turn = (pose.rotation * self.camera_from_object.rotation.inverse()).scaled_axis();
        let middle = |p: &Pose| p.rotation * self.middle_m + p.translation.vector;
        let shift = middle(pose) - middle(&self.camera_from_object);
        Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
    }

    /// Squared Mahalanobis distance.
    #[must_use]
    pub fn distance2(&self, pose: &Pose) -> f64 {
        let d = self.difference(pose);
        (0..6).map(|i| d[i] * d[i] * self.information[i]).sum()
    }

    /// Negative logarithm of the density, up to a constant.
    #[must_use]
    pub fn cost(&self, pose: &Pose) -> f64 {
        0.5 * (self.freedom + 6.0) * (self.distance2(pose) / self.freedom).ln_1p()
    }

    /// Adds the Gauss-Newton Hessian and the gradient of [`Prior::cost`] at a pose.
    pub fn accumulate(&self, pose: &Pose, hessian: &mut Matrix6<f64>, gradient: &mut Vector6<f64>) {
        let weight = (self.freedom + 6.0) / (self.freedom + self.distance2(pose));
        // Turning about the origin moves the middle: d shift / d turn = -[m]x with m the middle seen from the origin.
        let m = pose.rotation * self.middle_m;
        let mut jacobian = Matrix6::identity();
        jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-m.cross_matrix());
        let information = Matrix6::from_diagonal(&Vector6::from_fn(|i, _| weight * self.information[i]));
        *hessian += jacobian.transpose() * information * jacobian;
        *gradient += jacobian.transpose() * information * self.difference(pose);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gradient_is_that_of_the_cost() {
        let rough = Pose::new(Vector3::new(0.02, -0.01, 0.9), Vector3::new(0.4, -0.2, 0.1));
        let prior = Prior {
            camera_from_object: rough,
            information: [1e5, 1e5, 4e3, 36.0, 36.0, 36.0],
            freedom: 8.0,
            middle_m: Vector3::new(0.01, 0.03, -0.02),
        };
        let pose = retract(&rough, &Vector6::new(0.004, -0.002, 0.03, 0.02, -0.05, 0.03));
        let (mut hessian, mut gradient) = (Matrix6::zeros(), Vector6::zeros());
        prior.accumulate(&pose, &mut hessian, &mut gradient);
        for k in 0..6 {
            let mut tangent = Vector6::zeros();
            tangent[k] = 1e-6;
            let slope = (prior.cost(&retract(&pose, &tangent)) - prior.cost(&retract(&pose, &-tangent))) / 2e-6;
            // The rotation's own curvature is left out of Gauss-Newton: small turns, small difference.
            assert!((slope - gradient[k]).abs() < 0.02 * (1.0 + gradient[k].abs()), "{k}: {slope} {}", gradient[k]);
        }
        assert!(hessian.cholesky().is_some());
        assert!(prior.cost(&rough).abs() < 1e-12);
    }
}
