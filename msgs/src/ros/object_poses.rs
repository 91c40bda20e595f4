//! The house's [`ObjectPoses`](crate::ObjectPoses) as the world reads them, and a detector's poses as the house does.

use super::{
    BoundingBox3D, Detection3D, Detection3DArray, Header, ObjectHypothesis, ObjectHypothesisWithPose, Point, Pose,
    PoseStamped, PoseWithCovariance, Quaternion, TFMessage, Transform, TransformStamped, Vector3,
};
use crate::{ObjectPose, PoseSource, PoseStatus};
use std::collections::BTreeMap;

/// What objects are called outside: `class_id` of detections, child frames of transforms.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Naming(BTreeMap<u32, String>);

impl Naming {
    /// Takes names by object id.
    ///
    /// # Errors
    /// The name that two ids have, or that is another object's id.
    pub fn new(names: BTreeMap<u32, String>) -> Result<Self, String> {
        let naming = Self(names);
        match naming.0.iter().find(|(id, name)| naming.object_id(name) != Some(**id)) {
            Some((_, name)) => Err(name.clone()),
            None => Ok(naming),
        }
    }

    /// The object's name, or its id in digits where it has none.
    #[must_use]
    pub fn class_id(&self, object_id: u32) -> String {
        self.0.get(&object_id).cloned().unwrap_or_else(|| object_id.to_string())
    }

    /// The object that a detector means: by name, or by id in digits.
    #[must_use]
    pub fn object_id(&self, class_id: &str) -> Option<u32> {
        let by_digits = class_id.parse().ok();
        by_digits.or_else(|| self.0.iter().find(|(_, name)| *name == class_id).map(|(id, _)| *id))
    }

    /// The frame of an object: `object_5`, and `object_5_1` for its second instance.
    #[must_use]
    pub fn child_frame_id(pose: &ObjectPose) -> String {
        match pose.instance {
            0 => format!("object_{}", pose.object_id),
            instance => format!("object_{}_{instance}", pose.object_id),
        }
    }
}

fn is_ok(pose: &ObjectPose) -> bool {
    pose.status() == Some(PoseStatus::Ok)
}

/// The pose with the highest score among those that stand, of one object or of any; the first of equals.
#[must_use]
pub fn best_pose(poses: &[ObjectPose], object_id: Option<u32>) -> Option<&ObjectPose> {
    let candidates = poses.iter().filter(|p| is_ok(p) && object_id.is_none_or(|id| id == p.object_id));
    candidates.reduce(|best, pose| if pose.score > best.score { pose } else { best })
}

fn ros_pose(pose: &ObjectPose) -> Pose {
    let ([x, y, z], [qx, qy, qz, qw]) = (pose.translation_m, pose.rotation_xyzw);
    Pose { position: Point { x, y, z }, orientation: Quaternion { x: qx, y: qy, z: qz, w: qw } }
}

/// `/object_pose`: `header` is that of the image.
#[must_use]
pub fn pose_stamped(header: &Header, pose: &ObjectPose) -> PoseStamped {
    PoseStamped { header: header.clone(), pose: ros_pose(pose) }
}

/// `/object_poses`: every object. One whose refinement failed keeps its initial pose and gets score 0.
#[must_use]
pub fn detections(header: &Header, poses: &[ObjectPose], naming: &Naming) -> Detection3DArray {
    let detections = poses.iter().map(|pose| detection(header, pose, naming)).collect();
    Detection3DArray { header: header.clone(), detections }
}

fn detection(header: &Header, pose: &ObjectPose, naming: &Naming) -> Detection3D {
    let score = if is_ok(pose) { pose.score } else { 0.0 };
    let covariance = std::array::from_fn(|row| std::array::from_fn(|column| pose.covariance[row * 6 + column]));
    let result = ObjectHypothesisWithPose {
        hypothesis: ObjectHypothesis { class_id: naming.class_id(pose.object_id), score },
        pose: PoseWithCovariance { pose: ros_pose(pose), covariance },
    };
    Detection3D {
        header: header.clone(),
        results: vec![result],
        bbox: BoundingBox3D { center: ros_pose(pose), size: Vector3::default() },
        id: Naming::child_frame_id(pose),
    }
}

/// `/tf`: the optical frame to each object whose pose stands.
#[must_use]
pub fn transforms(header: &Header, poses: &[ObjectPose]) -> TFMessage {
    let transform = |pose: &ObjectPose| {
        let Pose { position: Point { x, y, z }, orientation: rotation } = ros_pose(pose);
        let transform = Transform { translation: Vector3 { x, y, z }, rotation };
        TransformStamped { header: header.clone(), child_frame_id: Naming::child_frame_id(pose), transform }
    };
    TFMessage { transforms: poses.iter().filter(|pose| is_ok(pose)).map(transform).collect() }
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
    /// A score or a covariance that is no number.
    #[error("the score or covariance of `{0}` is not finite: mend the detector")]
    NotFinite(String),
}

/// A detector's answer as initial poses, and what could not be used. Each detection counts with its likeliest
/// result; instances of an object are numbered in their order.
#[must_use]
pub fn object_poses(array: &Detection3DArray, naming: &Naming) -> (Vec<ObjectPose>, Vec<DetectionError>) {
    let (mut poses, mut errors) = (Vec::new(), Vec::new());
    let mut instances = BTreeMap::<u32, u32>::new();
    for detection in &array.detections {
        match object_pose(detection, naming) {
            Ok(mut pose) => {
                let next = instances.entry(pose.object_id).or_default();
                (pose.instance, *next) = (*next, *next + 1);
                poses.push(pose);
            }
            Err(error) => errors.push(error),
        }
    }
    (poses, errors)
}

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
    let covariance = result.pose.covariance;
    if !(score(result).is_finite() && covariance.iter().flatten().all(|v| v.is_finite())) {
        return Err(DetectionError::NotFinite(class_id.clone()));
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
    fn the_best_pose_is_one_that_stands() {
        let poses = [
            pose(1, 0, PoseStatus::Rejected, 0.99),
            pose(1, 1, PoseStatus::Ok, 0.5),
            pose(2, 0, PoseStatus::Ok, 0.8),
            pose(2, 1, PoseStatus::Ok, 0.8),
        ];
        assert_eq!(best_pose(&poses, None), Some(&poses[2]));
        assert_eq!(best_pose(&poses, Some(1)), Some(&poses[1]));
        assert_eq!(best_pose(&poses, Some(9)), None);
        assert_eq!(best_pose(&poses[..1], None), None);
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
        assert_eq!(said(&array.detections[0]), ("object_5".into(), hypothesis("mustard", 0.7)));
        assert_eq!(said(&array.detections[1]), ("object_6_2".into(), hypothesis("6", 0.0)));
        assert_eq!(array.detections[0].results[0].pose.covariance[1][2], 8.0);

        let tf: TFMessage = through_cdr(&transforms(&header(), &poses));
        assert_eq!(tf.transforms.len(), 1);
        assert_eq!(tf.transforms[0].child_frame_id, "object_5");
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
        let mut array = detections(&header(), &[pose(5, 0, PoseStatus::Ok, 0.7); 7], &naming());
        array.detections[0].results.clear();
        array.detections[1].results[0].hypothesis.class_id = "teapot".into();
        array.detections[2].results[0].pose.pose.position.x = f64::NAN;
        array.detections[3].results[0].pose.pose.orientation = Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 0.0 };
        array.detections[4].results[0].hypothesis.score = f64::INFINITY;
        array.detections[5].results[0].hypothesis.score = f64::NAN;
        array.detections[6].results[0].pose.covariance[5][5] = f64::NAN;
        let (poses, errors) = object_poses(&array, &naming());
        assert!(poses.is_empty());
        let not_finite = || DetectionError::NotFinite("mustard".into());
        let not_a_pose = || DetectionError::NotAPose("mustard".into());
        let expected = [
            DetectionError::Empty("object_5".into()),
            DetectionError::UnknownClass("teapot".into()),
            not_a_pose(),
            not_a_pose(),
            not_finite(),
            not_finite(),
            not_finite(),
        ];
        assert_eq!(errors, expected);
    }

    #[test]
    fn names_must_be_unambiguous() {
        let names = |pairs: [(u32, &str); 2]| Naming::new(pairs.map(|(id, name)| (id, name.to_owned())).into());
        assert_eq!(names([(1, "a"), (2, "a")]).unwrap_err(), "a");
        assert_eq!(names([(1, "2"), (2, "b")]).unwrap_err(), "2");
        assert!(names([(1, "a"), (2, "2")]).is_ok());
    }
}
