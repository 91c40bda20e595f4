use crate::InitializerError;
use crate::compare::{CompareConfig, Comparer};
use crate::detect::{DetectConfig, Detection, Hypothesis, Rectangle};
use crate::find::Finder;
use crate::network::DetectorNetwork;
use crate::track::{Predicted, TrackConfig, Tracker};
use pseudoflow_geometry::{Intrinsics, quaternion_xyzw};
use pseudoflow_imaging::{Object, ObjectSet, RgbImage};
use pseudoflow_inference::EngineConfig;
use pseudoflow_msgs::{
    CameraFrame, FrameKey, ObjectPose, ObjectPoses, ObjectStatus, ObjectStatuses, PoseSource, PoseStatus,
};
use pseudoflow_runtime::{Context, Inputs, Node, NodeError, Outputs, PortSpec, Role, read};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::path::PathBuf;

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
        let (detect, engine) = (DetectConfig::default(), EngineConfig::default());
        Self { model, objects, network: default_network(), detect, compare: None, track: None, engine }
    }
}

/// Frames in, first poses out.
pub struct InitializerNode {
    finder: Finder,
    following: Option<Following>,
}

/// Tracks, and what was sent of late.
struct Following {
    tracker: Tracker,
    /// Nothing may be lost: a frame waits for the refined poses of the one before.
    lossless: bool,
    sent: VecDeque<Sent>,
    /// Scene and image whose refined poses were learned last.
    learned: Option<(u32, u32)>,
}

/// What was sent for a frame: another node's death may bring it back.
struct Sent {
    key: FrameKey,
    image: (u32, u32),
    searched: bool,
    poses: Vec<ObjectPose>,
    statuses: Vec<ObjectStatus>,
}

/// Frames that are remembered; more than are in flight.
const REMEMBERED: usize = 128;

impl Following {
    /// Learns from the newest refined poses, each time once.
    fn learn(&mut self, refined: &ObjectPoses<'_>) {
        let image = (refined.header.scene_id, refined.header.image_id);
        let sent = self.sent.iter().find(|sent| sent.image == image);
        if let (Some(sent), true) = (sent, self.learned != Some(image)) {
            self.tracker.learn(refined.poses, sent.key.stamp_ns);
            self.learned = Some(image);
        }
    }

    fn remember(&mut self, sent: Sent) {
        self.sent.push_back(sent);
        if self.sent.len() > REMEMBERED {
            self.sent.pop_front();
        }
    }
}

impl InitializerNode {
    /// The objects in a frame, the surest first. With `compare`, which is dear, those that are tracked where they are seen are
    /// left out; else the tracker drops them.
    fn search(
        &mut self,
        frame: &CameraFrame<'_>,
        key: FrameKey,
        tracker: Option<&Tracker>,
        context: &Context,
    ) -> Result<Vec<Detection>, NodeError> {
        let (width, height) = (frame.header.width, frame.header.height);
        let [fx, fy, cx, cy] = frame.header.intrinsics;
        let image = RgbImage::from_raw(width, height, frame.rgb.to_vec()).ok_or("the frame has too few pixels")?;
        let camera = Intrinsics { fx, fy, cx, cy };
        let expected = |object: &Object, there: &Rectangle| {
            tracker.is_some_and(|t| t.expects(object, there, &camera, key.stamp_ns))
        };
        Ok(self.finder.find(&image, &camera, &expected, &mut context.rng(key.index, "ransac"))?)
    }

    /// Predictions for a frame, with a search of the image where the tracks want it. A frame that comes again gets what it
    /// got before.
    fn follow(
        &mut self,
        following: &mut Following,
        frame: &CameraFrame<'_>,
        inputs: &dyn Inputs,
        context: &Context,
    ) -> Result<Sent, NodeError> {
        let key = inputs.key();
        if let Some(at) = following.sent.iter().position(|sent| sent.key.index == key.index) {
            let Sent { image, searched, ref poses, ref statuses, .. } = following.sent[at];
            return Ok(Sent { key, image, searched, poses: poses.clone(), statuses: statuses.clone() });
        }
        if inputs.bytes("poses").is_some() {
            following.learn(&read::<ObjectPoses<'static>>(inputs, "poses")?);
        }
        let searched = following.tracker.wants_search();
        if searched {
            let found = self.search(frame, key, Some(&following.tracker), context)?;
            following.tracker.found(&found, key.stamp_ns);
        }
        let poses = predictions(&following.tracker.predict(key.stamp_ns));
        let image = (frame.header.scene_id, frame.header.image_id);
        Ok(Sent { key, image, searched, poses, statuses: following.tracker.statuses() })
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
        vec![PortSpec::required::<CameraFrame<'static>>("frame"), PortSpec::latest::<ObjectPoses<'static>>("poses")]
    }

    fn outputs() -> Vec<PortSpec> {
        vec![
            PortSpec::required::<ObjectPoses<'static>>("initial_poses"),
            PortSpec::optional::<ObjectStatuses<'static>>("status"),
        ]
    }

    fn check(config: &InitializerConfig) -> Result<(), NodeError> {
        config.detect.check()?;
        config.compare.as_ref().map_or(Ok(()), CompareConfig::check)?;
        config.track.as_ref().map_or(Ok(()), TrackConfig::check)?;
        if !config.model.is_file() {
            let cause = "no such file".to_owned();
            return Err(InitializerError::Model { path: config.model.clone(), cause }.into());
        }
        if !config.objects.join("models_info.json").is_file() {
            let folder = config.objects.display();
            return Err(format!("`objects: {folder}`: no models_info.json there: give a BOP models folder").into());
        }
        Ok(())
    }

    fn create(config: InitializerConfig, context: &Context) -> Result<Self, NodeError> {
        let objects = ObjectSet::load(&config.objects)?;
        let mut network = DetectorNetwork::open(&config.model, &config.network, &config.engine)?;
        let known = objects.ids();
        if let Some(id) = network.object_ids().iter().find(|id| !known.contains(id)) {
            return Err(InitializerError::Objects { path: config.model, id: *id, known }.into());
        }
        let compare = config.compare.as_ref().map(|compare| Comparer::open(compare, &objects, &config.engine));
        let comparer = compare.transpose()?;
        log::info!("{} finds {} objects with {}", network.describe(), known.len(), config.model.display());
        // The first frame finds memory and kernels ready.
        let grey = network.fit(64, 48).input(&RgbImage::new(64, 48));
        network.run(&grey)?;
        let following = config.track.clone().map(|track| Following {
            tracker: Tracker::new(track, &objects, config.detect.max_instances),
            lossless: context.replay,
            sent: VecDeque::new(),
            learned: None,
        });
        Ok(Self { finder: Finder { network, comparer, objects, config: config.detect }, following })
    }

    fn ready(&self, inputs: &dyn Inputs) -> Result<bool, NodeError> {
        let Some(following) = self.following.as_ref().filter(|following| following.lossless) else { return Ok(true) };
        let index = inputs.key().index;
        let Some(last) = following.sent.back().filter(|last| last.key.index < index) else { return Ok(true) };
        if inputs.bytes("poses").is_none() {
            log::debug!("frame {index} waits for the refined poses of the one before: connect `poses` as feedback");
            return Ok(false);
        }
        let header = read::<ObjectPoses<'static>>(inputs, "poses")?.header;
        Ok((header.scene_id, header.image_id) == last.image)
    }

    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, context: &Context) -> Result<(), NodeError> {
        let frame = read::<CameraFrame<'static>>(inputs, "frame")?;
        let image = (frame.header.scene_id, frame.header.image_id);
        let sent = match self.following.take() {
            None => {
                let poses = poses(&self.search(&frame, inputs.key(), None, context)?);
                Sent { key: inputs.key(), image, searched: true, poses, statuses: Vec::new() }
            }
            Some(mut following) => {
                let sent = self.follow(&mut following, &frame, inputs, context);
                self.following = Some(following);
                sent?
            }
        };
        send(outputs, &sent)?;
        if let Some(following) = &mut self.following
            && following.sent.back().is_none_or(|last| last.key.index < sent.key.index)
        {
            following.remember(sent);
        }
        Ok(())
    }
}

fn send(outputs: &mut dyn Outputs, sent: &Sent) -> Result<(), NodeError> {
    let (scene_id, image_id) = sent.image;
    outputs.send("initial_poses", sent.key, ObjectPoses::byte_len(sent.poses.len()), &mut |bytes| {
        ObjectPoses::write(bytes, scene_id, image_id, &sent.poses);
    })?;
    outputs.send("status", sent.key, ObjectStatuses::byte_len(sent.statuses.len()), &mut |bytes| {
        ObjectStatuses::write(bytes, sent.searched, &sent.statuses);
    })
}
