use crate::TrackerNodeConfig;
use crate::late::Late;
use pseudoflow_contour::{ModelSettings, image_of_bytes, load_or_make};
use pseudoflow_geometry::{Intrinsics, pose_from_quaternion, quaternion_xyzw};
use pseudoflow_imaging::{Object, ObjectSet};
use pseudoflow_msgs::{
    CameraFrame, FrameKey, ObjectPose, ObjectPoses, ObjectStatus, ObjectStatuses, PoseSource, PoseStatus, TrackPhase,
    TrackReason, Wanted,
};
use pseudoflow_runtime::{Context, Inputs, Node, NodeError, Outputs, Port, PortSpec, Role};
use pseudoflow_tracking::{
    Correction, CorrectionKind, Estimate, Frame, FrameProblem, KnownObject, Look, Phase, Step, Tracker,
};
use std::collections::VecDeque;

const FRAME: Port<CameraFrame<'static>> = Port::required("frame");
const FOUND: Port<ObjectPoses<'static>> = Port::late("found");
const LOOKS: Port<ObjectPoses<'static>> = Port::late("looks");
const SEARCH: Port<ObjectStatuses<'static>> = Port::latest("search");
const POSES: Port<ObjectPoses<'static>> = Port::required("poses");
const REQUESTS: Port<ObjectPoses<'static>> = Port::optional("requests");
const WANTED: Port<Wanted<'static>> = Port::optional("wanted");
const STATUS: Port<ObjectStatuses<'static>> = Port::optional("status");

/// Frames and corrections in, poses out.
pub struct TrackerNode {
    config: TrackerNodeConfig,
    tracker: Tracker,
    ids: Vec<u32>,
    looks: Late,
    found: Late,
    replay: bool,
    /// Frame that this process began with.
    first: Option<u64>,
    sent: VecDeque<Sent>,
}

/// What was sent for a frame: another node's death may bring it back.
struct Sent {
    key: FrameKey,
    image: (u32, u32),
    poses: Vec<ObjectPose>,
    requests: Vec<ObjectPose>,
    wanted: Vec<u32>,
    statuses: Vec<ObjectStatus>,
}

/// Frames that are remembered; more than are in flight.
const REMEMBERED: usize = 128;

impl TrackerNode {
    /// Follows all objects into a frame.
    fn follow(&mut self, inputs: &dyn Inputs) -> Result<Sent, NodeError> {
        let frame = FRAME.read(inputs)?;
        let (header, key) = (frame.header, inputs.key());
        self.looks.absorb(inputs, self.replay)?;
        self.found.absorb(inputs, self.replay)?;
        if inputs.is_connected(LOOKS.name()) {
            self.tracker.expect_looks();
        }
        let corrections = self.corrections(key.index);
        let [fx, fy, cx, cy] = header.intrinsics;
        let rgb = image_of_bytes(frame.rgb, header.width as usize, header.height as usize)?;
        let seen =
            Frame { index: key.index, stamp_ns: key.stamp_ns, rgb: &rgb, intrinsics: Intrinsics { fx, fy, cx, cy } };
        let step = self.tracker.step(&seen, &corrections);
        if let Some(problem) = step.problem {
            log::warn!("frame {}: {problem}", key.index);
        }
        let looks = if step.problem.is_none() { self.tracker.ask() } else { Vec::new() };
        Ok(Sent {
            key,
            image: (header.scene_id, header.image_id),
            poses: step.estimates.iter().filter_map(pose).collect(),
            requests: looks.iter().map(request).collect(),
            wanted: self.tracker.missing(),
            statuses: self.statuses(inputs, &step)?,
        })
    }

    /// Where each object stands. What the search cannot look for yet is said in the search's own words.
    fn statuses(&self, inputs: &dyn Inputs, step: &Step) -> Result<Vec<ObjectStatus>, NodeError> {
        let searched = SEARCH.given(inputs)?.map_or(&[][..], |said| said.statuses);
        let preparing = |own: &ObjectStatus| {
            let prepares =
                |s: &&ObjectStatus| s.object_id == own.object_id && s.reason == TrackReason::Preparing as u32;
            searched.iter().find(prepares).filter(|_| own.reason == TrackReason::NotFound as u32).copied()
        };
        let own = self.ids.iter().map(|id| status(*id, &step.estimates, step.problem));
        Ok(own.map(|own| preparing(&own).unwrap_or(own)).collect())
    }

    /// What others have found and what is to be used in a frame.
    fn corrections(&mut self, index: u64) -> Vec<Correction> {
        let replay = self.replay;
        let take = |late: &mut Late, delay: u64| match (replay, index.checked_sub(delay)) {
            (false, _) => late.take_until(u64::MAX - 1),
            (true, Some(until)) => late.take_until(until),
            (true, None) => Default::default(),
        };
        let found = take(&mut self.found, self.config.found_delay);
        let looks = take(&mut self.looks, self.config.look_delay);
        let least = self.config.look_score;
        let found =
            found.iter().flat_map(|(f, all)| all.iter().filter_map(|p| correction(*f, p, CorrectionKind::Found)));
        let looks = looks.iter().flat_map(|(f, all)| all.iter().filter_map(|p| looked(*f, p, least)));
        found.chain(looks).collect()
    }

    fn waits(&self, inputs: &dyn Inputs, late: &Late, delay: u64) -> bool {
        let Some(wanted) = inputs.key().index.checked_sub(delay) else { return false };
        let asked = self.first.is_some_and(|first| wanted >= first);
        asked && late.is_connected(inputs) && !late.has(inputs, wanted)
    }
}

/// The pose of an object that is followed; `None` while it is only searched for, or lost.
fn pose(e: &Estimate) -> Option<ObjectPose> {
    (e.phase == Phase::Tracking).then(|| ObjectPose {
        object_id: e.object_id,
        instance: 0,
        status: PoseStatus::Ok as u32,
        source: if e.measured { PoseSource::Refined } else { PoseSource::Tracked } as u32,
        score: e.confidence,
        rotation_xyzw: quaternion_xyzw(&e.camera_from_object),
        translation_m: e.camera_from_object.translation.vector.into(),
        covariance: e.covariance,
    })
}

/// What pnp says of a pose that it was asked to look at in a frame; its score counts from `least` on.
#[must_use]
pub fn looked(frame: u64, pose: &ObjectPose, least: f64) -> Option<Correction> {
    let better = pose.source == PoseSource::Refined as u32 && pose.status() == Some(PoseStatus::Ok);
    correction(frame, pose, CorrectionKind::Look { accepted: better && pose.score >= least, score: pose.score })
}

fn correction(frame: u64, p: &ObjectPose, kind: CorrectionKind) -> Option<Correction> {
    let camera_from_object = pose_from_quaternion(&p.rotation_xyzw, &p.translation_m).ok()?;
    Some(Correction { object_id: p.object_id, frame, camera_from_object, kind })
}

/// A look that is asked for, as the renderer takes it.
#[must_use]
pub fn request(look: &Look) -> ObjectPose {
    ObjectPose {
        object_id: look.object_id,
        instance: 0,
        status: PoseStatus::Ok as u32,
        source: PoseSource::Tracked as u32,
        score: 0.0,
        rotation_xyzw: quaternion_xyzw(&look.camera_from_object),
        translation_m: look.camera_from_object.translation.vector.into(),
        covariance: [0.0; 36],
    }
}

fn status(object_id: u32, estimates: &[Estimate], problem: Option<FrameProblem>) -> ObjectStatus {
    let e = estimates.iter().find(|e| e.object_id == object_id);
    let phase = match e.map(|e| e.phase) {
        Some(Phase::Tracking) => TrackPhase::Tracking,
        Some(Phase::Lost) => TrackPhase::Lost,
        Some(Phase::Searching) | None => TrackPhase::Searching,
    };
    let reason = match (problem, e) {
        (Some(FrameProblem::OutOfOrder), _) => TrackReason::OutOfOrder,
        (Some(FrameProblem::Dark), _) => TrackReason::Dark,
        (None, None) => TrackReason::NotFound,
        (None, Some(e)) => match (e.phase, e.measured) {
            (Phase::Searching, _) => TrackReason::Detected,
            (Phase::Tracking, true) => TrackReason::Confirmed,
            (Phase::Tracking, false) => TrackReason::Hidden,
            (Phase::Lost, _) => TrackReason::NotSeen,
        },
    };
    ObjectStatus {
        object_id,
        instance: 0,
        phase: phase as u32,
        reason: reason as u32,
        good_frames: e.map_or(0, |e| e.good_frames),
        bad_frames: e.map_or(0, |e| e.bad_frames),
        score: e.map_or(0.0, |e| e.confidence),
    }
}

/// The objects of the set that are expected, with their contours.
fn known(config: &TrackerNodeConfig) -> Result<Vec<KnownObject>, NodeError> {
    let set = ObjectSet::load(&config.objects)?;
    if let Some(id) = config.expected.iter().flatten().find(|id| !set.ids().contains(id)) {
        return Err(format!("`expected`: there is no object {id}; the set has {:?}", set.ids()).into());
    }
    let cache = config.contours.clone().unwrap_or_else(|| std::env::temp_dir().join("pseudoflow-contours"));
    let expected = |o: &&Object| config.expected.as_ref().is_none_or(|ids| ids.contains(&o.id));
    let known = |o: &Object| -> Result<KnownObject, NodeError> {
        let contour = load_or_make(&o.mesh, &ModelSettings::default(), &cache)?;
        Ok(KnownObject { id: o.id, mesh: o.mesh.clone(), contour, diameter_m: o.diameter_m })
    };
    set.iter().filter(expected).map(known).collect()
}

impl Node for TrackerNode {
    const KIND: &'static str = "tracker";
    const ROLE: Role = Role::Transform;
    type Config = TrackerNodeConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![FRAME.spec(), FOUND.spec(), LOOKS.spec(), SEARCH.spec()]
    }

    fn outputs() -> Vec<PortSpec> {
        vec![POSES.spec(), REQUESTS.spec(), WANTED.spec(), STATUS.spec()]
    }

    fn check(config: &TrackerNodeConfig) -> Result<(), NodeError> {
        config.check()
    }

    fn create(config: TrackerNodeConfig, context: &Context) -> Result<Self, NodeError> {
        let objects = known(&config)?;
        let ids: Vec<u32> = objects.iter().map(|o| o.id).collect();
        log::info!("follows objects {ids:?}");
        Ok(Self {
            tracker: Tracker::new(objects, config.track.clone())?,
            config,
            ids,
            looks: Late::new(&LOOKS),
            found: Late::new(&FOUND),
            replay: context.replay,
            first: None,
            sent: VecDeque::new(),
        })
    }

    fn ready(&self, inputs: &dyn Inputs) -> Result<bool, NodeError> {
        let again = self.sent.iter().any(|sent| sent.key.index == inputs.key().index);
        let waits = self.waits(inputs, &self.looks, self.config.look_delay)
            || self.waits(inputs, &self.found, self.config.found_delay);
        Ok(!self.replay || again || !waits)
    }

    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        let index = inputs.key().index;
        self.first.get_or_insert(index);
        if let Some(sent) = self.sent.iter().find(|sent| sent.key.index == index) {
            self.looks.absorb(inputs, self.replay)?;
            self.found.absorb(inputs, self.replay)?;
            return send(outputs, sent, self.replay);
        }
        let sent = self.follow(inputs)?;
        send(outputs, &sent, self.replay)?;
        self.sent.push_back(sent);
        if self.sent.len() > REMEMBERED {
            self.sent.pop_front();
        }
        Ok(())
    }
}

/// Live, nothing is asked for where nothing is wanted: empty requests would push those aside that the network is still busy with.
fn send(outputs: &mut dyn Outputs, sent: &Sent, replay: bool) -> Result<(), NodeError> {
    let (scene_id, image_id) = sent.image;
    let asks = replay || !sent.requests.is_empty();
    let requests = asks.then_some((&REQUESTS, &sent.requests));
    for (port, poses) in std::iter::once((&POSES, &sent.poses)).chain(requests) {
        port.send(outputs, sent.key, ObjectPoses::byte_len(poses.len()), &mut |bytes| {
            ObjectPoses::write(bytes, scene_id, image_id, poses);
        })?;
    }
    WANTED.send(outputs, sent.key, Wanted::byte_len(sent.wanted.len()), &mut |bytes| {
        Wanted::write(bytes, scene_id, image_id, &sent.wanted);
    })?;
    STATUS.send(outputs, sent.key, ObjectStatuses::byte_len(sent.statuses.len()), &mut |bytes| {
        ObjectStatuses::write(bytes, false, &sent.statuses);
    })
}
