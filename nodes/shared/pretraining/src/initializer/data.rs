//! Batches of examples, made by threads of their own while the network trains. Scenes are rendered block by block; each
//! block is used several times in changing order.

use super::InitializerTraining;
use super::augment::{Example, example};
use crate::PretrainError;
use pseudoflow_imaging::ObjectSet;
use pseudoflow_learning::SceneTruth;
use pseudoflow_network::Grid;
use pseudoflow_synthetic::{SceneGenerator, SceneSample};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Instant;

/// The examples of one step as the network takes them.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Batch {
    /// (n, 3, H, W) in [-1, 1].
    pub(crate) images: Vec<f32>,
    pub(crate) truth: Vec<SceneTruth>,
}

impl Batch {
    fn new(examples: Vec<Example>) -> Self {
        let mut batch = Self { images: Vec::new(), truth: Vec::new() };
        for example in examples {
            crate::pretrain::push_planes(&mut batch.images, &example.image);
            batch.truth.push(example.truth);
        }
        batch
    }
}

/// What makes examples.
#[derive(Clone)]
pub(crate) struct Source {
    pub(crate) generator: SceneGenerator,
    pub(crate) objects: Arc<ObjectSet>,
    pub(crate) grid: Grid,
    pub(crate) config: InitializerTraining,
}

impl Source {
    fn steps_in_block(&self) -> u64 {
        self.config.uses * self.config.block / self.config.batch as u64
    }

    /// The batch of a step from the scenes of its block.
    fn batch(&self, scenes: &[SceneSample], step: u64) -> Batch {
        let (batch, steps) = (self.config.batch as u64, self.steps_in_block());
        let first = step % steps * batch;
        let order = self.order(step / steps, first / self.config.block);
        let examples = (0..batch).map(|i| {
            let scene = &scenes[order[((first + i) % self.config.block) as usize]];
            example(scene, &self.objects, &self.grid, &mut self.rng("example", step * batch + i))
        });
        Batch::new(examples.collect())
    }

    /// The order of a block's scenes in its n-th use.
    fn order(&self, block: u64, nth: u64) -> Vec<usize> {
        let mut rng = self.rng("order", block * self.config.uses + nth);
        let mut order: Vec<usize> = (0..self.config.block as usize).collect();
        (1..order.len()).rev().for_each(|i| order.swap(i, rng.random_range(0..=i)));
        order
    }

    fn rng(&self, what: &str, index: u64) -> ChaCha8Rng {
        let salt = what.bytes().fold(0_u64, |h, b| h.wrapping_mul(31).wrapping_add(u64::from(b)));
        let mut rng = ChaCha8Rng::seed_from_u64(self.config.seed.wrapping_add(salt << 20));
        rng.set_stream(index);
        rng
    }
}

type Scene = Result<SceneSample, PretrainError>;

/// The threads; they end when this is dropped.
pub(crate) struct Prefetch {
    batches: Receiver<Result<Batch, PretrainError>>,
    busy_us: Arc<AtomicU64>,
}

impl Prefetch {
    /// Makes the batches from step `first` on.
    pub(crate) fn start(source: &Source, first: u64) -> Self {
        let threads = source.config.data_threads as u64;
        let first_scene = first / source.steps_in_block() * source.config.block;
        let busy_us = Arc::new(AtomicU64::new(0));
        // A block is made while the one before is used.
        let room = (source.config.block / threads).max(1) as usize;
        let scenes = (0..threads).map(|offset| {
            let (sender, receiver) = sync_channel(room);
            let (generator, busy) = (source.generator.clone(), Arc::clone(&busy_us));
            std::thread::spawn(move || {
                render(&generator, (first_scene + offset..).step_by(threads as usize), &sender, &busy);
            });
            receiver
        });
        let scenes: Vec<Receiver<Scene>> = scenes.collect();
        let (sender, batches) = sync_channel(2);
        let source = source.clone();
        std::thread::spawn(move || {
            // The receiver is gone when the training has ended; its error has been sent.
            let _ = assemble(&source, first, &scenes, &sender);
        });
        Self { batches, busy_us }
    }

    pub(crate) fn next(&self) -> Result<Batch, PretrainError> {
        self.batches.recv().unwrap_or(Err(PretrainError::DataThread))
    }

    /// Time that the threads spent rendering, seconds.
    pub(crate) fn busy_s(&self) -> f64 {
        self.busy_us.load(Ordering::Relaxed) as f64 * 1e-6
    }
}

/// Renders scenes until nobody wants them.
fn render(
    generator: &SceneGenerator,
    indices: impl Iterator<Item = u64>,
    sender: &SyncSender<Scene>,
    busy_us: &AtomicU64,
) {
    for index in indices {
        let start = Instant::now();
        let scene = generator.scene(index).map_err(PretrainError::from);
        busy_us.fetch_add(start.elapsed().as_micros() as u64, Ordering::Relaxed);
        let failed = scene.is_err();
        if sender.send(scene).is_err() || failed {
            return;
        }
    }
}

/// Nobody takes the batches any more.
struct Unwanted;

fn assemble(
    source: &Source,
    first: u64,
    scenes: &[Receiver<Scene>],
    sender: &SyncSender<Result<Batch, PretrainError>>,
) -> Result<(), Unwanted> {
    let mut block: Vec<SceneSample> = Vec::new();
    // The threads take turns, whatever the length of a block.
    let mut threads = scenes.iter().cycle();
    for step in first..source.config.steps {
        if block.is_empty() || step.is_multiple_of(source.steps_in_block()) {
            block.clear();
            for thread in threads.by_ref().take(source.config.block as usize) {
                match thread.recv().unwrap_or(Err(PretrainError::DataThread)) {
                    Ok(scene) => block.push(scene),
                    Err(error) => return sender.send(Err(error)).map_err(|_| Unwanted),
                }
            }
        }
        sender.send(Ok(source.batch(&block, step))).map_err(|_| Unwanted)?;
    }
    Ok(())
}
