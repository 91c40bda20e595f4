//! Objects over time: after a good pose the next frame starts from it, and the image is searched only for what is new or lost.
//!
//! Each object instance has a track. It is `Searching` until enough good frames in a row confirm a detection, then
//! `Tracking`, and `Lost` after enough bad ones; a lost one that is detected again keeps its number. Between frames a track
//! moves with constant velocity in SE(3). What is hidden or lost is expected where it was among the other objects
//! (`anchors`).

mod anchors;
mod config;
mod plausible;
#[cfg(test)]
mod tests;

pub use config::TrackConfig;

use crate::detect::{Detection, Hypothesis, Rectangle, extent};
use anchors::Anchor;
use nalgebra::Vector6;
use plausible::{bad, good, plausible};
use pseudoflow_geometry::{Intrinsics, Pose, exp_se3, log_se3};
use pseudoflow_imaging::{Object, ObjectSet};
use pseudoflow_msgs::{ObjectPose, ObjectStatus, TrackPhase, TrackReason};

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
    /// The objects around it when it was last seen.
    anchors: Vec<Anchor>,
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
    fn new(detection: &Detection, instance: u32, stamp_ns: i64) -> Self {
        Self {
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
            anchors: Vec::new(),
        }
    }

    /// The object and its number, as [`ObjectPose::identity`].
    fn identity(&self) -> (u32, u32) {
        (self.object_id, self.instance)
    }

    /// Goes on from a pose that is no more than a detection.
    fn start_from(&mut self, pose: Pose, others: Vec<Hypothesis>, stamp_ns: i64) {
        (self.pose, self.others, self.stamp_ns) = (pose, others, stamp_ns);
        (self.fresh, self.velocity) = (true, Vector6::zeros());
    }

    /// Is there again, to be confirmed.
    fn resume(&mut self, reason: TrackReason, pose: Pose, others: Vec<Hypothesis>, stamp_ns: i64) {
        self.start_from(pose, others, stamp_ns);
        (self.reason, self.active, self.good, self.bad) = (reason, true, 0, 0);
    }

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
    fn doubt(&mut self, detection: &Detection, expected: Pose, stamp_ns: i64) {
        let expected = Hypothesis { camera_from_object: expected, score: detection.score };
        let others = std::iter::once(expected).chain(detection.others.iter().copied()).collect();
        self.start_from(detection.camera_from_object, others, stamp_ns);
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
        // All of them before any track moves.
        let expected: Vec<Pose> = self.tracks.iter().map(|t| self.expected(t, stamp_ns)).collect();
        for pose in poses {
            let diameter_m = self.diameter_m(pose.object_id);
            let same = |t: &Track| t.active && t.identity() == pose.identity();
            let known = self.tracks.iter_mut().zip(&expected).find(|(t, _)| same(t));
            if let Some((track, expected)) = known.filter(|(t, _)| t.fresh || stamp_ns > t.stamp_ns) {
                match plausible(track, pose, expected, diameter_m, &self.config) {
                    Ok(there) => good(track, there, pose.score, stamp_ns, &self.config),
                    Err(reason) => bad(track, reason, pose, stamp_ns, &self.config),
                }
            }
        }
        self.drop_duplicates();
        self.anchor(stamp_ns);
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
    /// track another chance. What is still lost is looked for where the other objects say that it was left.
    pub fn found(&mut self, detections: &[Detection], stamp_ns: i64) {
        self.frames_since_search = Some(0);
        for detection in detections {
            let of_object = |t: &Track| t.active && t.object_id == detection.object_id;
            let here: Vec<bool> = self
                .tracks
                .iter()
                .map(|t| of_object(t) && self.near(t, &detection.camera_from_object, stamp_ns))
                .collect();
            if self.tracks.iter().zip(&here).any(|(t, here)| *here && !t.doubtful()) {
                continue;
            }
            let full = self.full(detection.object_id);
            let doubtful = |i: &usize| {
                let t = &self.tracks[*i];
                // What is hidden where the others say that it is has not gone elsewhere.
                let elsewhere = || full && self.anchored(t, stamp_ns).is_none();
                of_object(t) && t.doubtful() && !t.fresh && (here[*i] || elsewhere())
            };
            match (0..self.tracks.len()).find(doubtful) {
                Some(i) => {
                    let expected = self.expected(&self.tracks[i], stamp_ns);
                    self.tracks[i].doubt(detection, expected, stamp_ns);
                }
                None if full => {}
                None => self.begin(detection, stamp_ns),
            }
        }
        self.remember(stamp_ns);
    }

    /// Whether there are as many instances of an object as there may be.
    fn full(&self, object_id: u32) -> bool {
        self.tracks.iter().filter(|t| t.active && t.object_id == object_id).count() >= self.max_instances
    }

    /// Whether an object of that kind at a pose may be what is tracked.
    fn near(&self, track: &Track, pose: &Pose, stamp_ns: i64) -> bool {
        distance_m(&self.expected(track, stamp_ns), pose) < NEAR_DIAMETERS * self.diameter_m(track.object_id)
    }

    /// A lost track of the object goes on, the one that was nearest; else a new one begins.
    fn begin(&mut self, detection: &Detection, stamp_ns: i64) {
        let at = &detection.camera_from_object;
        let away = |i: &usize| distance_m(&self.expected(&self.tracks[*i], stamp_ns), at);
        let idle = |i: &usize| !self.tracks[*i].active && self.tracks[*i].object_id == detection.object_id;
        let nearest = (0..self.tracks.len()).filter(idle).min_by(|a, b| away(a).total_cmp(&away(b)));
        let Some(i) = nearest else {
            let instance = self.tracks.iter().filter(|t| t.object_id == detection.object_id).count() as u32;
            self.tracks.push(Track::new(detection, instance, stamp_ns));
            return;
        };
        let left = self.anchored(&self.tracks[i], stamp_ns);
        let left = left.map(|pose| Hypothesis { camera_from_object: pose, score: detection.score });
        let others = detection.others.iter().copied().chain(left).collect();
        self.tracks[i].resume(TrackReason::Detected, detection.camera_from_object, others, stamp_ns);
        self.tracks[i].score = detection.score;
    }

    /// Where everything should be at `stamp_ns`. Counts a frame.
    pub fn predict(&mut self, stamp_ns: i64) -> Vec<Predicted> {
        self.frames_since_search = self.frames_since_search.map(|frames| frames.saturating_add(1));
        let predicted = |t: &Track| Predicted {
            object_id: t.object_id,
            instance: t.instance,
            camera_from_object: self.expected(t, stamp_ns),
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
                let longer = (a.good, std::cmp::Reverse(a.instance)) >= (b.good, std::cmp::Reverse(b.instance));
                if same && longer && distance_m(&a.pose, &b.pose) < 0.25 * self.diameter_m(a.object_id) {
                    let phase = if b.phase == TrackPhase::Tracking { TrackPhase::Lost } else { b.phase };
                    self.tracks[j].stop(phase, TrackReason::Duplicate);
                }
            }
        }
    }
}

fn distance_m(a: &Pose, b: &Pose) -> f64 {
    (a.translation.vector - b.translation.vector).norm()
}
