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
        away_m < 0.04 * object.diameter_m && rotation_angle_rad(a, b) < 0.09
    }

    /// Whether what was found elsewhere goes before what was predicted. Textures are those of the prediction's own keyframes, so
    /// only the contours are compared.
    pub(crate) fn prefers(&self, own: &Trial, other: &Trial, correction: &Correction) -> bool {
        let (before, after) = (own.evidence.of_contour(), other.evidence.of_contour());
        let enough = after >= self.config.min_confidence;
        match correction.kind {
            CorrectionKind::Look { accepted: true } => enough && after > before - LOOK_BONUS,
            CorrectionKind::Look { accepted: false } => enough && after > before + LOOK_BONUS,
            CorrectionKind::Found => enough && after > before,
        }
    }
}

/// How much less sure a contour may be of a pose that a look has found: a look sees what is inside of it.
const LOOK_BONUS: f64 = 0.2;
