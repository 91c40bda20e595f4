use crate::InitializerError;
use crate::compare::{CompareConfig, Comparer};
use crate::detect::{DetectConfig, Detection, Hypothesis, Rectangle};
use crate::find::{Finder, Seen};
use crate::memory::{Memory, Sent};
use crate::network::DetectorNetwork;
use crate::patience::{Patience, SearchConfig};
use crate::track::{Predicted, TrackConfig, Tracker};
use pseudoflow_geometry::{Intrinsics, quaternion_xyzw};
use pseudoflow_imaging::{Object, ObjectSet, RgbImage};
use pseudoflow_inference::EngineConfig;
use pseudoflow_msgs::{
    CameraFrame, FrameKey, ObjectPose, ObjectPoses, ObjectStatus, ObjectStatuses, PoseSource, PoseStatus, TrackPhase,
    TrackReason, Wanted,
};
use pseudoflow_runtime::{Context, Draws, Inputs, Node, NodeError, Outputs, Port, PortSpec, Role};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::time::Instant;

pub(crate) const FRAME: Port<CameraFrame<'static>> = Port::required("frame");
pub(crate) const WANTED: Port<Wanted<'static>> = Port::optional("wanted");
pub(crate) const POSES: Port<ObjectPoses<'static>> = Port::latest("poses");
pub(crate) const INITIAL_POSES: Port<ObjectPoses<'static>> = Port::required("initial_poses");
pub(crate) const STATUS: Port<ObjectStatuses<'static>> = Port::optional("status");

/// Settings of the initializer node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InitializerConfig {
    /// Weights that `pseudoflow pretrain --stage initializer` wrote (`.safetensors`).
    pub model: PathBuf,
    /// Folder of the object set (BOP `models/`).
    pub objects: PathBuf,
    /// The network that the weights belong to: `nano`, `full`, or a YAML file.
    #[serde(default = "default_network")]
    pub network: String,
    /// Poses of these objects only; of all without.
    #[serde(default)]
    pub only_objects: Option<Vec<u32>>,
    /// How poses are made of the network's answer.
    #[serde(default)]
    pub detect: DetectConfig,
    /// Holds the objects, rendered from all sides, against the image: the most similar view is the first pose. Without it the
    /// pose is what the network's votes say.
    #[serde(default)]
    pub compare: Option<CompareConfig>,
    /// Follows objects from frame to frame; `poses` must then be the refined poses (feedback). Without it each image is
    /// searched.
    #[serde(default)]
    pub track: Option<TrackConfig>,
    /// How often wanted objects (`wanted`) are searched for.
    #[serde(default)]
    pub search: SearchConfig,
    /// Live: begins only when all views are there (see `compare.cache`), instead of making them beside the first frames.
    #[serde(default)]
    pub prepare_first: bool,
    /// What decides which numbers RANSAC draws.
    #[serde(default)]
    pub draws: Draws,
    /// Engine, provider, threads.
    #[serde(default)]
    pub engine: EngineConfig,
}

fn default_network() -> String {
    "nano".into()
}

impl InitializerConfig {
    /// The defaults for weights and an object set.
    #[must_use]
    pub fn new(model: PathBuf, objects: PathBuf) -> Self {
        let (detect, search, engine) = (DetectConfig::default(), SearchConfig::default(), EngineConfig::default());
        Self {
            model,
            objects,
            network: default_network(),
            only_objects: None,
            detect,
            compare: None,
            track: None,
            search,
            prepare_first: false,
            draws: Draws::default(),
            engine,
        }
    }
}

/// Frames in, first poses out.
pub struct InitializerNode {
    finder: Finder,
    only_objects: Option<Vec<u32>>,
    following: Option<Following>,
    patience: Patience,
    memory: Memory,
    draws: Draws,
}

/// Tracks of a node that follows what it has found.
struct Following {
    tracker: Tracker,
    /// Nothing may be lost: a frame waits for the refined poses of the one before.
    lossless: bool,
    /// Scene and image whose refined poses were learned last.
    learned: Option<(u32, u32)>,
}

impl Following {
    /// Learns from the newest refined poses, each time once.
    fn learn(&mut self, refined: &ObjectPoses<'_>, memory: &Memory) {
        let image = (refined.header.scene_id, refined.header.image_id);
        if let (Some(sent), true) = (memory.of_image(image), self.learned != Some(image)) {
            self.tracker.learn(refined.poses, sent.key.stamp_ns);
            self.learned = Some(image);
        }
    }
}

impl InitializerNode {
    /// Looks where objects are in a frame.
    fn look(&mut self, frame: &CameraFrame<'_>) -> Result<(RgbImage, Seen), NodeError> {
        let (width, height) = (frame.header.width, frame.header.height);
        let image = RgbImage::from_raw(width, height, frame.rgb.to_vec()).ok_or("the frame has too few pixels")?;
        let seen = self.finder.look(&image)?;
        Ok((image, seen))
    }

    /// The objects in a frame, the surest first, but for those to be left out where they are seen.
    fn search(
        &mut self,
        frame: &CameraFrame<'_>,
        key: FrameKey,
        (image, seen): (RgbImage, Seen),
        leave_out: &dyn Fn(&Object, &Rectangle, &Intrinsics) -> bool,
        context: &Context,
    ) -> Result<Vec<Detection>, NodeError> {
        let [fx, fy, cx, cy] = frame.header.intrinsics;
        let camera = Intrinsics { fx, fy, cx, cy };
        let preparing = self.finder.preparing();
        let left_out = |object: &Object, there: &Rectangle| {
            preparing.iter().any(|p| p.object_id == object.id) || leave_out(object, there, &camera)
        };
        let named = (frame.header.scene_id, frame.header.image_id);
        let mut rng = self.draws.rng(context, key.index, named, "ransac");
        let mut found = self.finder.find(seen, &image, &camera, &left_out, &mut rng)?;
        // Behind the search, so that what is drawn for one object does not depend on which others are wanted.
        found.retain(|detection| self.only_objects.as_ref().is_none_or(|only| only.contains(&detection.object_id)));
        Ok(found)
    }

    /// What a frame shows of what is wanted and due.
    fn run_errand(
        &mut self,
        frame: &CameraFrame<'_>,
        inputs: &dyn Inputs,
        context: &Context,
    ) -> Result<(Vec<ObjectPose>, bool), NodeError> {
        let key = inputs.key();
        if !inputs.is_connected(WANTED.name()) {
            let looked = self.look(frame)?;
            return Ok((poses(&self.search(frame, key, looked, &|_, _, _| false, context)?), true));
        }
        let wanted = WANTED.read(inputs)?.object_ids;
        let preparing = self.finder.preparing();
        self.patience.forget_all_but(wanted);
        let known = |id: &u32| preparing.iter().all(|p| p.object_id != *id);
        let ready: Vec<u32> = wanted.iter().copied().filter(known).collect();
        if self.patience.due(&ready, key.stamp_ns).is_empty() {
            return Ok((Vec::new(), false));
        }
        let begun = Instant::now();
        let looked = self.look(frame)?;
        let turn = self.take_turns(&ready, key, &looked.1);
        let mut found = match turn.is_empty() {
            true => Vec::new(),
            false => self.search(frame, key, looked, &|object, _, _| !turn.contains(&object.id), context)?,
        };
        found.retain(|detection| turn.contains(&detection.object_id));
        for id in &turn {
            self.patience.searched(*id, key.stamp_ns, found.iter().any(|detection| detection.object_id == *id));
        }
        let ids: Vec<u32> = found.iter().map(|detection| detection.object_id).collect();
        log::debug!("frame {}: {turn:?} of {ready:?} searched for, {ids:?} found in {:?}", key.index, begun.elapsed());
        Ok((poses(&found), true))
    }

    /// Whose turn it is in a frame that was looked at: of those that may be in it the ones that have waited longest. What the frame
    /// does not show was searched for as well, and cost nothing.
    fn take_turns(&mut self, ready: &[u32], key: FrameKey, seen: &Seen) -> Vec<u32> {
        let config = &self.finder.config;
        let (shown, absent): (Vec<u32>, Vec<u32>) = ready.iter().partition(|id| seen.shows(**id, config));
        for id in self.patience.due(&absent, key.stamp_ns) {
            self.patience.searched(id, key.stamp_ns, false);
        }
        self.patience.turn(&shown, key.stamp_ns)
    }

    /// Predictions for a frame, with a search of the image where the tracks want it.
    fn follow(
        &mut self,
        following: &mut Following,
        frame: &CameraFrame<'_>,
        inputs: &dyn Inputs,
        context: &Context,
    ) -> Result<(Vec<ObjectPose>, bool), NodeError> {
        let key = inputs.key();
        if POSES.has_come(inputs) {
            following.learn(&POSES.read(inputs)?, &self.memory);
        }
        let searched = following.tracker.wants_search();
        if searched {
            let tracker = &following.tracker;
            let expected = |object: &Object, there: &Rectangle, camera: &Intrinsics| {
                tracker.expects(object, there, camera, key.stamp_ns)
            };
            let looked = self.look(frame)?;
            let found = self.search(frame, key, looked, &expected, context)?;
            following.tracker.found(&found, key.stamp_ns);
        }
        Ok((predictions(&following.tracker.predict(key.stamp_ns)), searched))
    }

    /// What is sent for a frame.
    fn answer(&mut self, inputs: &dyn Inputs, context: &Context) -> Result<Sent, NodeError> {
        let frame = FRAME.read(inputs)?;
        let ((poses, searched), statuses) = match self.following.take() {
            None => {
                let answer = self.run_errand(&frame, inputs, context)?;
                let statuses = self.statuses(&answer.0);
                (answer, statuses)
            }
            Some(mut following) => {
                let answer = self.follow(&mut following, &frame, inputs, context);
                let statuses = following.tracker.statuses();
                self.following = Some(following);
                (answer?, statuses)
            }
        };
        let image = (frame.header.scene_id, frame.header.image_id);
        Ok(Sent { key: inputs.key(), image, searched, poses, statuses: self.with_preparing(statuses) })
    }

    /// What is known of each object without tracks: whether this frame showed it.
    fn statuses(&self, found: &[ObjectPose]) -> Vec<ObjectStatus> {
        let status = |object_id: u32| {
            let pose = found.iter().find(|pose| pose.object_id == object_id);
            let reason = if pose.is_some() { TrackReason::Detected } else { TrackReason::NotFound };
            ObjectStatus {
                object_id,
                instance: 0,
                phase: TrackPhase::Searching as u32,
                reason: reason as u32,
                good_frames: 0,
                bad_frames: 0,
                score: pose.map_or(0.0, |pose| pose.score),
            }
        };
        self.finder.objects.ids().into_iter().map(status).collect()
    }

    /// Says of objects that cannot be searched for yet how far they are.
    fn with_preparing(&self, mut statuses: Vec<ObjectStatus>) -> Vec<ObjectStatus> {
        for preparing in self.finder.preparing() {
            for status in statuses.iter_mut().filter(|status| status.object_id == preparing.object_id) {
                (status.reason, status.score) = (TrackReason::Preparing as u32, preparing.share);
            }
        }
        statuses
    }
}

/// Predictions as poses; the others of an instance follow it, under the same number.
fn predictions(predicted: &[Predicted]) -> Vec<ObjectPose> {
    let pose = |p: &Predicted| ObjectPose {
        object_id: p.object_id,
        instance: p.instance,
        status: PoseStatus::Ok as u32,
        source: if p.tracked { PoseSource::Tracked } else { PoseSource::Initializer } as u32,
        score: p.score,
        rotation_xyzw: quaternion_xyzw(&p.camera_from_object),
        translation_m: p.camera_from_object.translation.vector.into(),
        covariance: [0.0; 36],
    };
    predicted.iter().flat_map(|p| with_others(pose(p), &p.others)).collect()
}

/// Detections as poses, numbered by object; the others of an instance follow it, under the same number.
fn poses(found: &[Detection]) -> Vec<ObjectPose> {
    let instance = |i: usize| found[..i].iter().filter(|d| d.object_id == found[i].object_id).count() as u32;
    let pose = |i: usize, d: &Detection| ObjectPose {
        object_id: d.object_id,
        instance: instance(i),
        status: PoseStatus::Ok as u32,
        source: PoseSource::Initializer as u32,
        score: d.score,
        rotation_xyzw: quaternion_xyzw(&d.camera_from_object),
        translation_m: d.camera_from_object.translation.vector.into(),
        covariance: d.covariance,
    };
    let of = |(i, d): (usize, &Detection)| with_others(pose(i, d), &d.others);
    let mut poses: Vec<ObjectPose> = found.iter().enumerate().flat_map(of).collect();
    poses.sort_by_key(ObjectPose::identity);
    poses
}

fn with_others(first: ObjectPose, others: &[Hypothesis]) -> Vec<ObjectPose> {
    let other = |h: &Hypothesis| ObjectPose {
        score: h.score,
        rotation_xyzw: quaternion_xyzw(&h.camera_from_object),
        translation_m: h.camera_from_object.translation.vector.into(),
        ..first
    };
    std::iter::once(first).chain(others.iter().map(other)).collect()
}

impl Node for InitializerNode {
    const KIND: &'static str = "initializer";
    const ROLE: Role = Role::Transform;
    type Config = InitializerConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![FRAME.spec(), WANTED.spec(), POSES.spec()]
    }

    fn outputs() -> Vec<PortSpec> {
        vec![INITIAL_POSES.spec(), STATUS.spec()]
    }

    fn check(config: &InitializerConfig) -> Result<(), NodeError> {
        config.detect.check()?;
        config.compare.as_ref().map_or(Ok(()), CompareConfig::check)?;
        config.track.as_ref().map_or(Ok(()), TrackConfig::check)?;
        config.search.check()?;
        if !config.model.is_file() {
            let cause = "no such file".to_owned();
            return Err(InitializerError::Model { path: config.model.clone(), cause }.into());
        }
        ObjectSet::check(&config.objects)?;
        Ok(())
    }

    fn create(config: InitializerConfig, context: &Context) -> Result<Self, NodeError> {
        let objects = ObjectSet::load(&config.objects)?;
        let mut network = DetectorNetwork::open(&config.model, &config.network, &config.engine)?;
        let known = objects.ids();
        if let Some(id) = network.object_ids().iter().find(|id| !known.contains(id)) {
            return Err(InitializerError::Objects { path: config.model, id: *id, known }.into());
        }
        // In replay everything is there before the first frame; a camera's frames pass meanwhile, and say what is prepared.
        let open = if context.replay || config.prepare_first { Comparer::open } else { Comparer::open_unprepared };
        let comparer = config.compare.as_ref().map(|compare| open(compare, &objects, &config.engine)).transpose()?;
        log::info!("{} finds {} objects with {}", network.describe(), known.len(), config.model.display());
        // The first frame finds memory and kernels ready.
        let grey = network.fit(64, 48).input(&RgbImage::new(64, 48));
        network.run(&grey)?;
        let following = config.track.clone().map(|track| Following {
            tracker: Tracker::new(track, &objects, config.detect.max_instances),
            lossless: context.replay,
            learned: None,
        });
        let only_objects = config.only_objects;
        let finder = Finder { network, comparer, objects, config: config.detect };
        let (patience, draws) = (Patience::new(config.search), config.draws);
        Ok(Self { finder, only_objects, following, patience, memory: Memory::default(), draws })
    }

    fn ready(&self, inputs: &dyn Inputs) -> Result<bool, NodeError> {
        if !self.following.as_ref().is_some_and(|following| following.lossless) {
            return Ok(true);
        }
        let index = inputs.key().index;
        let Some(last) = self.memory.last().filter(|last| last.key.index < index) else { return Ok(true) };
        if !POSES.has_come(inputs) {
            log::debug!("frame {index} waits for the refined poses of the one before: connect `poses` as feedback");
            return Ok(false);
        }
        let header = POSES.read(inputs)?.header;
        Ok((header.scene_id, header.image_id) == last.image)
    }

    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, context: &Context) -> Result<(), NodeError> {
        if let Some(sent) = self.memory.of_frame(inputs.key().index) {
            return sent.send(outputs);
        }
        self.finder.prepare_some()?;
        let sent = self.answer(inputs, context)?;
        sent.send(outputs)?;
        self.memory.remember(sent);
        Ok(())
    }
}
