use crate::{EstimateDetails, EvalDataset, EvalError, EvalImage, EvalModel, NamedEstimates, evaluate};
use pseudoflow_geometry::{Intrinsics, pose_from_quaternion};
use pseudoflow_imaging::{BopFrame, ObjectSet};
use pseudoflow_metrics::{Estimate, KnownIds, SceneTruth, TruthInstance, VISIB_GT_MIN};
use pseudoflow_msgs::{CameraFrame, ObjectPose, ObjectPoses, PoseSource};
use pseudoflow_runtime::{Context, Inputs, Node, NodeError, Outputs, Port, PortSpec, Role};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

const FRAME: Port<CameraFrame<'static>> = Port::required("frame");
const INITIAL_POSES: Port<ObjectPoses<'static>> = Port::required("initial_poses");
const POSES: Port<ObjectPoses<'static>> = Port::required("poses");

/// Settings of the evaluator node.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EvaluatorConfig {
    /// Folder with `scene_gt.json` (BOP) of the recording's frames.
    pub truth: PathBuf,
    /// Folder of the object set.
    pub objects: PathBuf,
    /// Folder for `poses.jsonl` (grows with every frame) and `report.json` (at the end).
    pub out: PathBuf,
}

/// Initial and refined poses of each frame in, scores against the ground truth at the end.
///
/// What has come is kept in `poses.jsonl`, a line a frame, so that a restarted node goes on where it was.
pub struct EvaluatorNode {
    config: EvaluatorConfig,
    log: File,
}

/// A line of `poses.jsonl`.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct FrameLine {
    index: u64,
    scene_id: u32,
    image_id: u32,
    size_px: (u32, u32),
    intrinsics: Intrinsics,
    initial: Vec<PoseLine>,
    refined: Vec<PoseLine>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct PoseLine {
    object_id: u32,
    /// A [`pseudoflow_msgs::PoseStatus`]: only poses with 0 are published.
    #[serde(default)]
    status: u32,
    score: f64,
    rotation_xyzw: [f64; 4],
    translation_m: [f64; 3],
    /// Of a refined pose whose covariance is known: 36 numbers.
    #[serde(default)]
    covariance: Vec<f64>,
}

impl From<&ObjectPose> for PoseLine {
    fn from(pose: &ObjectPose) -> Self {
        let ObjectPose { object_id, status, score, rotation_xyzw, translation_m, .. } = *pose;
        let known = pose.source == PoseSource::Refined as u32 && pose.covariance[0] > 0.0;
        let covariance = if known { pose.covariance.to_vec() } else { Vec::new() };
        Self { object_id, status, score, rotation_xyzw, translation_m, covariance }
    }
}

impl EvaluatorNode {
    fn log_path(config: &EvaluatorConfig) -> PathBuf {
        config.out.join("poses.jsonl")
    }
}

impl Node for EvaluatorNode {
    const KIND: &'static str = "evaluator";
    const ROLE: Role = Role::Sink;
    type Config = EvaluatorConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![FRAME.spec(), INITIAL_POSES.spec(), POSES.spec()]
    }

    fn outputs() -> Vec<PortSpec> {
        Vec::new()
    }

    fn check(config: &EvaluatorConfig) -> Result<(), NodeError> {
        if !config.truth.join("scene_gt.json").is_file() {
            let folder = config.truth.display();
            return Err(format!("`truth: {folder}`: no scene_gt.json there: give the folder of a BOP scene").into());
        }
        if !config.objects.join("models_info.json").is_file() {
            let folder = config.objects.display();
            return Err(format!("`objects: {folder}`: no models_info.json there: give a BOP models folder").into());
        }
        Ok(())
    }

    fn create(config: EvaluatorConfig, context: &Context) -> Result<Self, NodeError> {
        std::fs::create_dir_all(&config.out)?;
        let path = Self::log_path(&config);
        let mut options = OpenOptions::new();
        options.create(true);
        let log = match context.restarts {
            0 => options.write(true).truncate(true).open(&path)?,
            _ => options.append(true).open(&path)?,
        };
        Ok(Self { config, log })
    }

    fn process(&mut self, inputs: &dyn Inputs, _: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        let header = FRAME.read(inputs)?.header;
        let poses = |port: &Port<ObjectPoses<'static>>| -> Result<Vec<PoseLine>, NodeError> {
            let poses = port.read(inputs)?.poses;
            Ok(ObjectPose::likeliest(poses).map(PoseLine::from).collect())
        };
        let [fx, fy, cx, cy] = header.intrinsics;
        let line = FrameLine {
            index: inputs.key().index,
            scene_id: header.scene_id,
            image_id: header.image_id,
            size_px: (header.width, header.height),
            intrinsics: Intrinsics { fx, fy, cx, cy },
            initial: poses(&INITIAL_POSES)?,
            refined: poses(&POSES)?,
        };
        // A leading newline ends what a killed predecessor may have left half written.
        let text = format!("\n{}", serde_json::to_string(&line)?);
        self.log.write_all(text.as_bytes())?;
        Ok(self.log.flush()?)
    }

    fn finish(&mut self, _: &Context) -> Result<(), NodeError> {
        let frames = read_frames(&Self::log_path(&self.config))?;
        let (dataset, sets) = dataset(&self.config, &frames)?;
        if dataset.images.is_empty() {
            log::warn!("none of {} frames has ground truth: no report", frames.len());
            return Ok(());
        }
        let report = evaluate(&dataset, &sets, &|_, _| ())?;
        for set in &report.sets {
            log::info!("{set}: ADD(-S)-0.1d {:.3} of {}", report.overall[set].add_s_recall, report.overall[set].n);
        }
        Ok(report.write_json(&self.config.out.join("report.json"))?)
    }
}

/// The frames of a log, each once; a line cut off by a crash is the one that its successor repeats.
fn read_frames(path: &Path) -> Result<Vec<FrameLine>, EvalError> {
    let text = std::fs::read_to_string(path).map_err(|source| EvalError::Io { path: path.to_owned(), source })?;
    let lines = text.lines().filter_map(|line| serde_json::from_str::<FrameLine>(line).ok());
    let frames: BTreeMap<u64, FrameLine> = lines.map(|line| (line.index, line)).collect();
    Ok(frames.into_values().collect())
}

fn dataset(config: &EvaluatorConfig, frames: &[FrameLine]) -> Result<(EvalDataset, Vec<NamedEstimates>), NodeError> {
    let objects = ObjectSet::load(&config.objects)?;
    let truth = SceneTruth::read(&config.truth)?;
    let images: Vec<EvalImage> =
        frames.iter().filter_map(|f| Some(image(f, truth.images.get(&f.image_id)?.clone()))).collect();
    let models = objects.iter().map(|o| Ok((o.id, EvalModel::new(o)?))).collect::<Result<_, EvalError>>()?;
    let set = |name: &str, poses: &dyn Fn(&FrameLine) -> &Vec<PoseLine>| -> Result<NamedEstimates, NodeError> {
        let mut estimates = Vec::new();
        for frame in frames {
            for pose in poses(frame) {
                estimates.push(estimate(frame, pose)?);
            }
        }
        Ok(NamedEstimates::new(name, estimates))
    };
    let details = frames.iter().flat_map(|f| f.refined.iter().map(details)).collect();
    let refined = NamedEstimates { details, ..set("refined", &|f| &f.refined)? };
    let sets = vec![set("init", &|f| &f.initial)?, refined];
    let name = |path: &Path| path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let known = KnownIds {
        objects: objects.ids().into_iter().collect(),
        images: frames.iter().map(|f| (f.scene_id, f.image_id)).collect(),
    };
    let notes = vec![format!("{} of {} frames have ground truth.", images.len(), frames.len())];
    let dataset = EvalDataset {
        name: name(&config.truth),
        split: "recording".into(),
        render_dir: objects.folder().to_owned(),
        objects,
        models,
        images,
        known,
        notes,
    };
    Ok((dataset, sets))
}

fn image(frame: &FrameLine, truth: Vec<TruthInstance>) -> EvalImage {
    let valid: Vec<bool> = truth.iter().map(|t| t.visible_fraction.is_none_or(|v| v >= VISIB_GT_MIN)).collect();
    let mut targets = BTreeMap::new();
    for (instance, _) in truth.iter().zip(&valid).filter(|(_, valid)| **valid) {
        *targets.entry(instance.object_id).or_insert(0) += 1;
    }
    let frame_files = BopFrame {
        image_id: frame.image_id,
        image_path: PathBuf::new(),
        depth_path: None,
        intrinsics: frame.intrinsics,
        depth_scale: 1.0,
        initial_poses: Vec::new(),
    };
    EvalImage { scene_id: frame.scene_id, frame: frame_files, size_px: frame.size_px, truth, valid, targets }
}

fn details(pose: &PoseLine) -> EstimateDetails {
    let covariance = pose.covariance.as_slice().try_into().ok();
    EstimateDetails { confidence: Some(pose.score), covariance, gate: Vec::new() }
}

fn estimate(frame: &FrameLine, pose: &PoseLine) -> Result<Estimate, NodeError> {
    Ok(Estimate {
        scene_id: frame.scene_id,
        image_id: frame.image_id,
        object_id: pose.object_id,
        score: pose.score,
        camera_from_object: pose_from_quaternion(&pose.rotation_xyzw, &pose.translation_m)?.into(),
        image_time_s: None,
    })
}
