use crate::Pose;
use nalgebra::{Point3, Translation3, Unit, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// A rotation axis around which an object looks the same at every angle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ContinuousSymmetry {
    /// Direction of the axis in the object's frame.
    pub axis: Vector3<f64>,
    /// A point on the axis, metres in the object's frame.
    pub offset_m: Point3<f64>,
}

/// The transforms that map an object onto itself, as BOP's `models_info.json` lists them.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Symmetries {
    /// Discrete symmetry transforms beside the identity, `object_from_object`.
    pub discrete: Vec<Pose>,
    /// Continuous symmetries.
    pub continuous: Vec<ContinuousSymmetry>,
}

impl Symmetries {
    /// Whether the identity is the only symmetry.
    #[must_use]
    pub fn is_trivial(&self) -> bool {
        self.discrete.is_empty() && self.continuous.is_empty()
    }

    /// All transforms, identity first, with the continuous ones cut into steps as BOP does: `ceil(pi / step)`
    /// steps of the full turn, so that no surface point moves further than `max_step` diameters between two.
    /// Every discrete transform is combined with every continuous one (bop_toolkit `get_symmetry_transformations`).
    #[must_use]
    pub fn transforms(&self, max_step: f64) -> Vec<Pose> {
        let discrete: Vec<Pose> = std::iter::once(Pose::identity()).chain(self.discrete.iter().copied()).collect();
        let steps = (std::f64::consts::PI / max_step).ceil() as usize;
        let continuous: Vec<Pose> =
            self.continuous.iter().flat_map(|s| (0..steps).map(move |i| turn(s, i as f64 / steps as f64))).collect();
        if continuous.is_empty() {
            return discrete;
        }
        discrete.iter().flat_map(|d| continuous.iter().map(move |c| c * d)).collect()
    }

    /// Of all poses that look the same, the one whose camera lies most in a fixed direction of the object's frame. Equal
    /// images so get equal poses, but for views on the border between two; turning the camera about its axis does not
    /// change the choice.
    #[must_use]
    pub fn canonical(&self, camera_from_object: &Pose) -> Pose {
        if self.is_trivial() {
            return *camera_from_object;
        }
        // In general position to the axes of boxes and tins.
        let towards = Vector3::new(0.41, 0.53, 0.74);
        let score = |pose: &Pose| pose.inverse_transform_point(&Point3::origin()).coords.normalize().dot(&towards);
        let equal = self.transforms(CANONICAL_STEP).into_iter().map(|s| camera_from_object * s);
        equal.max_by(|a, b| score(a).total_cmp(&score(b))).unwrap_or(*camera_from_object)
    }
}

/// Step of a turn in [`Symmetries::canonical`], diameters.
const CANONICAL_STEP: f64 = 0.01;

/// The rotation by `fraction` of a full turn around a symmetry axis.
fn turn(symmetry: &ContinuousSymmetry, fraction: f64) -> Pose {
    let axis = Unit::new_normalize(symmetry.axis);
    let rotation = UnitQuaternion::from_axis_angle(&axis, std::f64::consts::TAU * fraction);
    let offset = symmetry.offset_m.coords;
    Pose::from_parts(Translation3::from(offset - rotation * offset), rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_turn_is_cut_as_bop_cuts_it() {
        let axis = ContinuousSymmetry { axis: Vector3::z(), offset_m: Point3::new(0.1, 0.0, 0.0) };
        let symmetries = Symmetries { discrete: vec![], continuous: vec![axis] };
        let transforms = symmetries.transforms(0.01);
        assert_eq!(transforms.len(), 315);
        for t in &transforms {
            assert!((t * Point3::new(0.1, 0.0, 0.3) - Point3::new(0.1, 0.0, 0.3)).norm() < 1e-12);
        }
    }

    #[test]
    fn equal_views_have_one_canonical_pose() {
        let half_turn = Pose::rotation(Vector3::z() * std::f64::consts::PI);
        let symmetries = Symmetries { discrete: vec![half_turn], continuous: vec![] };
        for i in 0..20 {
            let turn = UnitQuaternion::from_euler_angles(0.3 * f64::from(i), 1.1 * f64::from(i), 0.2);
            let pose = Pose::from_parts(Translation3::new(0.1, -0.2, 0.9), turn);
            let (one, other) = (symmetries.canonical(&pose), symmetries.canonical(&(pose * half_turn)));
            assert!((one.to_homogeneous() - other.to_homogeneous()).norm() < 1e-9, "{i}");
            let roll = Pose::rotation(Vector3::z() * 0.7);
            let rolled = symmetries.canonical(&(roll * pose));
            assert!((rolled.to_homogeneous() - (roll * one).to_homogeneous()).norm() < 1e-9, "{i}");
        }
    }

    #[test]
    fn identity_comes_first() {
        assert_eq!(Symmetries::default().transforms(0.01), vec![Pose::identity()]);
    }
}
