//! Batches, made by threads of their own while the network trains.

use super::pose_loss::PoseLoss;
use super::{PretrainConfig, SizeShare};
use crate::PretrainError;
use pseudoflow_imaging::RgbImage;
use pseudoflow_learning::{FlowBatch, RefinerBatch};
use pseudoflow_network::{REFERENCE_CHANNELS, reference_geometry};
use pseudoflow_synthetic::{Sample, SampleGenerator};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Instant;

/// The pairs of one step as the network takes them: planes of `size x size`, row-major, pair after pair. Everything but
/// `real` lies on the pixels of the reference.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Batch {
    pub(crate) size_px: usize,
    /// `n x 5` planes: colours in [-1, 1] and [`reference_geometry`]; or, without geometry, the three colours.
    reference: Vec<f32>,
    /// `n x 3` planes in [-1, 1].
    real: Vec<f32>,
    /// `n x 2` planes, pixels; on all foreground.
    flow: Vec<f32>,
    /// `n` planes: weight of the flow loss.
    mask: Vec<f32>,
    /// `n` planes: 1 where the surface point is seen in the real crop, 0 where it is hidden, -1 in the background.
    visible: Vec<f32>,
    n: usize,
    /// What the poses that the flows say are judged by, where they are.
    pub(crate) pose_loss: Option<PoseLoss>,
}

impl Batch {
    pub(crate) fn new(size_px: usize, samples: &[&Sample], hidden_weight: f32, geometry: bool) -> Self {
        let planes = |count: usize| Vec::with_capacity(samples.len() * count * size_px * size_px);
        let mut batch = Self {
            size_px,
            reference: planes(if geometry { REFERENCE_CHANNELS } else { 3 }),
            real: planes(3),
            flow: planes(2),
            mask: planes(1),
            visible: planes(1),
            n: samples.len(),
            pose_loss: None,
        };
        samples.iter().for_each(|sample| batch.push(sample, hidden_weight, geometry));
        batch
    }

    fn push(&mut self, sample: &Sample, hidden_weight: f32, geometry: bool) {
        let label = &sample.label;
        push_planes(&mut self.reference, &sample.reference);
        if geometry {
            let (start, focal_px) = (self.reference.len(), (sample.intrinsics.fx + sample.intrinsics.fy) / 2.0);
            self.reference.resize(start + 2 * label.depth_m.len(), 0.0);
            reference_geometry(&label.depth_m, self.size_px, focal_px, &mut self.reference[start..]);
        }
        push_planes(&mut self.real, &sample.real_like);
        (0..2).for_each(|axis| self.flow.extend(label.flow_px.iter().map(|f| f[axis])));
        let each = || label.visible.iter().zip(&label.foreground);
        let weigh = |seen: f32, hidden: f32, background: f32| {
            each().map(move |(visible, foreground)| match (visible, foreground) {
                (true, _) => seen,
                (false, true) => hidden,
                (false, false) => background,
            })
        };
        self.mask.extend(weigh(1.0, hidden_weight, 0.0));
        self.visible.extend(weigh(1.0, 0.0, -1.0));
    }

    /// With a loss of the poses that the flows say; a weight of 0 is none.
    fn judged_by_poses(self, samples: &[&Sample], weight: f64) -> Self {
        Self { pose_loss: (weight > 0.0).then(|| PoseLoss::new(samples, weight)), ..self }
    }

    pub(crate) fn pairs(&self) -> usize {
        self.n
    }

    pub(crate) fn view(&self) -> FlowBatch<'_> {
        FlowBatch { reference: &self.reference, real: &self.real, flow: &self.flow, mask: &self.mask, n: self.n }
    }

    pub(crate) fn refiner_view(&self) -> RefinerBatch<'_> {
        let Self { reference, real, flow, visible, n, .. } = self;
        RefinerBatch { reference, real, flow, visible, n: *n }
    }
}

/// Appends an image as three planes in [-1, 1].
pub(crate) fn push_planes(planes: &mut Vec<f32>, image: &RgbImage) {
    for channel in 0..3 {
        planes.extend(image.as_raw().iter().skip(channel).step_by(3).map(|v| f32::from(*v) / 127.5 - 1.0));
    }
}

/// Crop size and number of pairs of a step; a function of the configuration and the step.
#[cfg(test)]
pub(crate) fn plan(config: &PretrainConfig, network_size_px: usize, step: u64) -> (usize, usize) {
    Schedule::new(config, network_size_px).unwrap().plan(step)
}

/// For each of the first steps, the scenes and pairs that it uses.
#[cfg(test)]
pub(crate) fn uses(config: &PretrainConfig, network_size_px: usize, steps: u64) -> Vec<Vec<(u64, usize)>> {
    let schedule = Schedule::new(config, network_size_px).unwrap();
    let of = |step| schedule.pairs(step).iter().map(|(scene, pair)| (scene.index(), *pair)).collect();
    (0..steps).map(of).collect()
}

/// Which scenes serve which step. Steps come in blocks of one crop size, each made from scenes of its own. In a block of
/// [`PARTS`] parts every part has as many scenes as a step has pairs, and a step takes one pair of each scene of one part; the
/// parts take turns. So the pairs of a step show different scenes, and a scene's pairs are spread over the block.
#[derive(Debug, Clone)]
pub(crate) struct Schedule {
    sizes: Vec<SizeShare>,
    network_size_px: usize,
    batch: usize,
    seed: u64,
    pairs_per_scene: u64,
}

/// Parts of a block.
const PARTS: u64 = 2;
/// Scenes of a block have indices from here on, whatever its batch size.
const INDICES_PER_BLOCK: u64 = 65_536;

impl Schedule {
    pub(crate) fn new(config: &PretrainConfig, network_size_px: usize) -> Result<Self, PretrainError> {
        Ok(Self {
            sizes: config.size_shares()?,
            network_size_px,
            batch: config.batch,
            seed: config.seed,
            pairs_per_scene: config.synth.pairs_per_scene as u64,
        })
    }

    /// Pairs of the first steps together.
    pub(crate) fn pairs_until(&self, steps: u64) -> u64 {
        let each = self.steps_per_block();
        let of_block = |block: u64| each.min(steps - block * each) * self.plan_of_block(block).1 as u64;
        (0..steps.div_ceil(each)).map(of_block).sum()
    }

    fn steps_per_block(&self) -> u64 {
        PARTS * self.pairs_per_scene
    }

    /// Crop size and number of pairs of a step.
    fn plan(&self, step: u64) -> (usize, usize) {
        self.plan_of_block(step / self.steps_per_block())
    }

    fn plan_of_block(&self, block: u64) -> (usize, usize) {
        let total: f64 = self.sizes.iter().map(|s| s.weight).sum();
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed ^ 0x5e1e_c7ed);
        rng.set_stream(block);
        let mut left = rng.random::<f64>() * total;
        let chosen = self.sizes.iter().find(|s| {
            left -= s.weight;
            left < 0.0
        });
        let size_px = chosen.or(self.sizes.last()).map_or(self.network_size_px, |s| s.size_px);
        let ratio = self.network_size_px as f64 / size_px as f64;
        (size_px, ((self.batch as f64 * ratio * ratio).round() as usize).max(1))
    }

    /// The scenes of a step and which pair it takes of each.
    fn pairs(&self, step: u64) -> Vec<(Scene, usize)> {
        let (block, slot) = (step / self.steps_per_block(), step % self.steps_per_block());
        let (part, turn) = (slot % PARTS, slot / PARTS);
        let (size_px, pairs) = self.plan_of_block(block);
        let scene = |j: u64| Scene { block, number: part * pairs as u64 + j, size_px };
        (0..pairs as u64).map(|j| (scene(j), ((turn + j) % self.pairs_per_scene) as usize)).collect()
    }

    /// The scenes of a block in the order in which they are needed.
    fn scenes(&self, block: u64) -> impl Iterator<Item = Scene> + use<> {
        let (size_px, pairs) = self.plan_of_block(block);
        (0..PARTS * pairs as u64).map(move |number| Scene { block, number, size_px })
    }
}

/// A scene by its block and its number there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Scene {
    block: u64,
    number: u64,
    size_px: usize,
}

impl Scene {
    fn index(&self) -> u64 {
        self.block * INDICES_PER_BLOCK + self.number
    }
}

/// Threads that make the scenes of the steps to come: those of the block in use and of the next. The batches do not depend on
/// how many threads there are.
pub(crate) struct Prefetch {
    shared: Arc<Shared>,
    schedule: Schedule,
    hidden_weight: f32,
    pose_weight: f64,
    geometry: bool,
    first: u64,
    threads: Vec<JoinHandle<()>>,
}

struct Shared {
    state: Mutex<State>,
    /// Told when a scene was made or taken away, or all must stop.
    changed: Condvar,
    busy_us: AtomicU64,
    made: AtomicU64,
}

struct State {
    /// Scenes not yet begun, in order: of `block` those from `todo` on.
    block: u64,
    todo: VecDeque<Scene>,
    /// The block of the step in use.
    in_use: u64,
    last_block: u64,
    done: BTreeMap<Scene, Result<Vec<Sample>, PretrainError>>,
    stop: bool,
    /// Threads that ended other than by `stop` or by running out of work.
    dead: bool,
}

/// Blocks that are made ahead of the one in use.
const AHEAD: u64 = 1;

impl Prefetch {
    /// `geometry`: whether references come with their depth.
    pub(crate) fn start(
        generator: &SampleGenerator,
        config: &PretrainConfig,
        size_px: usize,
        geometry: bool,
        first: u64,
    ) -> Result<Self, PretrainError> {
        let schedule = Schedule::new(config, size_px)?;
        let block = first / schedule.steps_per_block();
        let state = State {
            block,
            todo: schedule.scenes(block).collect(),
            in_use: block,
            last_block: config.steps.saturating_sub(1) / schedule.steps_per_block(),
            done: BTreeMap::new(),
            stop: false,
            dead: false,
        };
        let shared = Arc::new(Shared {
            state: Mutex::new(state),
            changed: Condvar::new(),
            busy_us: AtomicU64::new(0),
            made: AtomicU64::new(0),
        });
        let spawn = |_| {
            let (shared, schedule, generator) = (shared.clone(), schedule.clone(), generator.clone());
            std::thread::spawn(move || {
                let mut guard = Guard { shared: &shared, finished: false };
                while let Some(scene) = shared.next_scene(&schedule) {
                    shared.make(&generator, scene);
                }
                guard.finished = true;
            })
        };
        let threads = (0..config.data_threads).map(spawn).collect();
        let (hidden_weight, pose_weight) = (config.hidden_weight as f32, config.pose_weight);
        Ok(Self { shared, schedule, hidden_weight, pose_weight, geometry, first, threads })
    }

    /// The batch of the `nth` step since the start. Steps must be asked for in order.
    pub(crate) fn next(&self, nth: u64) -> Result<Batch, PretrainError> {
        let step = self.first + nth;
        let pairs = self.schedule.pairs(step);
        let block = step / self.schedule.steps_per_block();
        let mut state = self.shared.lock();
        if block > state.in_use {
            state.in_use = block;
            state.done.retain(|scene, _| scene.block >= block);
            self.shared.changed.notify_all();
        }
        loop {
            if let Some((scene, _)) = pairs.iter().find(|(scene, _)| matches!(state.done.get(scene), Some(Err(_)))) {
                return Err(state.done.remove(scene).and_then(Result::err).unwrap_or(PretrainError::DataThread));
            }
            let made = |(scene, pair): &(Scene, usize)| match state.done.get(scene) {
                Some(Ok(samples)) => samples.get(*pair),
                _ => None,
            };
            if let Some(samples) = pairs.iter().map(made).collect::<Option<Vec<_>>>() {
                let batch = Batch::new(self.schedule.plan(step).0, &samples, self.hidden_weight, self.geometry);
                return Ok(batch.judged_by_poses(&samples, self.pose_weight));
            }
            if state.dead {
                return Err(PretrainError::DataThread);
            }
            state = self.shared.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Pairs that a thread makes in a second of its own time.
    pub(crate) fn made_per_s(&self) -> f64 {
        let busy_s = self.shared.busy_us.load(Ordering::Relaxed) as f64 * 1e-6;
        self.shared.made.load(Ordering::Relaxed) as f64 / busy_s.max(1e-9)
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next scene to make; waits while enough are ready. `None` when all is done.
    fn next_scene(&self, schedule: &Schedule) -> Option<Scene> {
        let mut state = self.lock();
        loop {
            if state.stop {
                return None;
            }
            if state.block <= state.in_use + AHEAD {
                if let Some(scene) = state.todo.pop_front() {
                    return Some(scene);
                }
                if state.block >= state.last_block {
                    return None;
                }
                state.block += 1;
                state.todo = schedule.scenes(state.block).collect();
                continue;
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn make(&self, generator: &SampleGenerator, scene: Scene) {
        let start = Instant::now();
        let samples = generator.scene(scene.index(), scene.size_px as u32).map_err(PretrainError::from);
        self.busy_us.fetch_add(start.elapsed().as_micros() as u64, Ordering::Relaxed);
        self.made.fetch_add(samples.as_ref().map_or(0, |s| s.len() as u64), Ordering::Relaxed);
        self.lock().done.insert(scene, samples);
        self.changed.notify_all();
    }
}

/// Tells the others when its thread panics.
struct Guard<'a> {
    shared: &'a Shared,
    finished: bool,
}

impl Drop for Guard<'_> {
    fn drop(&mut self) {
        if !self.finished {
            self.shared.lock().dead = true;
            self.shared.changed.notify_all();
        }
    }
}

impl Drop for Prefetch {
    fn drop(&mut self) {
        self.shared.lock().stop = true;
        self.shared.changed.notify_all();
        for thread in self.threads.drain(..) {
            if thread.join().is_err() {
                log::error!("a data thread panicked");
            }
        }
    }
}
