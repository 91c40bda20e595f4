//! AdamW, the one-cycle schedule and clipping by the global norm, on plain named tensors.
//!
//! burn's optimiser clips each tensor by itself and has no one-cycle schedule; here the state is plain data, so that a
//! checkpoint resumes with the same bits.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Learning rate: linear from `max_lr / 25` to `max_lr` over the first 5 % of the steps, then linear to
/// `max_lr / 250,000` at the last one (PyTorch's OneCycleLR with `anneal_strategy="linear"`).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OneCycle {
    /// Highest learning rate.
    pub max_lr: f64,
    /// Steps of the whole run.
    pub total_steps: u64,
    /// Share of the steps that warm up.
    pub warm_up: f64,
}

impl OneCycle {
    /// Warm-up of 5 % as in the paper.
    pub fn new(max_lr: f64, total_steps: u64) -> Self {
        Self { max_lr, total_steps, warm_up: 0.05 }
    }

    /// Rate of a step, counted from 0; steps after the last get its rate.
    pub fn lr(&self, step: u64) -> f64 {
        let (initial, last) = (self.max_lr / 25.0, self.max_lr / 25.0 / 1e4);
        let peak = (self.warm_up * self.total_steps as f64 - 1.0).max(0.0);
        let end = (self.total_steps as f64 - 1.0).max(peak + 1.0);
        let step = (step as f64).min(end);
        let between = |a: f64, b: f64, t: f64| a + (b - a) * t;
        if step <= peak && peak > 0.0 {
            between(initial, self.max_lr, step / peak)
        } else {
            between(self.max_lr, last, (step - peak) / (end - peak))
        }
    }
}

/// Learning rate of a training that may go on at any time: linear from 0 to `max_lr` over the first steps, then constant, then
/// linear to 0 over the last `cool_down` steps, if any. A training that is to go on starts again from before its cool-down.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plateau {
    /// The constant learning rate.
    pub max_lr: f64,
    /// Steps of the whole run, those of the cool-down included.
    pub total_steps: u64,
    /// Steps over which the rate rises.
    pub warm_up: u64,
    /// Steps at the end over which the rate falls.
    pub cool_down: u64,
}

impl Plateau {
    /// Rate of a step, counted from 0.
    pub fn lr(&self, step: u64) -> f64 {
        let rise = (step + 1) as f64 / self.warm_up.max(1) as f64;
        let left = self.total_steps.saturating_sub(step) as f64 / (self.cool_down + 1) as f64;
        self.max_lr * rise.min(left).min(1.0)
    }
}

/// How the learning rate changes over a run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Schedule {
    /// Rises and falls over a number of steps that is known beforehand.
    OneCycle(OneCycle),
    /// Stays constant until a cool-down at the end.
    Plateau(Plateau),
}

impl Schedule {
    /// Rate of a step, counted from 0.
    pub fn lr(&self, step: u64) -> f64 {
        match self {
            Self::OneCycle(schedule) => schedule.lr(step),
            Self::Plateau(schedule) => schedule.lr(step),
        }
    }
}

/// AdamW's constants.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdamWConfig {
    /// Decay of the mean gradient.
    pub beta1: f32,
    /// Decay of the mean squared gradient.
    pub beta2: f32,
    /// Added to the root of the squared gradient.
    pub epsilon: f32,
    /// Decoupled weight decay.
    pub weight_decay: f32,
}

impl Default for AdamWConfig {
    /// (0.9, 0.999), 1e-8, weight decay 1e-4: the paper.
    fn default() -> Self {
        Self { beta1: 0.9, beta2: 0.999, epsilon: 1e-8, weight_decay: 1e-4 }
    }
}

/// Running means of one tensor's gradient.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Moments {
    pub(crate) mean: Vec<f32>,
    pub(crate) square: Vec<f32>,
}

impl Moments {
    pub(crate) fn zeros(len: usize) -> Self {
        Self { mean: vec![0.0; len], square: vec![0.0; len] }
    }
}

/// One AdamW step on one tensor (Loshchilov and Hutter, "Decoupled Weight Decay Regularization", algorithm 2);
/// `taken` counts the steps before this one. The gradient is first multiplied by `scale`.
pub(crate) fn adamw(
    config: &AdamWConfig,
    taken: u64,
    lr: f64,
    values: &mut [f32],
    grad: &[f32],
    scale: f32,
    moments: &mut Moments,
) {
    let exponent = taken as f64 + 1.0;
    let correction1 = 1.0 - f64::from(config.beta1).powf(exponent);
    let correction2 = 1.0 - f64::from(config.beta2).powf(exponent);
    let rate = (lr / correction1) as f32;
    let root = (1.0 / correction2.sqrt()) as f32;
    let keep = (1.0 - lr * f64::from(config.weight_decay)) as f32;
    let (b1, b2) = (config.beta1, config.beta2);
    for i in 0..values.len() {
        let g = grad[i] * scale;
        let mean = b1 * moments.mean[i] + (1.0 - b1) * g;
        let square = b2 * moments.square[i] + (1.0 - b2) * g * g;
        values[i] = keep * values[i] - rate * mean / (square.sqrt() * root + config.epsilon);
        moments.mean[i] = mean;
        moments.square[i] = square;
    }
}

/// Euclidean norm over all tensors, summed in order in f64.
pub(crate) fn global_norm(grads: &[Vec<f32>]) -> f64 {
    let sums: Vec<f64> = grads.par_iter().map(|g| g.iter().map(|&v| f64::from(v) * f64::from(v)).sum()).collect();
    sums.iter().sum::<f64>().sqrt()
}

/// Factor that brings a norm down to `max_norm` (PyTorch's `clip_grad_norm_`).
pub(crate) fn clip_scale(norm: f64, max_norm: f64) -> f32 {
    (max_norm / (norm + 1e-6)).min(1.0) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schedule_has_the_published_corners() {
        let schedule = OneCycle::new(4e-4, 1000);
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
        close(schedule.lr(0), 4e-4 / 25.0);
        close(schedule.lr(49), 4e-4);
        close(schedule.lr(999), 4e-4 / 250_000.0);
        close(schedule.lr(5000), 4e-4 / 250_000.0);
        assert!(schedule.lr(48) < 4e-4 && schedule.lr(50) < 4e-4);
        assert!(OneCycle::new(1e-3, 1).lr(0).is_finite());
    }

    #[test]
    fn plateau_rises_stays_and_cools_down() {
        let plateau = Plateau { max_lr: 2.0, total_steps: 100, warm_up: 10, cool_down: 19 };
        assert_eq!([plateau.lr(0), plateau.lr(4), plateau.lr(9), plateau.lr(50)], [0.2, 1.0, 2.0, 2.0]);
        assert_eq!([plateau.lr(80), plateau.lr(90), plateau.lr(99), plateau.lr(100)], [2.0, 1.0, 0.1, 0.0]);
        let forever = Plateau { cool_down: 0, ..plateau };
        assert_eq!(forever.lr(99), 2.0);
        let text = serde_json::to_string(&Schedule::Plateau(plateau)).unwrap();
        assert_eq!(serde_json::from_str::<Schedule>(&text).unwrap(), Schedule::Plateau(plateau));
        let text = serde_json::to_string(&OneCycle::new(1.0, 5)).unwrap();
        assert_eq!(serde_json::from_str::<Schedule>(&text).unwrap(), Schedule::OneCycle(OneCycle::new(1.0, 5)));
    }

    /// Numbers from torch.optim.AdamW(lr=0.1, weight_decay=0.01) on p = [1, -2], gradients [0.5, -1] then [-0.25, 3].
    #[test]
    fn adamw_equals_pytorch() {
        let config = AdamWConfig { weight_decay: 0.01, ..AdamWConfig::default() };
        let mut moments = Moments::zeros(2);
        let mut p = [1.0, -2.0];
        adamw(&config, 0, 0.1, &mut p, &[0.5, -1.0], 1.0, &mut moments);
        assert!((p[0] - 0.899).abs() < 1e-6 && (p[1] + 1.898).abs() < 1e-6, "{p:?}");
        adamw(&config, 1, 0.1, &mut p, &[-0.25, 3.0], 1.0, &mut moments);
        // By hand: m = 0.02, v = 3.1225e-4 and m = 0.21, v = 9.999e-3, corrections 0.19 and 0.001999.
        let expected = [
            0.899 * 0.999 - 0.1 * (0.02 / 0.19) / (3.1225e-4_f64 / 0.001_999).sqrt(),
            -1.898 * 0.999 - 0.1 * (0.21 / 0.19) / (9.999e-3_f64 / 0.001_999).sqrt(),
        ];
        assert!((f64::from(p[0]) - expected[0]).abs() < 1e-6 && (f64::from(p[1]) - expected[1]).abs() < 1e-6, "{p:?}");
    }

    #[test]
    fn clipping_is_global() {
        let grads = vec![vec![3.0], vec![0.0, 4.0]];
        let norm = global_norm(&grads);
        assert_eq!(norm, 5.0);
        assert!((clip_scale(norm, 1.0) - 0.2).abs() < 1e-6);
        assert_eq!(clip_scale(0.5, 1.0), 1.0);
    }
}
