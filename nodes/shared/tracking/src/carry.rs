//! What was found in an earlier frame, brought to the present.

use crate::measure::Trial;
use crate::rest::{Body, body, common_motion};
use crate::tracker::{Correction, CorrectionKind, Tracker};
use nalgebra::Point3;
use pseudoflow_geometry::{Intrinsics, Pose, rotation_angle_rad};

impl Tracker {
    /// Where a correction puts its object now: by the object's own motion since, else by that of what is at rest, else as it is.
    pub(crate) fn carried(
        &self,
        track: usize,
        correction: &Correction,
        predicted: &[Pose],
        camera: &Intrinsics,
    ) -> Pose {
        if let Some(then) = self.tracks[track].history.at(correction.frame) {
            return predicted[track] * (then.pose.inverse() * correction.camera_from_object);
        }
        match self.motion_since(correction.frame, predicted, camera) {
            Some(motion) => motion * correction.camera_from_object,
            None => correction.camera_from_object,
        }
    }

    /// Motion of the scene at rest since a frame; of one object alone where there is no other.
    fn motion_since(&self, frame: u64, now: &[Pose], camera: &Intrinsics) -> Option<Pose> {
        let bodies: Vec<Body> = self.bodies(frame, now, |_| true).into_iter().flatten().collect();
        match bodies.as_slice() {
            [] => None,
            [one] => Some(one.now * one.before.inverse()),
            _ => common_motion(&bodies, camera).map(|c| c.motion),
        }
    }

    /// What was seen in a frame and is seen now, for each track that `counts`.
    pub(crate) fn bodies(&self, frame: u64, now: &[Pose], counts: impl Fn(usize) -> bool) -> Vec<Option<Body>> {
        let of = |i: usize| {
            let object = &self.objects[self.tracks[i].object];
            let sphere = (object.contour.centre_m(), object.contour.radius_m());
            body(&self.tracks[i].history, frame, &now[i], sphere).filter(|_| counts(i) && self.tracks[i].known)
        };
        (0..self.tracks.len()).map(of).collect()
    }

    /// Whether two poses of an object are the same for tracking.
    pub(crate) fn near(&self, track: usize, a: &Pose, b: &Pose) -> bool {
        let object = &self.objects[self.tracks[track].object];
        let middle: Point3<f64> = object.contour.centre_m();
        let away_m = (a * middle - b * middle).norm();
        away_m < 0.03 * object.diameter_m && rotation_angle_rad(a, b) < 0.07
    }

    /// Whether what was found elsewhere goes before what was predicted.
    pub(crate) fn prefers(&self, track: usize, own: &Trial, other: &Trial, correction: &Correction) -> bool {
        let tracked = self.tracks[track].measured;
        let enough = other.confidence >= self.config.min_confidence;
        match correction.kind {
            CorrectionKind::Look { accepted: true } => {
                enough && (other.confidence > own.confidence - LOOK_BONUS || !tracked)
            }
            CorrectionKind::Look { accepted: false } => other.confidence > own.confidence + LOOK_BONUS,
            CorrectionKind::Found => enough && other.confidence > own.confidence && !tracked,
        }
    }
}

/// How much less sure a pose may be that a look has found: appearance inside the contour tells what the contour does not.
const LOOK_BONUS: f64 = 0.1;
