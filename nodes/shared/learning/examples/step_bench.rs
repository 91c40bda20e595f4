//! Time of one training step: `step_bench [network.yaml] [batch] [steps]`, by default nano, 4, 20.
//!
//! Prints the median in ms and steps per minute. `tests/compare/train_step_vs_pytorch.py` runs it beside PyTorch.
#![allow(clippy::print_stdout, reason = "a bench prints its numbers")]

use pseudoflow_learning::{Device, FlowBatch, TrainConfig, TrainState};
use pseudoflow_network::{NetworkConfig, Weights};
use std::path::Path;
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

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let config = match args.first() {
        Some(path) => NetworkConfig::from_yaml_file(Path::new(path))?,
        None => NetworkConfig::nano(),
    };
    let n: usize = args.get(1).map_or(Ok(4), |a| a.parse())?;
    let steps: usize = args.get(2).map_or(Ok(20), |a| a.parse())?;
    let area = config.size_px * config.size_px;
    let (reference, real) = (noise(n * 3 * area, 1), noise(n * 3 * area, 2));
    let (flow, mask) = (noise(n * 2 * area, 3), vec![1.0; n * area]);
    let batch = FlowBatch { reference: &reference, real: &real, flow: &flow, mask: &mask, n };
    let weights = Weights::random(&config, 1);
    let mut state = TrainState::new(config.clone(), TrainConfig::new(1e-5, 1000), weights, &Device::flex())?;
    for _ in 0..3 {
        state.train_step(&batch)?;
    }
    let mut times_ms: Vec<f64> = Vec::new();
    for _ in 0..steps {
        let start = Instant::now();
        state.train_step(&batch)?;
        times_ms.push(start.elapsed().as_secs_f64() * 1e3);
    }
    times_ms.sort_by(f64::total_cmp);
    let (median, best) = (times_ms[times_ms.len() / 2], times_ms[0]);
    println!(
        "{} {} px, {} iterations, batch {n}: median {median:.1} ms, best {best:.1} ms, {:.0} steps a minute",
        config.name,
        config.size_px,
        config.iterations_train,
        60e3 / median
    );
    Ok(())
}
