//! The poses that synthetic refinements start from.

use nalgebra::{Unit, UnitQuaternion, Vector3};
use pseudoflow_geometry::{Jitter, Pose};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// Poses as they come before a refinement, and how often each kind is drawn. A gate that only knows poses near the truth
/// believes in whatever looks alike: it must have seen tracked poses and wrong ones too.
const KINDS: [(f64, Start); 6] = [
    // What a network trained on synthetic images gives (docs/method.md), then wider.
    (0.4, Start::Near { angle_deg: 9.0, xy_diameters: 0.03, z_diameters: 0.14 }),
    (0.15, Start::Near { angle_deg: 15.0, xy_diameters: 0.07, z_diameters: 0.2 }),
    // A second pass, or a tracked object.
    (0.15, Start::Near { angle_deg: 4.0, xy_diameters: 0.015, z_diameters: 0.05 }),
    (0.1, Start::Near { angle_deg: 1.5, xy_diameters: 0.005, z_diameters: 0.015 }),
    // What searches and lost tracks leave behind.
    (0.1, Start::Turned),
    (0.1, Start::Elsewhere),
];

/// A pose before the refinement, from the true one.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Start {
    /// Normal jitter: degrees about each axis, diameters in x and y, diameters in z.
    Near { angle_deg: f64, xy_diameters: f64, z_diameters: f64 },
    /// Half a turn about an axis of the object, then jitter: bottles and boxes are found that way.
    Turned,
    /// Any rotation, half a diameter to two beside the object.
    Elsewhere,
}

/// The jitter that goes with a wrong pose.
const BESIDE: Start = Start::Near { angle_deg: 6.0, xy_diameters: 0.03, z_diameters: 0.08 };
const MAX_ANGLE_DEG: f64 = 60.0;

/// A pose that a refinement may start from, of an object of this diameter (metres).
pub(super) fn draw_start(truth: &Pose, diameter_m: f64, rng: &mut ChaCha8Rng) -> Pose {
    let mut left: f64 = rng.random();
    let kind = KINDS.iter().find(|(weight, _)| {
        left -= weight;
        left < 0.0
    });
    kind.map_or(KINDS[0].1, |(_, start)| *start).pose(truth, diameter_m, rng)
}

impl Start {
    fn pose(self, truth: &Pose, diameter_m: f64, rng: &mut ChaCha8Rng) -> Pose {
        match self {
            Self::Near { angle_deg, xy_diameters, z_diameters } => {
                let jitter = Jitter {
                    angle_rad: angle_deg.to_radians(),
                    max_angle_rad: MAX_ANGLE_DEG.to_radians(),
                    xy_m: xy_diameters * diameter_m,
                    z_m: z_diameters * diameter_m,
                };
                jitter.sample(truth, rng)
            }
            Self::Turned => {
                let axis = [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()][rng.random_range(0..3)];
                let mut turned = *truth;
                turned.rotation *= UnitQuaternion::from_axis_angle(&axis, std::f64::consts::PI);
                BESIDE.pose(&turned, diameter_m, rng)
            }
            Self::Elsewhere => {
                let mut there = *truth;
                there.rotation = UnitQuaternion::from_axis_angle(&direction(rng), rng.random_range(0.0..3.1));
                let beside = direction(rng).into_inner() * rng.random_range(0.5..2.0) * diameter_m;
                // No nearer to the camera than the object is by half: the crop must still hold it.
                there.translation.vector += beside.map(|c| c.max(-0.5 * truth.translation.z));
                there
            }
        }
    }
}

/// A direction, all equally likely.
fn direction(rng: &mut ChaCha8Rng) -> Unit<Vector3<f64>> {
    loop {
        let v = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
        if (0.01..1.0).contains(&v.norm()) {
            return Unit::new_normalize(v);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_geometry::rotation_angle_rad;
    use rand::SeedableRng;

    #[test]
    fn starts_are_of_all_kinds() {
        assert!((KINDS.iter().map(|k| k.0).sum::<f64>() - 1.0).abs() < 1e-12);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let truth = Pose::translation(0.1, 0.0, 0.8);
        for _ in 0..50 {
            let turned = Start::Turned.pose(&truth, 0.2, &mut rng);
            assert!(rotation_angle_rad(&turned, &truth) > 2.0);
            let elsewhere = Start::Elsewhere.pose(&truth, 0.2, &mut rng);
            let beside_m = (elsewhere.translation.vector - truth.translation.vector).norm();
            assert!((0.099..=0.401).contains(&beside_m) && elsewhere.translation.z > 0.3);
        }
    }
}
