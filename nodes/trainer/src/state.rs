use super::photo::{PhotoSample, photo_loss};
use super::{Sample, TrainerConfig};
use crate::TrainerError;
use pseudoflow_learning::{ExtraLoss, FlowBatch, OpenDevice, TrainConfig, TrainState};
use pseudoflow_network::{FlowNetwork, Weights};
use std::path::Path;

/// Names of the other weights in a checkpoint.
const TEACHER: &str = "teacher";
const PUBLISHED: &str = "published";
const BEFORE: &str = "before";

/// A training: student, optimiser, teacher, and the teachers that were published.
#[derive(Debug)]
pub struct AdaptState {
    student: TrainState<FlowNetwork>,
    teacher: Weights,
    /// The last publication, and the one before it.
    published: Weights,
    before: Weights,
    /// Updates in a step.
    repeats: u64,
}

/// What a step did: its first update, which sees the labels before it learned them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepResult {
    /// Steps taken, this one included.
    pub step: u64,
    /// Flow loss, pixels.
    pub loss_flow: f32,
    /// Photometric loss; NaN without partners.
    pub loss_photo: f32,
    /// Mean distance of the student's last flow from the labels, pixels.
    pub epe_px: f32,
    /// Global gradient norm before clipping.
    pub grad_norm: f64,
    /// Learning rate of the step.
    pub learning_rate: f64,
}

/// Steps of `repeats` updates that the checkpoint of a training has behind it.
///
/// # Errors
/// The file cannot be read or is no checkpoint.
pub fn steps_taken(checkpoint: &Path, repeats: u64) -> Result<u64, TrainerError> {
    Ok(Weights::read_info(checkpoint)?.step / repeats)
}

impl AdaptState {
    /// Begins a training: student and teacher from the same weights.
    ///
    /// # Errors
    /// The weights are unreadable or those of another network.
    pub fn new(config: &TrainerConfig) -> Result<Self, TrainerError> {
        let network = config.resolve_network()?;
        let weights = Weights::load(&config.weights, &network)?;
        let training = TrainConfig::new(config.max_lr, config.updates());
        let student = TrainState::new(network, training, weights, &OpenDevice::open(config.device)?.device)?;
        let teacher = student.weights.clone();
        Ok(Self { published: teacher.clone(), before: teacher.clone(), teacher, student, repeats: config.repeats })
    }

    /// Reads a checkpoint.
    ///
    /// # Errors
    /// It is unreadable, damaged, or of another network or schedule.
    pub fn load(path: &Path, config: &TrainerConfig) -> Result<Self, TrainerError> {
        let names = [TEACHER, PUBLISHED, BEFORE];
        let (network, device) = (config.resolve_network()?, OpenDevice::open(config.device)?.device);
        let (student, mut others) = TrainState::load_with(path, network, &device, &names)?;
        let wanted = TrainConfig::new(config.max_lr, config.updates());
        if student.config != wanted {
            return Err(TrainerError::OtherRun {
                path: path.to_owned(),
                there: format!("{:?}", student.config.schedule),
                here: format!("{:?}", wanted.schedule),
            });
        }
        let mut take = || others.remove(0);
        Ok(Self { teacher: take(), published: take(), before: take(), student, repeats: config.repeats })
    }

    /// Writes a checkpoint, whole or not at all.
    ///
    /// # Errors
    /// The folder is not writable or the disk is full.
    pub fn save(&self, path: &Path) -> Result<(), TrainerError> {
        let others = [(TEACHER, &self.teacher), (PUBLISHED, &self.published), (BEFORE, &self.before)];
        Ok(self.student.save_with(path, &others)?)
    }

    /// What learns.
    #[must_use]
    pub fn network(&self) -> &FlowNetwork {
        &self.student.network
    }

    /// Steps taken.
    #[must_use]
    pub fn step(&self) -> u64 {
        self.student.step() / self.repeats
    }

    /// The teacher.
    #[must_use]
    pub fn teacher(&self) -> &Weights {
        &self.teacher
    }

    /// The student.
    #[must_use]
    pub fn student(&self) -> &Weights {
        &self.student.weights
    }

    /// The last publication and the one before it.
    #[must_use]
    pub fn publications(&self) -> [&Weights; 2] {
        [&self.published, &self.before]
    }

    /// Makes the teacher of now the last publication.
    pub fn publish(&mut self) {
        self.before = std::mem::replace(&mut self.published, self.teacher.clone());
    }

    /// One step on samples: updates of the student, each followed by one of the teacher. Without samples both stay, and the
    /// step counts (its result has NaN losses).
    ///
    /// # Errors
    /// Loss or gradient are not finite: the weights then stay as they were.
    pub fn train(&mut self, samples: &mut [Sample], config: &TrainerConfig) -> Result<StepResult, TrainerError> {
        if samples.is_empty() {
            let learning_rate = self.student.skip_step();
            (1..self.repeats).for_each(|_| _ = self.student.skip_step());
            let step = self.step();
            return Ok(StepResult {
                step,
                loss_flow: f32::NAN,
                loss_photo: f32::NAN,
                epe_px: f32::NAN,
                grad_norm: f64::NAN,
                learning_rate,
            });
        }
        let first = self.update(samples, config)?;
        for _ in 1..self.repeats {
            self.update(samples, config)?;
        }
        Ok(StepResult { step: self.step(), ..first })
    }

    fn update(&mut self, samples: &mut [Sample], config: &TrainerConfig) -> Result<StepResult, TrainerError> {
        let result = self.student_step(samples, config)?;
        self.teacher.average_with(&self.student.weights, config.ema_alpha() as f32);
        self.teacher.info = self.student.weights.info.clone();
        Ok(result)
    }

    fn student_step(&mut self, samples: &mut [Sample], config: &TrainerConfig) -> Result<StepResult, TrainerError> {
        let size_px = config.size_px as usize / config.shrink();
        let pairs = Pairs::of(samples);
        let mut loss_photo = f32::NAN;
        let stats = self.student.train_step_with(&pairs.batch(), size_px, config.flow_weight as f32, |flow_px| {
            let (value, gradient) = photo_part(samples, flow_px, size_px, config.photo_weight);
            loss_photo = value;
            let value = if value.is_finite() { config.photo_weight as f32 * value } else { 0.0 };
            ExtraLoss { value, gradient }
        })?;
        let photo = if loss_photo.is_finite() { config.photo_weight as f32 * loss_photo } else { 0.0 };
        Ok(StepResult {
            step: stats.step,
            loss_flow: if config.flow_weight > 0.0 {
                (stats.loss - photo) / config.flow_weight as f32
            } else {
                f32::NAN
            },
            loss_photo,
            epe_px: stats.epe,
            grad_norm: stats.grad_norm,
            learning_rate: stats.lr,
        })
    }
}

/// The samples of a step as pairs of rendering and real crop.
struct Pairs {
    reference: Vec<f32>,
    real: Vec<f32>,
    flow: Vec<f32>,
    mask: Vec<f32>,
    n: usize,
}

impl Pairs {
    /// Draws the colours of the real crops.
    fn of(samples: &mut [Sample]) -> Self {
        let real = samples.iter_mut().flat_map(|s| s.real().repeat(s.views())).collect();
        let all = |part: fn(&Sample) -> &[f32]| samples.iter().flat_map(part).copied().collect();
        Self {
            reference: all(|s| &s.reference),
            real,
            flow: all(|s| &s.flow_px),
            mask: all(|s| &s.mask),
            n: samples.iter().map(Sample::views).sum(),
        }
    }

    fn batch(&self) -> FlowBatch<'_> {
        FlowBatch { reference: &self.reference, real: &self.real, flow: &self.flow, mask: &self.mask, n: self.n }
    }
}

/// Photometric loss and `weight` times its gradient by all flows (n, 2, S, S): only view 0 of each sample has one.
fn photo_part(samples: &[Sample], flow_px: &[f32], size_px: usize, weight: f64) -> (f32, Vec<f32>) {
    let field = 2 * size_px * size_px;
    let mut gradient = vec![0.0; flow_px.len()];
    if weight == 0.0 {
        return (f32::NAN, gradient);
    }
    let firsts = samples.iter().scan(0, |next, sample| {
        let first = *next;
        *next += sample.views();
        Some(first * field)
    });
    let with_partners: Vec<(usize, &super::sample::Photo)> =
        firsts.zip(samples).filter_map(|(at, sample)| Some((at, sample.photo.as_ref()?))).collect();
    if with_partners.is_empty() {
        return (f32::NAN, gradient);
    }
    let partners: Vec<Vec<(Vec<f32>, &[f32])>> = with_partners
        .iter()
        .map(|(_, photo)| photo.partners.iter().map(|(grey, flow)| (grey.clone(), flow.as_slice())).collect())
        .collect();
    let inputs: Vec<PhotoSample<'_>> = with_partners
        .iter()
        .zip(&partners)
        .map(|((_, p), partners)| PhotoSample { grey: &p.grey, mask: &p.mask, valid: &p.valid, partners })
        .collect();
    let flows: Vec<&[f32]> = with_partners.iter().map(|(at, _)| &flow_px[*at..at + field]).collect();
    let loss = photo_loss(&inputs, &flows, size_px);
    for ((at, _), own) in with_partners.iter().zip(&loss.gradient) {
        let out = &mut gradient[*at..at + field];
        out.iter_mut().zip(own).for_each(|(g, own)| *g = weight as f32 * own);
    }
    (loss.value as f32, gradient)
}
