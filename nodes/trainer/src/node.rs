use super::log::{AdaptLog, LabelStats};
use super::{AdaptState, Sample, SampleForm, TrainerConfig, files};
use crate::TrainerError;
use pseudoflow_msgs::{
    FlowFields, FrameKey, InstanceLabels, NetworkWeights, NetworkWeightsHeader, PseudoLabels, ReferenceViews,
};
use pseudoflow_runtime::{Context, Inputs, Node, NodeError, Outputs, Port, PortSpec, Role};
use std::path::PathBuf;
use std::time::Instant;

const VIEWS: Port<ReferenceViews<'static>> = Port::required("views");
const FLOW: Port<FlowFields<'static>> = Port::required("flow");
const LABELS: Port<PseudoLabels<'static>> = Port::required("labels");
const WEIGHTS: Port<NetworkWeights<'static>> = Port::required("weights");

/// Labels in, the teacher's weights out: one step of training for every `frames_per_step` frames.
///
/// Frames of a step are kept until the step is in a checkpoint ([`Node::safe_until`]), so that a process that takes over
/// finds what it lacks sent again, and comes to the same weights to the bit.
pub struct TrainerNode {
    config: TrainerConfig,
    state: AdaptState,
    log: AdaptLog,
    /// Weight files of the last publication and the one before it.
    published: [Vec<u8>; 2],
    /// Steps in the checkpoint.
    saved_steps: u64,
    batch: Batch,
    started: Instant,
}

/// What has come of the step in progress.
#[derive(Default)]
struct Batch {
    frames: u64,
    samples: Vec<Sample>,
    labels: Vec<InstanceLabels>,
    oldest_publication: Option<u64>,
}

impl Batch {
    fn stats(&self, step: u64, publish_every: u64) -> LabelStats {
        let sum = |part: fn(&InstanceLabels) -> u32| self.labels.iter().map(|l| f64::from(part(l))).sum::<f64>();
        let sigmas: Vec<f64> =
            self.labels.iter().map(|l| f64::from(l.median_sigma_px)).filter(|s| s.is_finite()).collect();
        LabelStats {
            valid_fraction: sum(|l| l.valid_px) / sum(|l| l.visible_px).max(1.0),
            median_sigma_px: sigmas.iter().sum::<f64>() / sigmas.len() as f64,
            samples: self.samples.len(),
            skipped: self.labels.len() - self.samples.len(),
            staleness_steps: step.saturating_sub(self.oldest_publication.unwrap_or(0) * publish_every),
        }
    }
}

impl TrainerNode {
    fn path(&self, file: &str) -> PathBuf {
        self.config.out.join(file)
    }

    /// A frame's place in the whole training, of which this run may be a later part.
    fn place_of(&self, frame: u64) -> u64 {
        self.config.first_step * self.config.frames_per_step + frame
    }

    fn send(&self, key: FrameKey, outputs: &mut dyn Outputs) -> Result<(), NodeError> {
        let version = self.state.step() / self.config.publish_every;
        let [weights, previous] = &self.published;
        let header = NetworkWeightsHeader {
            version,
            step: version * self.config.publish_every,
            frames_per_version: self.config.publish_every * self.config.frames_per_step,
            weights_bytes: weights.len() as u64,
            previous_bytes: previous.len() as u64,
        };
        let len = NetworkWeights::byte_len(&header);
        WEIGHTS.send(outputs, key, len, &mut |bytes| NetworkWeights::write(bytes, header, weights, previous))
    }

    fn gather(&mut self, inputs: &dyn Inputs, context: &Context) -> Result<(), NodeError> {
        let views = VIEWS.read(inputs)?;
        let flow = FLOW.read(inputs)?;
        let labels = LABELS.read(inputs)?;
        let sizes = [views.header.size_px, flow.header.size_px, labels.header.size_px];
        if sizes != [self.config.size_px; 3] {
            let text = format!("views, flow and labels are {sizes:?} px wide, `size_px` is {}", self.config.size_px);
            return Err(TrainerError::Message(text).into());
        }
        let place = self.place_of(inputs.key().index);
        for (instance, info) in labels.info.iter().enumerate() {
            if info.usable == 1 {
                let colours = self.config.augment.then(|| context.rng(place, &format!("augment {instance}")));
                let form = SampleForm { by: self.config.shrink(), geometry: self.state.network().is_refiner() };
                self.batch.samples.push(Sample::of(&views, &flow, &labels, instance, form, colours));
            }
            self.batch.labels.push(*info);
        }
        let publication = labels.header.weights_version;
        let oldest = self.batch.oldest_publication.get_or_insert(publication);
        *oldest = publication.min(*oldest);
        self.batch.frames += 1;
        Ok(())
    }

    /// What the training made. Before the last checkpoint: whoever finds that one finds these too.
    fn save_result(&self) -> Result<(), TrainerError> {
        self.state.teacher().save(&self.path(files::TEACHER))?;
        Ok(self.state.student().save(&self.path(files::STUDENT))?)
    }

    /// The teacher of a step, to look at later. Before the checkpoint, as the result.
    fn keep_teacher(&self, step: u64) -> Result<(), TrainerError> {
        if !self.config.keep_every.is_some_and(|every| step.is_multiple_of(every)) {
            return Ok(());
        }
        let folder = self.path(files::TEACHERS);
        std::fs::create_dir_all(&folder).map_err(TrainerError::io(&folder))?;
        Ok(self.state.teacher().save(&folder.join(format!("{step:06}.safetensors")))?)
    }

    fn step(&mut self, key: FrameKey, outputs: &mut dyn Outputs) -> Result<(), NodeError> {
        let mut batch = std::mem::take(&mut self.batch);
        let labels = batch.stats(self.state.step(), self.config.publish_every);
        let result = self.state.train(&mut batch.samples, &self.config)?;
        let seconds = std::mem::replace(&mut self.started, Instant::now()).elapsed().as_secs_f64();
        self.log.add(&result, &labels, seconds)?;
        let publishes = result.step.is_multiple_of(self.config.publish_every);
        if publishes {
            self.state.publish();
            let weights = self.state.publications()[0].to_bytes();
            self.published = [weights, std::mem::take(&mut self.published[0])];
        }
        self.keep_teacher(result.step)?;
        let ends = result.step == self.config.steps;
        if ends {
            self.save_result()?;
        }
        if publishes || ends || result.step.is_multiple_of(self.config.checkpoint_every) {
            self.state.save(&self.path(files::CHECKPOINT))?;
            self.saved_steps = result.step;
        }
        // Behind the checkpoint: whoever takes over has sent nothing newer than it knows.
        if publishes { self.send(key, outputs) } else { Ok(()) }
    }
}

impl Node for TrainerNode {
    const KIND: &'static str = "trainer";
    const ROLE: Role = Role::Sink;
    type Config = TrainerConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![VIEWS.spec(), FLOW.spec(), LABELS.spec()]
    }

    fn outputs() -> Vec<PortSpec> {
        vec![WEIGHTS.spec()]
    }

    fn check(config: &TrainerConfig) -> Result<(), NodeError> {
        config.check()?;
        config.resolve_network()?;
        if !config.weights.is_file() {
            return Err(format!("`weights: {}`: no such file", config.weights.display()).into());
        }
        Ok(())
    }

    fn create(config: TrainerConfig, _: &Context) -> Result<Self, NodeError> {
        std::fs::create_dir_all(&config.out).map_err(TrainerError::io(&config.out))?;
        let checkpoint = config.out.join(files::CHECKPOINT);
        let state = match checkpoint.exists() {
            true => AdaptState::load(&checkpoint, &config)?,
            false => AdaptState::new(&config)?,
        };
        let steps = state.step();
        if steps < config.first_step {
            let text = format!("`first_step: {}`: {} has only {steps} steps", config.first_step, checkpoint.display());
            return Err(TrainerError::Message(text).into());
        }
        ::log::info!("training goes on from step {steps} of {}", config.steps);
        let log = AdaptLog::open(&config.out.join(files::LOG), steps)?;
        let (batch, started, published) = (Batch::default(), Instant::now(), [vec![], vec![]]);
        let mut node = Self { config, state, log, published, saved_steps: steps, batch, started };
        let [last, before] = node.state.publications();
        node.published[0] = last.to_bytes();
        if steps >= node.config.publish_every {
            node.published[1] = before.to_bytes();
        }
        Ok(node)
    }

    fn begin(&mut self, outputs: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        self.send(FrameKey { index: 0, stamp_ns: 0 }, outputs)
    }

    /// Frames of steps that are in the checkpoint, and all behind the last step.
    fn safe_until(&self, handled: u64) -> u64 {
        if self.saved_steps >= self.config.steps {
            return handled;
        }
        handled.min((self.saved_steps - self.config.first_step) * self.config.frames_per_step)
    }

    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, context: &Context) -> Result<(), NodeError> {
        let index = inputs.key().index;
        let place = self.place_of(index);
        if place >= self.config.steps * self.config.frames_per_step {
            return Ok(());
        }
        let next = self.state.step() * self.config.frames_per_step + self.batch.frames;
        match place.cmp(&next) {
            // Repeated for another node's sake: this one has it.
            std::cmp::Ordering::Less => return Ok(()),
            std::cmp::Ordering::Greater => {
                let text = format!("frame {index} came before the frames of step {}", self.state.step() + 1);
                return Err(TrainerError::Message(text).into());
            }
            std::cmp::Ordering::Equal => {}
        }
        self.gather(inputs, context)?;
        if self.batch.frames == self.config.frames_per_step {
            self.step(inputs.key(), outputs)?;
        }
        Ok(())
    }
}
