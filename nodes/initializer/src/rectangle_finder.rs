//! The node `rectangle_finder`: where another detector says that an object is, it is looked for from all sides, without a network
//! that was trained to find it. Only the flow network's features are needed ([`Comparer`]).
//!
//! | port | | what |
//! |---|---|---|
//! | `frame` | in, joined | the camera |
//! | `rectangles` | in, joined | recordings: what a detector saw in this frame |
//! | `detected` | in, late | live: an image of the past with what a detector saw in it |
//! | `wanted` | in, joined | live: objects that are missing; without, all rectangles of an answer are looked into at once |
//! | `initial_poses` | out | of `rectangles`: poses for the renderer, the best first, further hypotheses behind |
//! | `found` | out | the same, keyed by the frame they were seen in, for the tracker |

use crate::answer::Answer;
use crate::compare::{CompareConfig, Comparer, Match, Photograph};
use crate::detect::Rectangle as Place;
use crate::patience::{Patience, SearchConfig};
use nalgebra::{Point2, Vector2};
use pseudoflow_geometry::{Intrinsics, quaternion_xyzw};
use pseudoflow_imaging::{ObjectSet, RgbImage};
use pseudoflow_inference::EngineConfig;
use pseudoflow_msgs::{
    CameraFrame, CameraFrameHeader, DetectedFrame, FrameKey, Message, ObjectPose, ObjectPoses, PoseSource, PoseStatus,
    Rectangle, Rectangles, Wanted,
};
use pseudoflow_runtime::{Context, Inputs, Node, NodeError, Outputs, Port, PortSpec, Role};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

const FRAME: Port<CameraFrame<'static>> = Port::required("frame");
const RECTANGLES: Port<Rectangles<'static>> = Port::optional("rectangles");
const DETECTED: Port<DetectedFrame<'static>> = Port::late("detected");
const WANTED: Port<Wanted<'static>> = Port::optional("wanted");
const INITIAL_POSES: Port<ObjectPoses<'static>> = Port::optional("initial_poses");
const FOUND: Port<ObjectPoses<'static>> = Port::optional("found");

/// Settings of the node `rectangle_finder`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RectangleFinderConfig {
    /// Folder of the object set (BOP `models/`).
    pub objects: PathBuf,
    /// How the objects, rendered from all sides, are held against the image.
    pub compare: CompareConfig,
    /// Poses of one object in a frame, the surest rectangles first.
    #[serde(default = "default_max_instances")]
    pub max_instances: usize,
    /// How often wanted objects (`wanted`) are searched for.
    #[serde(default)]
    pub search: SearchConfig,
    /// Engine, provider, threads.
    #[serde(default)]
    pub engine: EngineConfig,
}

fn default_max_instances() -> usize {
    1
}

/// Rectangles in, first poses out.
pub struct RectangleFinder {
    objects: ObjectSet,
    comparer: Comparer,
    max_instances: usize,
    patience: Patience,
    /// The newest answer, until all that is wanted has been looked for.
    answer: Option<Answer>,
}

impl RectangleFinder {
    /// The poses of what stands in rectangles of an image, hypotheses of an instance behind each other.
    fn find(
        &mut self,
        header: &CameraFrameHeader,
        rgb: &[u8],
        rectangles: &[Rectangle],
    ) -> Result<Vec<ObjectPose>, NodeError> {
        let [fx, fy, cx, cy] = header.intrinsics;
        let camera = Intrinsics { fx, fy, cx, cy };
        let image =
            RgbImage::from_raw(header.width, header.height, rgb.to_vec()).ok_or("the frame has too few pixels")?;
        let photograph = Photograph { image: &image, camera: &camera };
        let mut surest: Vec<&Rectangle> = rectangles.iter().collect();
        surest.sort_by(|a, b| b.score.total_cmp(&a.score));
        let mut poses = Vec::<ObjectPose>::new();
        for rectangle in surest {
            let object_id = rectangle.object_id;
            let instance = ObjectPose::likeliest(&poses).filter(|pose| pose.object_id == object_id).count();
            if instance >= self.max_instances {
                continue;
            }
            let Ok(object) = self.objects.get(object_id) else {
                log::warn!("a rectangle of object {object_id}, which the set does not have");
                continue;
            };
            let coarse_match = self.comparer.coarse_match(&photograph, object, &place(rectangle))?;
            let best = self.comparer.best(&photograph, object, &coarse_match)?;
            poses.extend(best.iter().map(|found| pose(rectangle, instance as u32, found)));
        }
        Ok(poses)
    }

    /// Of images of the past the newest alone: what was seen before it is no longer of use.
    fn find_late(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs) -> Result<(), NodeError> {
        if let Some((key, bytes)) = inputs.late(DETECTED.name()).into_iter().max_by_key(|(key, _)| key.index) {
            self.answer = Some(Answer::new(key, &DetectedFrame::view(bytes)?));
        }
        let Some(mut answer) = self.answer.take() else { return Ok(()) };
        let wanted = match inputs.is_connected(WANTED.name()) {
            true => Some(WANTED.read(inputs)?.object_ids),
            false => None,
        };
        let due = answer.take_due(wanted, &mut self.patience);
        // Most frames pass while it is nobody's turn: they must not copy the answer's image.
        if !due.is_empty() {
            self.look_into(&answer, &due, outputs)?;
        }
        self.answer = Some(answer).filter(|answer| !answer.is_done());
        Ok(())
    }

    /// Sends what stands in some rectangles of an answer, and takes down that they were looked into.
    fn look_into(&mut self, answer: &Answer, due: &[Rectangle], outputs: &mut dyn Outputs) -> Result<(), NodeError> {
        let poses = self.find(&answer.header, &answer.rgb, due)?;
        for rectangle in due {
            let found = poses.iter().any(|pose| pose.object_id == rectangle.object_id);
            self.patience.searched(rectangle.object_id, answer.key.stamp_ns, found);
        }
        match poses.is_empty() {
            true => Ok(()),
            false => send_poses(outputs, &FOUND, answer.key, &answer.header, &poses),
        }
    }
}

fn place(rectangle: &Rectangle) -> Place {
    let [left, top, right, bottom] = [rectangle.left, rectangle.top, rectangle.right, rectangle.bottom].map(f64::from);
    Place {
        middle_px: Point2::new((left + right) / 2.0, (top + bottom) / 2.0),
        size_px: Vector2::new(right - left, bottom - top),
    }
}

fn pose(rectangle: &Rectangle, instance: u32, found: &Match) -> ObjectPose {
    ObjectPose {
        object_id: rectangle.object_id,
        instance,
        status: PoseStatus::Ok as u32,
        source: PoseSource::Initializer as u32,
        score: f64::from(rectangle.score) * found.similarity.clamp(0.0, 1.0),
        rotation_xyzw: quaternion_xyzw(&found.camera_from_object),
        translation_m: found.camera_from_object.translation.vector.into(),
        covariance: [0.0; 36],
    }
}

fn send_poses(
    outputs: &mut dyn Outputs,
    port: &Port<ObjectPoses<'static>>,
    key: FrameKey,
    header: &CameraFrameHeader,
    poses: &[ObjectPose],
) -> Result<(), NodeError> {
    port.send(outputs, key, ObjectPoses::byte_len(poses.len()), &mut |bytes| {
        ObjectPoses::write(bytes, header.scene_id, header.image_id, poses);
    })
}

impl Node for RectangleFinder {
    const KIND: &'static str = "rectangle_finder";
    const ROLE: Role = Role::Transform;
    type Config = RectangleFinderConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![FRAME.spec(), RECTANGLES.spec(), DETECTED.spec(), WANTED.spec()]
    }

    fn outputs() -> Vec<PortSpec> {
        vec![INITIAL_POSES.spec(), FOUND.spec()]
    }

    fn check(config: &RectangleFinderConfig) -> Result<(), NodeError> {
        config.compare.check()?;
        config.search.check()?;
        if config.max_instances == 0 {
            return Err("`max_instances: 0`: give at least 1".into());
        }
        ObjectSet::check(&config.objects)?;
        Ok(())
    }

    fn create(config: RectangleFinderConfig, _: &Context) -> Result<Self, NodeError> {
        let objects = ObjectSet::load(&config.objects)?;
        let comparer = Comparer::open(&config.compare, &objects, &config.engine)?;
        let patience = Patience::new(config.search);
        Ok(Self { objects, comparer, max_instances: config.max_instances, patience, answer: None })
    }

    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        self.find_late(inputs, outputs)?;
        let (key, frame) = (inputs.key(), FRAME.read(inputs)?);
        if !RECTANGLES.has_come(inputs) {
            return send_poses(outputs, &INITIAL_POSES, key, frame.header, &[]);
        }
        let seen = RECTANGLES.read(inputs)?;
        let poses = self.find(frame.header, frame.rgb, seen.rectangles)?;
        send_poses(outputs, &INITIAL_POSES, key, frame.header, &poses)?;
        send_poses(outputs, &FOUND, key, frame.header, &poses)
    }
}
