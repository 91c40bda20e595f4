//! The house's [`ObjectPoses`](crate::ObjectPoses) as the world reads them, and a detector's poses as the house does.

use super::follow::stands;
use super::{
    Detection3D, Detection3DArray, Header, Naming, ObjectHypothesis, ObjectHypothesisWithPose, Point, Pose,
    PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped, Quaternion, TFMessage, Transform, TransformStamped,
    Vector3,
};
use crate::{ObjectPose, PoseSource, PoseStatus};
use std::collections::{BTreeMap, BTreeSet};

impl From<&ObjectPose> for Pose {
    fn from(pose: &ObjectPose) -> Self {
        let ([x, y, z], [qx, qy, qz, qw]) = (pose.translation_m, pose.rotation_xyzw);
        Self { position: Point { x, y, z }, orientation: Quaternion { x: qx, y: qy, z: qz, w: qw } }
    }
}

impl From<&ObjectPose> for PoseWithCovariance {
    fn from(pose: &ObjectPose) -> Self {
        let covariance = std::array::from_fn(|row| std::array::from_fn(|column| pose.covariance[row * 6 + column]));
        Self { pose: pose.into(), covariance }
    }
}

/// The poses that stand, and those that do not.
#[must_use]
pub fn standing(poses: &[ObjectPose]) -> (Vec<ObjectPose>, Vec<ObjectPose>) {
    poses.iter().copied().partition(stands)
}

/// `object_pose`: `header` is that of the image.
#[must_use]
pub fn pose_stamped(header: &Header, pose: &ObjectPose) -> PoseStamped {
    PoseStamped { header: header.clone(), pose: pose.into() }
}

/// `objects/NAME/pose`: `header` is that of the image.
#[must_use]
pub fn pose_with_covariance_stamped(header: &Header, pose: &ObjectPose) -> PoseWithCovarianceStamped {
    PoseWithCovarianceStamped { header: header.clone(), pose: pose.into() }
}

/// Poses as detections: one for each instance, named as its frame; further poses of an instance are further results.
/// The box is that of the first.
#[must_use]
pub fn detections(header: &Header, poses: &[ObjectPose], naming: &Naming) -> Detection3DArray {
    let detections = ObjectPose::likeliest(poses).map(|pose| {
        let same = poses.iter().filter(|other| other.identity() == pose.identity());
        detection(header, pose, same.map(|pose| result(pose, naming)).collect(), naming)
    });
    Detection3DArray { header: header.clone(), detections: detections.collect() }
}

fn detection(
    header: &Header,
    pose: &ObjectPose,
    results: Vec<ObjectHypothesisWithPose>,
    naming: &Naming,
) -> Detection3D {
    let id = naming.token(pose.object_id, pose.instance);
    Detection3D { header: header.clone(), results, bbox: naming.bounding_box(pose), id }
}

fn result(pose: &ObjectPose, naming: &Naming) -> ObjectHypothesisWithPose {
    let hypothesis = ObjectHypothesis { class_id: naming.class_id(pose.object_id), score: pose.score };
    ObjectHypothesisWithPose { hypothesis, pose: pose.into() }
}

/// `/tf`: the optical frame to each object whose pose stands; frames are `prefix` and the object's token.
#[must_use]
pub fn transforms(header: &Header, poses: &[ObjectPose], naming: &Naming, prefix: &str) -> TFMessage {
    let transform = |pose: &ObjectPose| {
        let Pose { position: Point { x, y, z }, orientation: rotation } = pose.into();
        let transform = Transform { translation: Vector3 { x, y, z }, rotation };
        let child_frame_id = format!("{prefix}{}", naming.token(pose.object_id, pose.instance));
        TransformStamped { header: header.clone(), child_frame_id, transform }
    };
    TFMessage { transforms: ObjectPose::likeliest(poses).filter(|pose| stands(pose)).map(transform).collect() }
}

/// Why a detection is no initial pose.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DetectionError {
    /// It says neither what nor where.
    #[error("detection `{0}` has no results: the detector must fill results[0] with class and pose")]
    Empty(String),
    /// An object that is not in the set.
    #[error("class_id `{0}` is no known object: use an object's id in digits, or name it in `object_names`")]
    UnknownClass(String),
    /// A number is not finite or the quaternion is not of unit length.
    #[error("the pose of `{0}` is not finite or its quaternion not of unit length: mend the detector")]
    NotAPose(String),
    /// A score that is no number.
    #[error("the score of `{0}` is {1}: mend the detector")]
    Score(String, f64),
    /// A covariance that is no number.
    #[error("the covariance of `{0}` is not finite: mend the detector")]
    Covariance(String),
}

impl DetectionError {
    /// The reason in a word or two, for counting.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Empty(_) => "empty",
            Self::UnknownClass(_) => "unknown object",
            Self::NotAPose(_) => "pose",
            Self::Score(..) => "score",
            Self::Covariance(_) => "covariance",
        }
    }
}

/// A detector's answer as initial poses, and what could not be used. Each detection counts with its likeliest
/// result. An instance is the one that the detection's `id` names; else instances of an object are numbered in their order.
#[must_use]
pub fn object_poses(array: &Detection3DArray, naming: &Naming) -> (Vec<ObjectPose>, Vec<DetectionError>) {
    let (mut poses, mut errors) = (Vec::new(), Vec::new());
    let (mut instances, mut free) = (BTreeSet::<(u32, u32)>::new(), BTreeMap::<u32, u32>::new());
    for detection in &array.detections {
        match object_pose(detection, naming) {
            Ok(mut pose) => {
                let taken = |instance: &u32| instances.contains(&(pose.object_id, *instance));
                let said = naming.instance(pose.object_id, &detection.id).filter(|instance| !taken(instance));
                let free = free.entry(pose.object_id).or_insert(0);
                pose.instance = said.unwrap_or_else(|| {
                    // What is below is taken for good: no message makes this search long.
                    *free = (*free..).find(|instance| !taken(instance)).unwrap_or_default();
                    *free
                });
                instances.insert(pose.identity());
                poses.push(pose);
            }
            Err(error) => errors.push(error),
        }
    }
    (poses, errors)
}

/// A quaternion this close to unit length is taken as it came, so that what we wrote comes back to the bit.
const ROUNDING: f64 = 1e-12;

fn object_pose(detection: &Detection3D, naming: &Naming) -> Result<ObjectPose, DetectionError> {
    let likeliest = detection.results.iter().reduce(|a, b| if score(b) > score(a) { b } else { a });
    let result = likeliest.ok_or(DetectionError::Empty(detection.id.clone()))?;
    let class_id = &result.hypothesis.class_id;
    let object_id = naming.object_id(class_id).ok_or(DetectionError::UnknownClass(class_id.clone()))?;
    let Pose { position: p, orientation: q } = result.pose.pose;
    let norm = (q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w).sqrt();
    if !((norm - 1.0).abs() < 1e-3 && [p.x, p.y, p.z].iter().all(|v| v.is_finite())) {
        return Err(DetectionError::NotAPose(class_id.clone()));
    }
    if !score(result).is_finite() {
        return Err(DetectionError::Score(class_id.clone(), score(result)));
    }
    let norm = if (norm - 1.0).abs() < ROUNDING { 1.0 } else { norm };
    let covariance = result.pose.covariance;
    if !covariance.iter().flatten().all(|v| v.is_finite()) {
        return Err(DetectionError::Covariance(class_id.clone()));
    }
    Ok(ObjectPose {
        object_id,
        instance: 0,
        status: PoseStatus::Ok as u32,
        source: PoseSource::Given as u32,
        score: score(result),
        rotation_xyzw: [q.x / norm, q.y / norm, q.z / norm, q.w / norm],
        translation_m: [p.x, p.y, p.z],
        covariance: std::array::from_fn(|i| covariance[i / 6][i % 6]),
    })
}

fn score(result: &ObjectHypothesisWithPose) -> f64 {
    result.hypothesis.score
}

#[cfg(test)]
mod tests {
    use super::super::{PoseStamped, RosMessage, Time, from_cdr, to_cdr};
    use super::*;

    fn pose(object_id: u32, instance: u32, status: PoseStatus, score: f64) -> ObjectPose {
        ObjectPose {
            object_id,
            instance,
            status: status as u32,
            source: PoseSource::Given as u32,
            score,
            rotation_xyzw: [0.5, -0.5, 0.5, 0.5],
            translation_m: [0.1, 0.2, 0.3],
            covariance: std::array::from_fn(|i| i as f64),
        }
    }

    fn through_cdr<M: RosMessage>(message: &M) -> M {
        from_cdr(&to_cdr(message).unwrap()).unwrap()
    }

    fn header() -> Header {
        Header { stamp: Time { sec: 3, nanosec: 4 }, frame_id: "camera_optical".into() }
    }

    fn naming() -> Naming {
        Naming::new([(5, "mustard".to_owned())].into()).unwrap()
    }

    #[test]
    fn messages_keep_stamp_frame_pose_and_covariance() {
        let poses = [pose(5, 0, PoseStatus::Ok, 0.7), pose(6, 2, PoseStatus::TooFewPoints, 0.9)];
        let stamped: PoseStamped = through_cdr(&pose_stamped(&header(), &poses[0]));
        assert_eq!(stamped.header, header());
        assert_eq!(stamped.pose.position, Point { x: 0.1, y: 0.2, z: 0.3 });
        assert_eq!(stamped.pose.orientation, Quaternion { x: 0.5, y: -0.5, z: 0.5, w: 0.5 });

        let array: Detection3DArray = through_cdr(&detections(&header(), &poses, &naming()));
        let said = |d: &Detection3D| (d.id.clone(), d.results[0].hypothesis.clone());
        let hypothesis = |class_id: &str, score| ObjectHypothesis { class_id: class_id.into(), score };
        assert_eq!(said(&array.detections[0]), ("mustard".into(), hypothesis("mustard", 0.7)));
        assert_eq!(said(&array.detections[1]), ("object_6_2".into(), hypothesis("6", 0.9)));
        assert_eq!(array.detections[0].results[0].pose.covariance[1][2], 8.0);

        let tf: TFMessage = through_cdr(&transforms(&header(), &poses, &naming(), "left/"));
        assert_eq!(tf.transforms.len(), 1);
        assert_eq!(tf.transforms[0].child_frame_id, "left/mustard");
        assert_eq!(tf.transforms[0].transform.translation, Vector3 { x: 0.1, y: 0.2, z: 0.3 });
    }

    #[test]
    fn detections_come_back_as_initial_poses() {
        let sent = [pose(5, 0, PoseStatus::Ok, 0.7), pose(6, 0, PoseStatus::Ok, 0.6), pose(5, 1, PoseStatus::Ok, 0.5)];
        let (received, errors) = object_poses(&detections(&header(), &sent, &naming()), &naming());
        assert_eq!((received.as_slice(), errors.len()), (sent.as_slice(), 0));
    }

    #[test]
    fn unusable_detections_say_why() {
        let poses = [0, 1, 2, 3, 4].map(|instance| pose(5, instance, PoseStatus::Ok, 0.7));
        let mut array = detections(&header(), &poses, &naming());
        array.detections[0].results.clear();
        array.detections[1].results[0].hypothesis.class_id = "teapot".into();
        array.detections[2].results[0].pose.pose.position.x = f64::NAN;
        array.detections[3].results[0].pose.pose.orientation = Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 0.0 };
        array.detections[4].results[0].pose.covariance[5][5] = f64::NAN;
        let (poses, errors) = object_poses(&array, &naming());
        assert!(poses.is_empty());
        let not_a_pose = || DetectionError::NotAPose("mustard".into());
        let expected = [
            DetectionError::Empty("mustard".into()),
            DetectionError::UnknownClass("teapot".into()),
            not_a_pose(),
            not_a_pose(),
            DetectionError::Covariance("mustard".into()),
        ];
        assert_eq!(errors, expected);
    }

    #[test]
    fn hypotheses_of_one_instance_are_results_of_one_detection() {
        let mut second = pose(5, 0, PoseStatus::Ok, 0.4);
        second.translation_m = [9.0, 9.0, 9.0];
        let poses = [pose(5, 0, PoseStatus::Ok, 0.7), second, pose(5, 1, PoseStatus::Ok, 0.6)];
        let array = detections(&header(), &poses, &naming());
        let results: Vec<_> = array.detections.iter().map(|d| (d.id.as_str(), d.results.len())).collect();
        assert_eq!(results, [("mustard", 2), ("mustard_1", 1)]);
        assert_eq!(array.detections[0].bbox.center, Pose::from(&poses[0]));
        assert_eq!(object_poses(&array, &naming()).0, [poses[0], poses[2]]);
    }

    #[test]
    fn instances_keep_their_numbers_and_poses_their_bits() {
        let mut turned = pose(5, 3, PoseStatus::Ok, 0.7);
        turned.rotation_xyzw = [0.1, 0.7, 0.1, 0.7].map(|v: f64| v / 1.0_f64.sqrt() + f64::EPSILON);
        let (received, _) = object_poses(&detections(&header(), &[turned], &naming()), &naming());
        assert_eq!(received, [turned]);
        let (good, bad) = standing(&[turned, pose(5, 0, PoseStatus::Rejected, 0.2)]);
        assert_eq!((good.len(), bad.len()), (1, 1));
    }
}
