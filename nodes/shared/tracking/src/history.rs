//! Where an object was in the frames before.

use nalgebra::Vector6;
use pseudoflow_geometry::{Pose, exp_se3, log_se3};
use std::collections::VecDeque;
use std::sync::Arc;

/// A time in which nothing turns far, seconds.
const SMALL_S: f64 = 0.01;
/// Frames that are remembered: a search may take ten seconds.
const FRAMES: usize = 600;

/// Where others say that an object was in a frame, `camera_from_object`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sighting {
    pub(crate) frame: u64,
    pub(crate) pose: Pose,
}

/// An object in a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Moment {
    pub(crate) frame: u64,
    pub(crate) pose: Pose,
    /// Whether it was seen there, not only believed to be there.
    pub(crate) measured: bool,
}

/// The poses of one object by frame. A copy shares them until one of the two is changed.
#[derive(Debug, Clone, Default)]
pub(crate) struct History(Arc<VecDeque<Moment>>);

impl History {
    /// Adds the newest frame.
    pub(crate) fn push(&mut self, moment: Moment) {
        let moments = Arc::make_mut(&mut self.0);
        moments.push_back(moment);
        if moments.len() > FRAMES {
            moments.pop_front();
        }
    }

    /// Where it was in a frame; `None` for what is too long ago or was never known.
    pub(crate) fn at(&self, frame: u64) -> Option<&Moment> {
        self.0.binary_search_by_key(&frame, |m| m.frame).ok().map(|i| &self.0[i])
    }

    /// The newest frame that it was seen in.
    pub(crate) fn last_measured(&self) -> Option<&Moment> {
        self.0.iter().rev().find(|m| m.measured)
    }

    /// Moves all that is remembered by a change of pose in the object's own frame: what is wrong now was wrong before.
    pub(crate) fn correct(&mut self, object_from_corrected: &Pose) {
        Arc::make_mut(&mut self.0).iter_mut().for_each(|m| m.pose *= object_from_corrected);
    }
}

/// Motion of an object in its own frame: as it moved between two frames, it will move on.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Velocity {
    /// m/s and rad/s.
    per_s: Vector6<f64>,
}

impl Velocity {
    /// Blends the motion from a pose to the next into what was known.
    pub(crate) fn learn(&mut self, from: &Pose, to: &Pose, gap_s: f64, gain: f64) {
        let fresh = log_se3(&(from.inverse() * to)) / gap_s;
        self.per_s = (1.0 - gain) * self.per_s + gain * fresh;
    }

    /// Where a pose goes.
    pub(crate) fn predict(&self, from: &Pose, gap_s: f64) -> Pose {
        from * exp_se3(&(self.per_s * gap_s))
    }

    /// The same motion of the same thing, whose own frame is another.
    pub(crate) fn turn(&mut self, object_from_other: &Pose) {
        let small = exp_se3(&(self.per_s * SMALL_S));
        self.per_s = log_se3(&(object_from_other.inverse() * small * object_from_other)) / SMALL_S;
    }

    pub(crate) fn slow(&mut self, share: f64) {
        self.per_s *= share;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn a_steady_motion_goes_on() {
        let step = exp_se3(&Vector6::new(0.001, 0.002, -0.001, 0.01, 0.02, 0.0));
        let first = Pose::new(Vector3::new(0.1, 0.0, 0.8), Vector3::new(0.3, 0.1, -0.4));
        let mut velocity = Velocity::default();
        velocity.learn(&first, &(first * step), 0.1, 1.0);
        let next = velocity.predict(&(first * step), 0.1);
        assert!((next.to_homogeneous() - (first * step * step).to_homogeneous()).norm() < 1e-9);
        let other = Pose::new(Vector3::new(0.01, 0.02, 0.0), Vector3::new(0.0, 0.5, 0.2));
        velocity.turn(&other);
        let turned = velocity.predict(&(first * step * other), 0.1);
        assert!((turned.to_homogeneous() - (next * other).to_homogeneous()).norm() < 1e-9);
    }

    #[test]
    fn frames_are_found_and_corrected() {
        let mut history = History::default();
        for frame in [3_u64, 4, 7] {
            history.push(Moment { frame, pose: Pose::translation(frame as f64, 0.0, 1.0), measured: frame < 7 });
        }
        assert!(history.at(5).is_none());
        assert_eq!(history.last_measured().unwrap().frame, 4);
        history.correct(&Pose::translation(0.5, 0.0, 0.0));
        assert_eq!(history.at(7).unwrap().pose.translation.x, 7.5);
    }
}
