//! What a frame leaves behind: a measured pose, or one that is held.

use crate::follow::{hiders, poses_of, subject};
use crate::history::Moment;
use crate::measure::Trial;
use crate::track::{Phase, Track};
use crate::tracker::{Now, Tracker};
use nalgebra::Matrix6;
use pseudoflow_geometry::Pose;

/// How much longer than others an object is held that others say is still there.
const REST_PATIENCE: f64 = 10.0;
/// Frames in a row that make what was found a track without a look of the network.
const CONFIRM_FRAMES: u32 = 5;
/// With so much confidence two are enough.
const CONFIRM_CONFIDENCE: f64 = 0.8;
/// Share of the velocity that is left after a frame that did not show the object.
const SLOWING: f64 = 0.85;

impl Tracker {
    /// Takes a measured pose over, or holds the object where it is believed to be.
    pub(crate) fn settle(&mut self, i: usize, now: &Now<'_>, predicted: &Pose, trials: &[Option<Trial>]) {
        let Some(trial) = trials[i].filter(|_| self.tracks[i].known) else { return };
        self.tracks[i].evidence = trial.evidence;
        self.tracks[i].confidence = trial.confidence;
        match trial.evidence.seen() >= self.config.min_seen {
            true => self.take(i, now, &trial, trials),
            false => self.hold(i, now, predicted),
        }
        let (hold_s, lose_confidence) = (self.config.hold_s, self.config.lose_confidence);
        let doubtful_looks = self.config.doubtful_looks;
        let track = &mut self.tracks[i];
        if track.phase != Phase::Tracking && trial.evidence.lines > 0.0 {
            // Nobody believes its pose yet, so nothing is lost by a step of little evidence.
            track.pose = trial.pose;
        }
        if track.doubts >= doubtful_looks {
            *track = Track { phase: track.gone(), ..Track::new(track.object) };
            return;
        }
        if trial.confidence >= lose_confidence || !track.measured {
            track.sure_ns = now.frame.stamp_ns;
        }
        if track.phase == Phase::Tracking && (now.frame.stamp_ns - track.sure_ns) as f64 * 1e-9 > hold_s {
            track.phase = Phase::Lost;
        }
        track.history.push(Moment { frame: now.frame.index, pose: track.pose, measured: track.measured });
    }

    pub(crate) fn take(&mut self, i: usize, now: &Now<'_>, trial: &Trial, trials: &[Option<Trial>]) {
        let (sure, looks_come) = (trial.evidence.seen() >= self.config.learn_seen, self.looks_come);
        let track = &mut self.tracks[i];
        if track.measured && track.good > 0 {
            track.velocity.learn(&track.pose, &trial.pose, now.gap_s, self.config.velocity_gain);
        }
        (track.pose, track.measured, track.seen_ns) = (trial.pose, true, now.frame.stamp_ns);
        (track.good, track.bad) = (track.good + 1, 0);
        track.covariance = inverse(&trial.information) * self.config.covariance_scale;
        track.learnt = sure;
        let often = track.good >= CONFIRM_FRAMES || track.good > 1 && trial.confidence >= CONFIRM_CONFIDENCE;
        let believed = track.verified || !looks_come || trial.evidence.is_like_the_mesh();
        if often && trial.confidence >= self.config.min_confidence && believed {
            track.phase = Phase::Tracking;
        }
        if sure || track.colours.is_empty() {
            let poses = poses_of(trials, &self.tracks.iter().map(|t| t.pose).collect::<Vec<_>>());
            let mut colours = std::mem::take(&mut self.tracks[i].colours);
            let Self { tools, objects, tracks, config, .. } = self;
            let hiders = hiders(objects, tracks, i, &poses);
            let subject = subject(now, &objects[tracks[i].object], &hiders);
            tools.measurer.learn(&subject, &trial.pose, &mut colours, config.renewal);
            self.tracks[i].colours = colours;
        }
    }

    pub(crate) fn hold(&mut self, i: usize, now: &Now<'_>, predicted: &Pose) {
        let gap_s = now.gap_s;
        let (hold_s, frame_s) = (self.config.hold_s, self.config.frame_s);
        let diameter_m = self.objects[self.tracks[i].object].diameter_m;
        let track = &mut self.tracks[i];
        track.pose = track.resting.unwrap_or(*predicted);
        (track.measured, track.learnt, track.good, track.bad) = (false, false, 0, track.bad + 1);
        track.velocity.slow(SLOWING.powf(gap_s / frame_s));
        track.covariance += spread_per_s(diameter_m) * gap_s;
        let hold_s = if track.resting.is_some() { hold_s * REST_PATIENCE } else { hold_s };
        if track.phase == Phase::Tracking && track.unseen_s(now.frame.stamp_ns) > hold_s {
            track.phase = Phase::Lost;
        }
    }
}

/// How fast the place of an object becomes unknown that is not seen: a tenth of the diameter and 10 degrees in a second.
fn spread_per_s(diameter_m: f64) -> Matrix6<f64> {
    let (m2, rad2) = ((0.1 * diameter_m).powi(2), 10_f64.to_radians().powi(2));
    Matrix6::from_diagonal(&nalgebra::Vector6::new(m2, m2, m2, rad2, rad2, rad2))
}

fn inverse(information: &Matrix6<f64>) -> Matrix6<f64> {
    information.cholesky().map_or_else(Matrix6::identity, |c| c.inverse())
}
