use crate::Message;
use crate::layout::{Length, MalformedMessage, Reader, Writer};
use bytemuck::{Pod, Zeroable};

/// Who made a pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum PoseSource {
    /// A file, a bag or an outside detector.
    Given = 0,
    /// The initializer node.
    Initializer = 1,
    /// Measured in this frame: by pnp, or by the tracker.
    Refined = 2,
    /// Predicted from the frames before, by the initializer or the tracker: this frame does not show it.
    Tracked = 3,
}

/// What became of an object in a frame. `Ok` and, where the solution was better than its start, `NotSeen` carry a new pose; the
/// others carry the initial one on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum PoseStatus {
    /// The pose stands.
    Ok = 0,
    /// Fewer than four usable correspondences.
    TooFewPoints = 1,
    /// RANSAC found no pose that enough correspondences agree with.
    TooFewInliers = 2,
    /// A number became NaN or infinite.
    NotFinite = 3,
    /// The points do not fix a pose (collinear, or all at one place).
    Degenerate = 4,
    /// The solution puts the object behind the camera.
    BehindCamera = 5,
    /// The refinement was judged worse than what it began from.
    Rejected = 6,
    /// The object's crop could not be rendered (outside the image, or behind the camera).
    NotVisible = 7,
    /// Flow and picture say that the object is not at this pose: nothing of it can be seen there.
    NotSeen = 8,
}

impl PoseStatus {
    const ALL: [Self; 9] = [
        Self::Ok,
        Self::TooFewPoints,
        Self::TooFewInliers,
        Self::NotFinite,
        Self::Degenerate,
        Self::BehindCamera,
        Self::Rejected,
        Self::NotVisible,
        Self::NotSeen,
    ];

    /// The status of a stored number.
    #[must_use]
    pub fn from_u32(value: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|status| *status as u32 == value)
    }
}

/// One object's pose in one frame.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct ObjectPose {
    /// Id of the object in its set (BOP `obj_id`).
    pub object_id: u32,
    /// Tells instances of one object apart. Initial poses of one object with the same number are hypotheses of one instance,
    /// the likeliest first; pnp keeps one of them.
    pub instance: u32,
    /// A [`PoseStatus`].
    pub status: u32,
    /// A [`PoseSource`].
    pub source: u32,
    /// Confidence in 0..1. Of what pnp has solved: the probability, learnt on synthetic pairs, that ADD(-S) is below a tenth of
    /// the diameter; 0 where it could not solve. Else the source's own score.
    pub score: f64,
    /// Rotation of `camera_from_object`, unit quaternion x, y, z, w.
    pub rotation_xyzw: [f64; 4],
    /// Translation of `camera_from_object`, metres.
    pub translation_m: [f64; 3],
    /// Row-major 6 x 6, order x, y, z (m), rotation about x, y, z (rad), fixed camera axes; zero where unknown. Of a refined pose
    /// scaled such that its 95 % ellipsoid held 95 % of the truths of synthetic pairs.
    pub covariance: [f64; 36],
}

impl ObjectPose {
    /// The status as a type; `None` for a number without meaning.
    #[must_use]
    pub fn status(&self) -> Option<PoseStatus> {
        PoseStatus::from_u32(self.status)
    }

    /// Object and instance.
    #[must_use]
    pub fn identity(&self) -> (u32, u32) {
        (self.object_id, self.instance)
    }

    /// The likeliest pose of each instance.
    pub fn likeliest(poses: &[Self]) -> impl Iterator<Item = &Self> {
        let first = |(i, pose): &(usize, &Self)| poses[..*i].iter().all(|p| p.identity() != pose.identity());
        poses.iter().enumerate().filter(first).map(|(_, pose)| pose)
    }
}

/// What stands before the poses.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct ObjectPosesHeader {
    /// How many poses follow.
    pub count: u32,
    /// BOP scene of the frame; 0 where there is none.
    pub scene_id: u32,
    /// BOP image of the frame.
    pub image_id: u32,
    /// Keeps the size a multiple of 8.
    pub reserved: u32,
}

/// The poses of all known objects in one frame.
///
/// Producers: player, initializer (`initial_poses`), pnp, tracker (`poses`; `requests`: the looks that it asks for). Consumers:
/// renderer, bridge, recorder, evaluator, initializer (the poses of the frames before), tracker (what others have found).
///
/// ```
/// use pseudoflow_msgs::{AlignedBytes, Message, ObjectPose, ObjectPoses, PoseStatus};
///
/// let mut mug: ObjectPose = bytemuck::Zeroable::zeroed();
/// mug.object_id = 7;
/// mug.status = PoseStatus::Ok as u32;
/// mug.rotation_xyzw = [0.0, 0.0, 0.0, 1.0];
/// mug.translation_m = [0.1, 0.0, 0.8];
///
/// // One block of bytes, written once: in a graph it lies in shared memory.
/// let mut bytes = AlignedBytes::zeroed(ObjectPoses::byte_len(1));
/// ObjectPoses::write(&mut bytes, 0, 0, &[mug]);
///
/// // Read in place.
/// let message = ObjectPoses::view(&bytes)?;
/// assert_eq!(message.poses, [mug]);
/// # Ok::<(), pseudoflow_msgs::MalformedMessage>(())
/// ```
#[derive(Debug, Clone, Copy)]
pub struct ObjectPoses<'a> {
    /// Count and names.
    pub header: &'a ObjectPosesHeader,
    /// The poses.
    pub poses: &'a [ObjectPose],
}

impl ObjectPoses<'_> {
    /// Bytes of a message of this many poses.
    #[must_use]
    pub fn byte_len(count: usize) -> usize {
        Length::default().and::<ObjectPosesHeader>(1).and::<ObjectPose>(count).bytes()
    }

    /// Writes a whole message.
    ///
    /// # Panics
    /// When `bytes` is shorter than [`Self::byte_len`] or not aligned to 64 bytes.
    pub fn write(bytes: &mut [u8], scene_id: u32, image_id: u32, poses: &[ObjectPose]) {
        let mut writer = Writer::new(bytes);
        writer.one(ObjectPosesHeader { count: poses.len() as u32, scene_id, image_id, reserved: 0 });
        writer.array::<ObjectPose>(poses.len()).copy_from_slice(poses);
    }
}

impl Message for ObjectPoses<'static> {
    const TYPE_NAME: &'static str = "ObjectPoses@1";
    type View<'a> = ObjectPoses<'a>;

    fn view(bytes: &[u8]) -> Result<ObjectPoses<'_>, MalformedMessage> {
        let mut reader = Reader::new(Self::TYPE_NAME, bytes)?;
        let header = reader.one::<ObjectPosesHeader>("header")?;
        let poses = reader.array::<ObjectPose>("poses", header.count as usize)?;
        match poses.iter().find(|pose| pose.status().is_none()) {
            Some(pose) => Err(MalformedMessage::Field {
                message: Self::TYPE_NAME,
                field: "status",
                value: pose.status.to_string(),
            }),
            None => Ok(ObjectPoses { header, poses }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AlignedBytes;

    #[test]
    fn the_likeliest_pose_of_each_instance_comes_first() {
        let pose = |object_id, instance, score| {
            let zeroed: ObjectPose = bytemuck::Zeroable::zeroed();
            ObjectPose { object_id, instance, score, ..zeroed }
        };
        let poses = [pose(1, 0, 0.9), pose(1, 0, 0.8), pose(1, 1, 0.7), pose(2, 0, 0.6), pose(1, 0, 0.5)];
        let scores: Vec<f64> = ObjectPose::likeliest(&poses).map(|p| p.score).collect();
        assert_eq!(scores, [0.9, 0.7, 0.6]);
    }

    #[test]
    fn poses_round_trip_and_a_bad_status_is_named() {
        let mut pose: ObjectPose = bytemuck::Zeroable::zeroed();
        pose.object_id = 7;
        let mut bytes = AlignedBytes::zeroed(ObjectPoses::byte_len(2));
        ObjectPoses::write(&mut bytes, 1, 2, &[pose, pose]);
        assert_eq!(ObjectPoses::view(&bytes).unwrap().poses, &[pose, pose]);
        pose.status = 99;
        ObjectPoses::write(&mut bytes, 1, 2, &[pose, pose]);
        assert!(matches!(ObjectPoses::view(&bytes), Err(MalformedMessage::Field { field: "status", .. })));
    }
}
