use super::features::{Feature, Features, ln_of};
use nalgebra::Point3;
use pseudoflow_geometry::{Pose, rotation_angle_rad};
use pseudoflow_solver::JointResult;

/// What a joint result is measured by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContourScale {
    /// The pose that the solver began from, `camera_from_object`.
    pub rough: Pose,
    /// Middle of the object, metres, object's frame.
    pub middle_m: Point3<f64>,
    /// Diameter of the object, metres.
    pub diameter_m: f64,
    /// Focal length of the camera, pixels.
    pub focal_px: f64,
    /// Contour points of the view, also those that cannot be read.
    pub points: usize,
}

/// Distances beyond this count as this, diameters.
const FAR: f64 = 0.5;

impl ContourScale {
    fn middle(&self, pose: &Pose) -> Point3<f64> {
        pose * self.middle_m
    }

    /// How far the surface lies apart at two poses, diameters: root of the squares of shift and turn at half the radius.
    fn distance(&self, a: &Pose, b: &Pose) -> f64 {
        let shift = (self.middle(a) - self.middle(b)).norm() / self.diameter_m;
        shift.hypot(0.25 * rotation_angle_rad(a, b)).min(FAR)
    }
}

impl Features {
    /// With what the contour and the change of the pose say; without flow the flow's features stay unknown.
    #[must_use]
    pub fn with_contour(self, found: &JointResult, scale: &ContourScale) -> Self {
        let pose = &found.camera_from_object;
        let (before, after) = (scale.middle(&scale.rough), scale.middle(pose));
        // Across the view at the depth of before: a change of depth alone is none.
        let across = |p: &Point3<f64>| p.xy() * (before.z / p.z.max(1e-3));
        let shift = (across(&after) - before.xy()).norm() / scale.diameter_m;
        let lines = found.region.lines;
        let alone = found.pnp.as_ref().map(|pnp| match pnp.status.is_ok() {
            true => scale.distance(&pnp.camera_from_object, pose),
            false => FAR,
        });
        self.with_change(&scale.rough, pose, (after.z - before.z).abs() / scale.diameter_m)
            .with_sigmas(&found.covariance, scale.diameter_m)
            .with(Feature::Shift, shift.min(FAR))
            .with(Feature::InlierRatio, found.inlier_ratio.unwrap_or(f64::NAN))
            .with(Feature::ContourOverlap, f64::from(found.region.overlap))
            .with(Feature::ContourAgreement, found.region.agreement)
            .with(Feature::ContourSeen, lines as f64 / scale.points.max(1) as f64)
            .with(Feature::CostPerLine, (found.cost / lines.max(1) as f64).clamp(-3.0, 3.0))
            .with(Feature::LnObjectPx, ln_of(scale.focal_px * scale.diameter_m / before.z))
            .with(Feature::FlowContourDistance, alone.unwrap_or(f64::NAN))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix6, Vector3};
    use pseudoflow_contour::{Region, RegionStatus};

    const SCALE: fn() -> ContourScale = || ContourScale {
        rough: Pose::new(Vector3::new(0.0, 0.0, 0.8), Vector3::zeros()),
        middle_m: Point3::origin(),
        diameter_m: 0.2,
        focal_px: 600.0,
        points: 200,
    };

    fn found(pose: Pose) -> JointResult {
        JointResult {
            camera_from_object: pose,
            covariance: std::array::from_fn(|i| if i % 7 == 0 { 4e-6 } else { 0.0 }),
            cost: -30.0,
            region: Region {
                camera_from_object: pose,
                information: Matrix6::identity(),
                cost: -30.0,
                agreement: 0.7,
                overlap: 0.2,
                lines: 150,
                status: RegionStatus::Ok,
            },
            pnp: None,
            inlier_ratio: None,
            known: true,
        }
    }

    #[test]
    fn features_are_in_their_units() {
        let pose = Pose::new(Vector3::new(0.02, 0.0, 0.8), Vector3::new(0.0, 0.4, 0.0));
        let features = Features::default().with_contour(&found(pose), &SCALE());
        let is = |feature, value: f64| assert!((features.get(feature) - value).abs() < 1e-6, "{feature:?}");
        is(Feature::Shift, 0.1);
        is(Feature::Rotation, 0.4);
        is(Feature::RotationOver20Deg, 0.4 - 20_f64.to_radians());
        is(Feature::DepthChange, 0.0);
        is(Feature::ContourSeen, 0.75);
        is(Feature::CostPerLine, -0.2);
        is(Feature::LnObjectPx, 150_f64.ln());
        is(Feature::LnTranslationSigma, 0.01_f64.ln());
        assert!(features.get(Feature::FlowContourDistance).is_nan() && features.get(Feature::InlierRatio).is_nan());
    }

    #[test]
    fn a_change_of_depth_along_the_ray_is_no_shift() {
        let scale = ContourScale { rough: Pose::new(Vector3::new(0.1, 0.05, 0.8), Vector3::zeros()), ..SCALE() };
        let pose = Pose::new(Vector3::new(0.11, 0.055, 0.88), Vector3::zeros());
        let features = Features::default().with_contour(&found(pose), &scale);
        assert!(features.get(Feature::Shift) < 1e-9);
        assert!((features.get(Feature::DepthChange) - 0.4).abs() < 1e-9);
        assert!((features.get(Feature::DepthChangeOverQuarter) - 0.15).abs() < 1e-9);
    }
}
