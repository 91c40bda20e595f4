use crate::detect::{DetectConfig, Detection, detect};
use crate::network::DetectorNetwork;
use crate::votes::{group, votes};
use crate::InitializerError;
use pseudoflow_geometry::{Intrinsics, quaternion_xyzw};
use pseudoflow_imaging::{ObjectSet, RgbImage};
use pseudoflow_inference::EngineConfig;
use pseudoflow_msgs::{CameraFrame, ObjectPose, ObjectPoses, PoseSource, PoseStatus};
use pseudoflow_runtime::{Context, Inputs, Node, NodeError, Outputs, PortSpec, Role, read};
use rand::Rng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
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
        Self { model, objects, network: default_network(), detect, engine }
    }
}

/// Frames in, first poses out.
pub struct InitializerNode {
    config: InitializerConfig,
    network: DetectorNetwork,
    objects: ObjectSet,
}

impl InitializerNode {
    /// The objects in an image, the surest first.
    fn find(&mut self, image: &RgbImage, camera: &Intrinsics, rng: &mut impl Rng) -> Result<Vec<Detection>, NodeError> {
        let fit = self.network.fit(image.width(), image.height());
        let answer = self.network.run(&fit.input(image))?;
        let groups = group(&votes(&answer, self.config.detect.min_vote as f32));
        let camera = fit.intrinsics(camera);
        Ok(detect(&groups, answer.object_ids, &self.objects, &camera, &self.config.detect, rng)?)
    }
}

/// Detections as poses, numbered by object.
fn poses(found: &[Detection]) -> Vec<ObjectPose> {
    let instance = |i: usize| found[..i].iter().filter(|d| d.object_id == found[i].object_id).count() as u32;
    let pose = |(i, d): (usize, &Detection)| ObjectPose {
        object_id: d.object_id,
        instance: instance(i),
        status: PoseStatus::Ok as u32,
        source: PoseSource::Initializer as u32,
        score: d.score,
        rotation_xyzw: quaternion_xyzw(&d.camera_from_object),
        translation_m: d.camera_from_object.translation.vector.into(),
        covariance: d.covariance,
    };
    let mut poses: Vec<ObjectPose> = found.iter().enumerate().map(pose).collect();
    poses.sort_by_key(|pose| (pose.object_id, pose.instance));
    poses
}

impl Node for InitializerNode {
    const KIND: &'static str = "initializer";
    const ROLE: Role = Role::Transform;
    type Config = InitializerConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![PortSpec::required::<CameraFrame<'static>>("frame")]
    }

    fn outputs() -> Vec<PortSpec> {
        vec![PortSpec::required::<ObjectPoses<'static>>("initial_poses")]
    }

    fn check(config: &InitializerConfig) -> Result<(), NodeError> {
        config.detect.check()?;
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

    fn create(config: InitializerConfig, _: &Context) -> Result<Self, NodeError> {
        let objects = ObjectSet::load(&config.objects)?;
        let mut network = DetectorNetwork::open(&config.model, &config.network, &config.engine)?;
        let known = objects.ids();
        if let Some(id) = network.object_ids().iter().find(|id| !known.contains(id)) {
            return Err(InitializerError::Objects { path: config.model, id: *id, known }.into());
        }
        log::info!("{} finds {} objects with {}", network.describe(), known.len(), config.model.display());
        // The first frame finds memory and kernels ready.
        let grey = network.fit(64, 48).input(&RgbImage::new(64, 48));
        network.run(&grey)?;
        Ok(Self { config, network, objects })
    }

    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, context: &Context) -> Result<(), NodeError> {
        let frame = read::<CameraFrame<'static>>(inputs, "frame")?;
        let (width, height) = (frame.header.width, frame.header.height);
        let [fx, fy, cx, cy] = frame.header.intrinsics;
        let image = RgbImage::from_raw(width, height, frame.rgb.to_vec()).ok_or("the frame has too few pixels")?;
        let mut rng = context.rng(inputs.key().index, "ransac");
        let found = poses(&self.find(&image, &Intrinsics { fx, fy, cx, cy }, &mut rng)?);
        let (scene_id, image_id) = (frame.header.scene_id, frame.header.image_id);
        outputs.send("initial_poses", inputs.key(), ObjectPoses::byte_len(found.len()), &mut |bytes| {
            ObjectPoses::write(bytes, scene_id, image_id, &found);
        })
    }
}
