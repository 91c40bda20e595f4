//! Time of one training step of the refiner: `refiner_bench [size_px] [batch] [steps] [iterations]`, by default 128, 8, 10, 3; and of
//! RAFT-small (nano) on as many pairs in the same run.
#![allow(clippy::print_stdout, reason = "a bench prints its numbers")]

use pseudoflow_learning::{Device, FlowBatch, RefinerBatch, TrainConfig, TrainState};
use pseudoflow_network::{NetworkConfig, REFERENCE_CHANNELS, RefinerConfig, Weights};
use std::time::Instant;

/// Values in [-1, 1) from a fixed sequence.
fn noise(len: usize, seed: u64) -> Vec<f32> {
    let mut state = seed;
    (0..len)
        .map(|_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1 << 23) as f32 - 1.0
        })
        .collect()
}

/// Median time of a step after two others, ms.
fn median_ms(steps: usize, mut step: impl FnMut()) -> f64 {
    (0..2).for_each(|_| step());
    let mut times: Vec<f64> = (0..steps)
        .map(|_| {
            let start = Instant::now();
            step();
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<usize> = std::env::args().skip(1).map(|a| a.parse()).collect::<Result<_, _>>()?;
    let arg = |i: usize, default: usize| args.get(i).copied().unwrap_or(default);
    let (size, n, steps) = (arg(0, 128), arg(1, 8), arg(2, 10));
    let area = size * size;
    let (five, real) = (noise(n * REFERENCE_CHANNELS * area, 1), noise(n * 3 * area, 2));
    let (flow, visible) = (noise(n * 2 * area, 3), vec![1.0; n * area]);
    let config = RefinerConfig { size_px: size, iterations_train: arg(3, 3), ..RefinerConfig::default() };
    let batch = RefinerBatch { reference: &five, real: &real, flow: &flow, visible: &visible, n };
    let weights = Weights::random(&config, 1);
    let parameters: usize = weights.tensors().iter().map(|t| t.data.len()).sum();
    let mut state = TrainState::new(config, TrainConfig::new(1e-5, 1000), weights, &Device::flex())?;
    let mut failed = None;
    let ms = median_ms(steps, || failed = state.train_step(&batch).err().or(failed.take()));
    let rate = |ms: f64| 1e3 * n as f64 / ms;
    println!("refiner, {parameters} parameters, {size} px, {n} pairs: {ms:.1} ms, {:.1} pairs/s", rate(ms));
    let config = NetworkConfig { size_px: size, ..NetworkConfig::nano() };
    let three = &five[..n * 3 * area];
    let batch = FlowBatch { reference: three, real: &real, flow: &flow, mask: &visible, n };
    let weights = Weights::random(&config, 1);
    let mut state = TrainState::new(config, TrainConfig::new(1e-5, 1000), weights, &Device::flex())?;
    let ms = median_ms(steps.min(4), || failed = state.train_step(&batch).err().or(failed.take()));
    println!("RAFT-small, {size} px, {n} pairs: {ms:.1} ms, {:.1} pairs/s", rate(ms));
    failed.map_or(Ok(()), |error| Err(error.into()))
}
