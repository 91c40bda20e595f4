//! Draws that the scene needs. Every sample owns one stream, so that it depends on (seed, index) alone.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use pseudoflow_geometry::standard_normal;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The random stream of sample `index`.
pub(super) fn stream(seed: u64, index: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(index);
    rng
}

/// The shapes of randomness used by the scene.
pub(super) trait Draw: Rng + Sized {
    /// Uniform in `[low, high)`.
    fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.random::<f64>()
    }

    /// Uniform in `[low, high)`, single precision.
    fn uniform32(&mut self, low: f32, high: f32) -> f32 {
        self.uniform(f64::from(low), f64::from(high)) as f32
    }

    /// Uniform in the logarithm, in `[low, high)`.
    fn log_uniform(&mut self, low: f64, high: f64) -> f64 {
        self.uniform(low.ln(), high.ln()).exp()
    }

    /// [`Draw::log_uniform`], single precision.
    fn log_uniform32(&mut self, low: f32, high: f32) -> f32 {
        self.log_uniform(f64::from(low), f64::from(high)) as f32
    }

    /// True with probability `p`.
    fn chance(&mut self, p: f64) -> bool {
        self.random::<f64>() < p
    }

    /// Standard normal, single precision.
    fn normal32(&mut self) -> f32 {
        standard_normal(self) as f32
    }

    /// An index below `count`.
    fn below(&mut self, count: usize) -> usize {
        ((self.random::<f64>() * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// A rotation, uniform over SO(3) (a normalised 4D normal vector).
    fn rotation(&mut self) -> UnitQuaternion<f64> {
        let [w, i, j, k]: [f64; 4] = std::array::from_fn(|_| standard_normal(self));
        UnitQuaternion::new_normalize(Quaternion::new(w + 1e-12, i, j, k))
    }

    /// A direction, uniform over the sphere.
    fn direction(&mut self) -> Vector3<f32> {
        let v = Vector3::new(self.normal32(), self.normal32(), self.normal32() + 1e-9);
        v.normalize()
    }

    /// An sRGB colour (0 to 1): any hue, saturation up to `max_saturation` (low ones likelier), value in a range.
    fn colour(&mut self, max_saturation: f32, value: (f32, f32)) -> [f32; 3] {
        let saturation = max_saturation * self.random::<f32>().powf(1.3);
        hsv_to_rgb([self.random::<f32>() * 6.0, saturation, self.uniform32(value.0, value.1)])
    }
}

impl<R: Rng + Sized> Draw for R {}

/// Hue in `[0, 6)`, saturation and value in `[0, 1]` to RGB in `[0, 1]`.
pub(super) fn hsv_to_rgb([hue, saturation, value]: [f32; 3]) -> [f32; 3] {
    [5.0, 3.0, 1.0].map(|n: f32| {
        let k = (n + hue).rem_euclid(6.0);
        value - value * saturation * k.min(4.0 - k).clamp(0.0, 1.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_are_reproducible_and_differ() {
        let first = |seed, index| stream(seed, index).random::<u64>();
        assert_eq!(first(3, 7), first(3, 7));
        assert_ne!(first(3, 7), first(3, 8));
        assert_ne!(first(3, 7), first(4, 7));
    }

    #[test]
    fn pure_hues_come_out_right() {
        assert_eq!(hsv_to_rgb([0.0, 1.0, 1.0]), [1.0, 0.0, 0.0]);
        assert_eq!(hsv_to_rgb([2.0, 1.0, 0.5]), [0.0, 0.5, 0.0]);
        assert_eq!(hsv_to_rgb([4.0, 0.0, 0.7]), [0.7, 0.7, 0.7]);
    }
}
