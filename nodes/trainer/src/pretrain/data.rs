//! Batches, made by threads of their own while the network trains.

use super::PretrainConfig;
use crate::TrainerError;
use crate::synth::{Sample, SampleGenerator};
use pseudoflow_imaging::RgbImage;
use pseudoflow_network::FlowBatch;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Instant;

/// The pairs of one step as the network takes them.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Batch {
    pub(crate) size_px: usize,
    reference: Vec<f32>,
    real: Vec<f32>,
    flow: Vec<f32>,
    mask: Vec<f32>,
    n: usize,
}

impl Batch {
    fn new(size_px: usize, samples: &[Sample], hidden_weight: f32) -> Self {
        let mut batch = Self { size_px, reference: vec![], real: vec![], flow: vec![], mask: vec![], n: samples.len() };
        for sample in samples {
            push_planes(&mut batch.reference, &sample.reference);
            push_planes(&mut batch.real, &sample.real_like);
            (0..2).for_each(|axis| batch.flow.extend(sample.label.flow_px.iter().map(|f| f[axis])));
            let weight = |(visible, foreground): (&bool, &bool)| match (visible, foreground) {
                (true, _) => 1.0,
                (false, true) => hidden_weight,
                (false, false) => 0.0,
            };
            batch.mask.extend(sample.label.visible.iter().zip(&sample.label.foreground).map(weight));
        }
        batch
    }

    pub(crate) fn pairs(&self) -> usize {
        self.n
    }

    pub(crate) fn view(&self) -> FlowBatch<'_> {
        FlowBatch { reference: &self.reference, real: &self.real, flow: &self.flow, mask: &self.mask, n: self.n }
    }
}

/// Appends an image as three planes in [-1, 1].
pub(crate) fn push_planes(planes: &mut Vec<f32>, image: &RgbImage) {
    for channel in 0..3 {
        planes.extend(image.as_raw().iter().skip(channel).step_by(3).map(|v| f32::from(*v) / 127.5 - 1.0));
    }
}

/// Crop size and number of pairs of a step; a function of the configuration and the step.
pub(crate) fn plan(config: &PretrainConfig, network_size_px: usize, step: u64) -> (usize, usize) {
    let total: f64 = config.sizes.iter().map(|s| s.weight).sum();
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed ^ 0x5e1e_c7ed);
    rng.set_stream(step);
    let mut left = rng.random::<f64>() * total;
    let chosen = config.sizes.iter().find(|s| {
        left -= s.weight;
        left < 0.0
    });
    let size_px = chosen.or(config.sizes.last()).map_or(network_size_px, |s| s.size_px);
    let ratio = network_size_px as f64 / size_px as f64;
    (size_px, ((config.batch as f64 * ratio * ratio).round() as usize).max(1))
}

/// Samples of a step have indices from here on, whatever its batch size.
const INDICES_PER_STEP: u64 = 4096;

fn make(
    generator: &SampleGenerator,
    config: &PretrainConfig,
    size_px: usize,
    step: u64,
) -> Result<Batch, TrainerError> {
    let (size_px, pairs) = plan(config, size_px, step);
    let first = step * INDICES_PER_STEP;
    let samples: Vec<Sample> =
        (0..pairs as u64).map(|i| generator.sample(first + i, size_px as u32)).collect::<Result<_, _>>()?;
    Ok(Batch::new(size_px, &samples, config.hidden_weight as f32))
}

type Message = Result<Batch, TrainerError>;

/// Threads that make the batches of the steps to come, each thread every n-th step, at most two ahead.
pub(crate) struct Prefetch {
    channels: Vec<Receiver<Message>>,
    threads: Vec<JoinHandle<()>>,
    stop: std::sync::Arc<AtomicBool>,
    busy_us: std::sync::Arc<AtomicU64>,
}

impl Prefetch {
    pub(crate) fn start(generator: &SampleGenerator, config: &PretrainConfig, size_px: usize, first: u64) -> Self {
        let stop = std::sync::Arc::new(AtomicBool::new(false));
        let busy_us = std::sync::Arc::new(AtomicU64::new(0));
        let count = config.data_threads as u64;
        let (mut channels, mut threads) = (Vec::new(), Vec::new());
        for offset in 0..count {
            let (sender, receiver) = sync_channel(2);
            let (generator, config, stop, busy) = (generator.clone(), config.clone(), stop.clone(), busy_us.clone());
            threads.push(std::thread::spawn(move || {
                let steps = (first + offset..config.steps).step_by(count as usize);
                produce(&generator, &config, size_px, steps, &sender, &stop, &busy);
            }));
            channels.push(receiver);
        }
        Self { channels, threads, stop, busy_us }
    }

    /// The batch of the `nth` step since the start.
    pub(crate) fn next(&self, nth: u64) -> Result<Batch, TrainerError> {
        let channel = &self.channels[(nth % self.channels.len() as u64) as usize];
        channel.recv().unwrap_or(Err(TrainerError::DataThread))
    }

    /// Time that the threads spent making samples, seconds.
    pub(crate) fn busy_s(&self) -> f64 {
        self.busy_us.load(Ordering::Relaxed) as f64 * 1e-6
    }
}

fn produce(
    generator: &SampleGenerator,
    config: &PretrainConfig,
    size_px: usize,
    steps: impl Iterator<Item = u64>,
    sender: &SyncSender<Message>,
    stop: &AtomicBool,
    busy_us: &AtomicU64,
) {
    for step in steps {
        if stop.load(Ordering::Relaxed) {
            return;
        }
        let start = Instant::now();
        let batch = make(generator, config, size_px, step);
        busy_us.fetch_add(start.elapsed().as_micros() as u64, Ordering::Relaxed);
        let failed = batch.is_err();
        if sender.send(batch).is_err() || failed {
            return;
        }
    }
}

impl Drop for Prefetch {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.channels.clear(); // a thread that waits to send wakes up
        for thread in self.threads.drain(..) {
            if thread.join().is_err() {
                log::error!("a data thread panicked");
            }
        }
    }
}
