use crate::Pose;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use rand::Rng;
use serde::{Deserialize, Serialize};

/// Random perturbation of a pose, in the camera's axes (docs/method.md, "Views" and "Synthetic pre-training").
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Jitter {
    /// Standard deviation of each Euler angle, radians.
    pub angle_rad: f64,
    /// The rotation is drawn again while its geodesic angle is over this, radians.
    pub max_angle_rad: f64,
    /// Standard deviation of x and y, metres.
    pub xy_m: f64,
    /// Standard deviation of z, metres.
    pub z_m: f64,
}

/// One draw from the standard normal distribution (Box-Muller; two uniform draws each, so that the stream of
/// random numbers has a fixed length).
pub fn standard_normal(rng: &mut impl Rng) -> f64 {
    let (u, v): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

impl Jitter {
    /// The jitter of the self-supervised views: 7.5 deg (limit 25), 5 % of the diameter in x and y, 10 % in z.
    #[must_use]
    pub fn views(diameter_m: f64) -> Self {
        Self {
            angle_rad: 7.5_f64.to_radians(),
            max_angle_rad: 25_f64.to_radians(),
            xy_m: 0.05 * diameter_m,
            z_m: 0.10 * diameter_m,
        }
    }

    /// A pose near `camera_from_object`.
    pub fn sample(&self, camera_from_object: &Pose, rng: &mut impl Rng) -> Pose {
        let rotation = self.sample_rotation(rng);
        let offset_m = Vector3::new(
            self.xy_m * standard_normal(rng),
            self.xy_m * standard_normal(rng),
            self.z_m * standard_normal(rng),
        );
        Pose::from_parts(
            Translation3::from(camera_from_object.translation.vector + offset_m),
            rotation * camera_from_object.rotation,
        )
    }

    fn sample_rotation(&self, rng: &mut impl Rng) -> UnitQuaternion<f64> {
        loop {
            let [roll, pitch, yaw]: [f64; 3] = std::array::from_fn(|_| self.angle_rad * standard_normal(rng));
            let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
            if rotation.angle() <= self.max_angle_rad {
                return rotation;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{SeedableRng, rngs::StdRng};

    #[test]
    fn jitter_has_the_stated_spread_and_limit() {
        let mut rng = StdRng::seed_from_u64(1);
        let jitter = Jitter::views(0.15);
        let at = Pose::translation(0.0, 0.0, 1.0);
        let n = 4000;
        let samples: Vec<Pose> = (0..n).map(|_| jitter.sample(&at, &mut rng)).collect();
        let std = |f: &dyn Fn(&Pose) -> f64| (samples.iter().map(|p| f(p).powi(2)).sum::<f64>() / f64::from(n)).sqrt();
        assert!((std(&|p| p.translation.x) / 0.0075 - 1.0).abs() < 0.05);
        assert!((std(&|p| p.translation.z - 1.0) / 0.015 - 1.0).abs() < 0.05);
        assert!(samples.iter().all(|p| p.rotation.angle() <= 25_f64.to_radians()));
    }
}
