//! Objects over time: after a good pose the next frame starts from it, and the image is searched only for what is new or lost.
//!
//! Each object instance has a track. It is `Searching` until enough good frames in a row confirm a detection, then
//! `Tracking`, and `Lost` after enough bad ones; a lost one that is detected again keeps its number. Between frames a track
//! moves with constant velocity in SE(3).

mod config;
#[cfg(test)]
mod tests;

pub use config::TrackConfig;

use crate::detect::{Detection, Hypothesis, Rectangle, extent};
use nalgebra::Vector6;
use pseudoflow_geometry::{Intrinsics, Pose, exp_se3, log_se3, pose_from_quaternion, rotation_angle_rad};
use pseudoflow_imaging::{Object, ObjectSet};
use pseudoflow_msgs::{ObjectPose, ObjectStatus, PoseStatus, TrackPhase, TrackReason};

/// One instance over time.
#[derive(Debug, Clone, PartialEq)]
struct Track {
    object_id: u32,
    instance: u32,
    phase: TrackPhase,
    reason: TrackReason,
    /// Whether it has a pose to go on from: not when nothing of it has been found since it was lost.
    active: bool,
    /// Whether `pose` is a detection that no refinement has looked at.
    fresh: bool,
    pose: Pose,
    /// Of a fresh track: other poses that it may have.
    others: Vec<Hypothesis>,
    /// When it was there, nanoseconds.
    stamp_ns: i64,
    /// Motion in the object's frame, metres and radians per second.
    velocity: Vector6<f64>,
    good: u32,
    bad: u32,
    score: f64,
}

/// A pose to begin a frame from.
#[derive(Debug, Clone, PartialEq)]
pub struct Predicted {
    /// The object.
    pub object_id: u32,
    /// Its number.
    pub instance: u32,
    /// Where it should be, metres.
    pub camera_from_object: Pose,
    /// Of its last pose.
    pub score: f64,
    /// Whether it comes from earlier frames; else from a detection in this one.
    pub tracked: bool,
    /// Other poses that it may have instead: none for what is tracked.
    pub others: Vec<Hypothesis>,
}

/// All tracks.
#[derive(Debug, Clone)]
pub struct Tracker {
    config: TrackConfig,
    /// Ids and diameters of the objects.
    objects: Vec<(u32, f64)>,
    max_instances: usize,
    tracks: Vec<Track>,
    frames_since_search: Option<u32>,
}

/// A detection nearer than this to a track is that object, diameters.
const NEAR_DIAMETERS: f64 = 0.75;
/// Longest gap that a velocity is measured over or used for, seconds.
const MAX_GAP_S: f64 = 0.5;

impl Track {
    fn predict(&self, stamp_ns: i64) -> Pose {
        let seconds = (stamp_ns - self.stamp_ns) as f64 * 1e-9;
        if !(0.0..=MAX_GAP_S).contains(&seconds) {
            return self.pose;
        }
        self.pose * exp_se3(&(self.velocity * seconds))
    }

    /// Takes a new pose, and the velocity that follows from it. `keep` is the share of the measured velocity believed.
    fn move_to(&mut self, pose: Pose, stamp_ns: i64, keep: f64) {
        let seconds = (stamp_ns - self.stamp_ns) as f64 * 1e-9;
        let known = !self.fresh && self.good > 0 && seconds > 1e-6 && seconds <= MAX_GAP_S;
        self.velocity =
            if known { log_se3(&(self.pose.inverse() * pose)) * (keep / seconds) } else { Vector6::zeros() };
        (self.pose, self.stamp_ns, self.fresh) = (pose, stamp_ns, false);
        self.others.clear();
    }

    /// Whether the last frame did not confirm it.
    fn doubtful(&self) -> bool {
        self.phase == TrackPhase::Tracking && self.bad > 0
    }

    /// It may be where it is expected, or where it was detected: the refiner tries both.
    fn doubt(&mut self, detection: &Detection, stamp_ns: i64) {
        let expected = Hypothesis { camera_from_object: self.predict(stamp_ns), score: detection.score };
        self.others = std::iter::once(expected).chain(detection.others.iter().copied()).collect();
        (self.pose, self.stamp_ns, self.fresh) = (detection.camera_from_object, stamp_ns, true);
        self.velocity = Vector6::zeros();
    }

    fn stop(&mut self, phase: TrackPhase, reason: TrackReason) {
        (self.phase, self.reason, self.active, self.good) = (phase, reason, false, 0);
        self.velocity = Vector6::zeros();
    }
}

impl Tracker {
    /// Nothing is tracked yet. At most `max_instances` of each object are.
    #[must_use]
    pub fn new(config: TrackConfig, objects: &ObjectSet, max_instances: usize) -> Self {
        let objects = objects.iter().map(|object| (object.id, object.diameter_m)).collect();
        Self { config, objects, max_instances, tracks: Vec::new(), frames_since_search: None }
    }

    /// Takes what became of a frame that was there at `stamp_ns`.
    pub fn learn(&mut self, poses: &[ObjectPose], stamp_ns: i64) {
        for pose in poses {
            let diameter_m = self.diameter_m(pose.object_id);
            let same = |t: &&mut Track| t.active && (t.object_id, t.instance) == (pose.object_id, pose.instance);
            if let Some(track) = self.tracks.iter_mut().find(same).filter(|t| t.fresh || stamp_ns > t.stamp_ns) {
                match judge(track, pose, stamp_ns, diameter_m, &self.config) {
                    Ok(there) => good(track, there, pose.score, stamp_ns, &self.config),
                    Err(reason) => bad(track, reason, pose.score, &self.config),
                }
            }
        }
        self.drop_duplicates();
    }

    /// Whether to search the next image: nothing is tracked, or something is missing or doubtful and the last search is long
    /// ago.
    #[must_use]
    pub fn wants_search(&self) -> bool {
        let sound = |id: u32| self.tracks.iter().filter(|t| t.active && !t.doubtful() && t.object_id == id).count();
        let missing = self.objects.iter().any(|(id, _)| sound(*id) < self.max_instances);
        let none = self.tracks.iter().all(|t| !t.active);
        none || missing && self.frames_since_search.is_none_or(|frames| frames >= self.config.search_every)
    }

    /// Whether a track without doubt expects the object where it was detected in an image at `stamp_ns`: there is nothing to
    /// find out then.
    #[must_use]
    pub fn expects(&self, object: &Object, detected: &Rectangle, camera: &Intrinsics, stamp_ns: i64) -> bool {
        let sound = |t: &&Track| t.active && !t.doubtful() && t.object_id == object.id;
        let there = |t: &Track| extent(object, &t.predict(stamp_ns), camera);
        let mut expected = self.tracks.iter().filter(sound).filter_map(there);
        expected.any(|rectangle| rectangle.holds(&detected.middle_px))
    }

    /// Takes what a search of the image at `stamp_ns` found: what is not tracked there already gets a track, and a doubtful
    /// track another chance.
    pub fn found(&mut self, detections: &[Detection], stamp_ns: i64) {
        self.frames_since_search = Some(0);
        for detection in detections {
            let diameter_m = self.diameter_m(detection.object_id);
            let away = |t: &Track| {
                (t.predict(stamp_ns).translation.vector - detection.camera_from_object.translation.vector).norm()
            };
            let of_object = |t: &&Track| t.active && t.object_id == detection.object_id;
            let here = |t: &Track| away(t) < NEAR_DIAMETERS * diameter_m;
            let known = self.tracks.iter().filter(of_object).any(|t| here(t) && !t.doubtful());
            let full = self.tracks.iter().filter(of_object).count() >= self.max_instances;
            let doubtful = |t: &&mut Track| of_object(&&**t) && t.doubtful() && !t.fresh && (full || here(t));
            match self.tracks.iter_mut().find(doubtful) {
                _ if known => {}
                Some(track) => track.doubt(detection, stamp_ns),
                None if full => {}
                None => self.begin(detection, stamp_ns),
            }
        }
    }

    /// A lost track of the object goes on, the one that was nearest; else a new one begins.
    fn begin(&mut self, detection: &Detection, stamp_ns: i64) {
        let at = detection.camera_from_object.translation.vector;
        let away = |t: &Track| (t.pose.translation.vector - at).norm();
        let idle = self.tracks.iter_mut().filter(|t| !t.active && t.object_id == detection.object_id);
        let nearest = idle.min_by(|a, b| away(a).total_cmp(&away(b)));
        let track = match nearest {
            Some(track) => track,
            None => {
                let instance = self.tracks.iter().filter(|t| t.object_id == detection.object_id).count() as u32;
                self.tracks.push(Track {
                    object_id: detection.object_id,
                    instance,
                    phase: TrackPhase::Searching,
                    reason: TrackReason::Detected,
                    active: true,
                    fresh: true,
                    pose: detection.camera_from_object,
                    others: detection.others.clone(),
                    stamp_ns,
                    velocity: Vector6::zeros(),
                    good: 0,
                    bad: 0,
                    score: detection.score,
                });
                return;
            }
        };
        (track.reason, track.active, track.fresh) = (TrackReason::Detected, true, true);
        (track.pose, track.stamp_ns, track.score) = (detection.camera_from_object, stamp_ns, detection.score);
        (track.good, track.bad, track.velocity) = (0, 0, Vector6::zeros());
        track.others.clone_from(&detection.others);
    }

    /// Where everything should be at `stamp_ns`. Counts a frame.
    pub fn predict(&mut self, stamp_ns: i64) -> Vec<Predicted> {
        self.frames_since_search = self.frames_since_search.map(|frames| frames.saturating_add(1));
        let predicted = |t: &Track| Predicted {
            object_id: t.object_id,
            instance: t.instance,
            camera_from_object: t.predict(stamp_ns),
            score: t.score,
            tracked: !t.fresh,
            others: t.others.clone(),
        };
        let mut all: Vec<Predicted> = self.tracks.iter().filter(|t| t.active).map(predicted).collect();
        all.sort_by_key(|p| (p.object_id, p.instance));
        all
    }

    /// Every track, and every object that has none.
    #[must_use]
    pub fn statuses(&self) -> Vec<ObjectStatus> {
        let of_track = |t: &Track| ObjectStatus {
            object_id: t.object_id,
            instance: t.instance,
            phase: t.phase as u32,
            reason: t.reason as u32,
            good_frames: t.good,
            bad_frames: t.bad,
            score: t.score,
        };
        let missing = |(id, _): &&(u32, f64)| !self.tracks.iter().any(|t| t.object_id == *id);
        let none = |(id, _): &(u32, f64)| ObjectStatus {
            object_id: *id,
            instance: 0,
            phase: TrackPhase::Searching as u32,
            reason: TrackReason::NotFound as u32,
            good_frames: 0,
            bad_frames: 0,
            score: 0.0,
        };
        let mut all: Vec<ObjectStatus> = self.tracks.iter().map(of_track).collect();
        all.extend(self.objects.iter().filter(missing).map(none));
        all.sort_by_key(|s| (s.object_id, s.instance));
        all
    }

    fn diameter_m(&self, object_id: u32) -> f64 {
        self.objects.iter().find(|(id, _)| *id == object_id).map_or(0.2, |(_, diameter_m)| *diameter_m)
    }

    /// Of two tracks of one object at one place, the longer one stays.
    fn drop_duplicates(&mut self) {
        for i in 0..self.tracks.len() {
            for j in 0..self.tracks.len() {
                let (a, b) = (&self.tracks[i], &self.tracks[j]);
                let same = i != j && a.active && b.active && a.object_id == b.object_id;
                let away_m = (a.pose.translation.vector - b.pose.translation.vector).norm();
                let longer = (a.good, std::cmp::Reverse(a.instance)) >= (b.good, std::cmp::Reverse(b.instance));
                if same && longer && away_m < 0.25 * self.diameter_m(a.object_id) {
                    let phase = if b.phase == TrackPhase::Tracking { TrackPhase::Lost } else { b.phase };
                    self.tracks[j].stop(phase, TrackReason::Duplicate);
                }
            }
        }
    }
}

/// The pose, if it can be believed; else why not.
fn judge(
    track: &Track,
    pose: &ObjectPose,
    stamp_ns: i64,
    diameter_m: f64,
    config: &TrackConfig,
) -> Result<Pose, TrackReason> {
    match pose.status() {
        Some(PoseStatus::Ok | PoseStatus::Rejected) => {}
        Some(PoseStatus::NotVisible) => return Err(TrackReason::LeftImage),
        Some(PoseStatus::NotSeen) => return Err(TrackReason::NotSeen),
        _ => return Err(TrackReason::NotSolved),
    }
    if pose.score < config.min_inlier_ratio {
        return Err(TrackReason::NotSeen);
    }
    let there = pose_from_quaternion(&pose.rotation_xyzw, &pose.translation_m).map_err(|_| TrackReason::NotSolved)?;
    let expected = track.predict(stamp_ns);
    let jump = (there.translation.vector - expected.translation.vector).norm() / diameter_m;
    let turn_deg = rotation_angle_rad(&there, &expected).to_degrees();
    // A detection is rough: only what is tracked has an expected place.
    let jumped = !track.fresh && (jump > config.max_jump_diameters || turn_deg > config.max_turn_deg);
    if jumped { Err(TrackReason::Jumped) } else { Ok(there) }
}

fn good(track: &mut Track, there: Pose, score: f64, stamp_ns: i64, config: &TrackConfig) {
    track.move_to(there, stamp_ns, config.velocity_gain);
    (track.good, track.bad, track.score) = (track.good + 1, 0, score);
    if track.phase == TrackPhase::Tracking || track.good >= config.confirm_after {
        (track.phase, track.reason) = (TrackPhase::Tracking, TrackReason::Confirmed);
    }
}

fn bad(track: &mut Track, reason: TrackReason, score: f64, config: &TrackConfig) {
    (track.good, track.bad, track.score) = (0, track.bad + 1, score);
    track.velocity = Vector6::zeros();
    track.reason = reason;
    let (tracking, gone) = (track.phase == TrackPhase::Tracking, reason == TrackReason::LeftImage);
    if !tracking {
        track.stop(track.phase, reason);
    } else if gone || track.bad >= config.lose_after {
        track.stop(TrackPhase::Lost, reason);
    }
}
