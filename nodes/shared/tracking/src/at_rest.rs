//! What is not surely seen is looked for where those at rest say that it is.

use crate::follow::poses_of;
use crate::measure::Trial;
use crate::rest::{Common, common_motion, motion_of};
use crate::tracker::{Now, Tracker};
use crate::types::Frame;
use pseudoflow_geometry::{Intrinsics, Pose};

/// Frames over which rest is judged, and for how many it must last.
pub(crate) const BASELINE: usize = 6;
const REST_FRAMES: u32 = 5;
/// How much less sure a pose may be that those at rest speak for.
const REST_BONUS: f64 = 0.1;

impl Tracker {
    /// How what is at rest moved since some frames ago.
    pub(crate) fn common(
        &self,
        trials: &[Option<Trial>],
        predicted: &[Pose],
        frame: &Frame<'_>,
    ) -> Option<(Common, Vec<usize>)> {
        let now = poses_of(trials, predicted);
        let sure = |i: usize| trials[i].is_some_and(|t| t.evidence.seen() >= self.config.learn_seen);
        let bodies = self.bodies(*self.recent.front()?, &now, sure);
        let places: Vec<usize> = (0..bodies.len()).filter(|i| bodies[*i].is_some()).collect();
        let bodies: Vec<_> = bodies.into_iter().flatten().collect();
        Some((common_motion(&bodies, &frame.intrinsics)?, places))
    }

    /// Counts who is at rest, and looks for what is not sure where those at rest say that it is.
    pub(crate) fn measure_at_rest(
        &mut self,
        now: &Now<'_>,
        trials: &mut [Option<Trial>],
        common: Option<&(Common, Vec<usize>)>,
    ) {
        for (member, i) in common.iter().flat_map(|(common, places)| common.members.iter().zip(places)) {
            self.tracks[*i].at_rest = if *member { self.tracks[*i].at_rest + 1 } else { 0 };
        }
        let poses: Vec<Pose> = poses_of(trials, &self.tracks.iter().map(|t| t.pose).collect::<Vec<_>>());
        // Where only one is seen, nobody says that it is not at rest any more.
        let sure = |i: usize| match common {
            Some((common, places)) => common.members.iter().zip(places).any(|(m, p)| *p == i && *m),
            None => trials[i].is_some_and(|t| t.evidence.seen() >= self.config.learn_seen),
        };
        let sure: Vec<bool> = (0..poses.len()).map(sure).collect();
        for i in 0..self.tracks.len() {
            let unsure = trials[i].is_some_and(|t| t.evidence.seen() < self.config.learn_seen);
            if !(unsure && self.tracks[i].at_rest >= REST_FRAMES) {
                continue;
            }
            let Some(there) = self.resting_pose(i, &poses, &sure, &now.frame.intrinsics) else { continue };
            self.tracks[i].resting = Some(there);
            let trial = self.follow(i, now, &there, &poses);
            if trials[i].is_none_or(|own| trial.evidence.seen() >= own.evidence.seen() - REST_BONUS) {
                trials[i] = Some(trial);
            }
        }
    }

    /// Where an object must be if it has not been moved since it was last seen.
    pub(crate) fn resting_pose(&self, i: usize, now: &[Pose], sure: &[bool], camera: &Intrinsics) -> Option<Pose> {
        let seen = self.tracks[i].history.last_measured()?;
        let bodies: Vec<_> = self
            .bodies(seen.frame, now, |j| j != i && sure[j] && self.tracks[j].at_rest >= REST_FRAMES)
            .into_iter()
            .flatten()
            .collect();
        Some(motion_of(&bodies, camera)? * seen.pose)
    }
}
