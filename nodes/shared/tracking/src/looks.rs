//! Which objects a network should look at: those that are not sure, those that were not looked at for long.

use crate::TrackingConfig;
use crate::carry::Apart;
use crate::track::{Phase, Track};
use crate::tracker::Tracker;
use pseudoflow_geometry::Pose;

/// A look of the network that is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    /// The object.
    pub object_id: u32,
    /// Where it is believed to be in this frame.
    pub camera_from_object: Pose,
}

/// Poses of which one look is enough, diameters and radians: the search's views are further apart, and a look leads from there.
const SAME_LOOK: Apart = Apart { diameters: 0.15, rad: 0.26 };

impl Tracker {
    /// Where a look at an object begins: where it is followed, and where else it was found, brought to the last frame.
    pub(crate) fn starts_of_look(&mut self, i: usize) -> Vec<Pose> {
        let mut poses = vec![self.tracks[i].pose];
        let now: Vec<Pose> = self.tracks.iter().map(|t| t.pose).collect();
        for found in std::mem::take(&mut self.tracks[i].candidates) {
            let here = self.camera.map_or(found.pose, |(_, camera)| self.carried(i, &found, &now, &camera));
            if !poses.iter().any(|pose| self.apart(i, pose, &here).is_within(SAME_LOOK)) {
                poses.push(here);
            }
        }
        poses
    }

    /// Whether a look at an object that was found is still to come.
    pub(crate) fn awaits_look(&self, track: &Track) -> bool {
        let asked = self.last.is_some_and(|(_, now_ns)| is_asked(track, now_ns, &self.config));
        track.known && (!track.candidates.is_empty() || asked)
    }
}

/// What looks may cost: each frame earns some, each look costs some.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Budget {
    saved_ms: f64,
}

impl Budget {
    pub(crate) fn earn(&mut self, config: &TrackingConfig) {
        let most_ms = config.budget_ms.max(config.look_ms);
        self.saved_ms = (self.saved_ms + config.budget_ms).min(most_ms);
    }

    /// As many of the wanted looks as can be paid.
    pub(crate) fn spend(&mut self, mut wanted: Vec<usize>, config: &TrackingConfig) -> Vec<usize> {
        let affordable = (self.saved_ms / config.look_ms + 1e-9) as usize;
        wanted.truncate(affordable);
        self.saved_ms -= wanted.len() as f64 * config.look_ms;
        wanted
    }
}

/// Whether an answer to a look may still come.
fn is_asked(track: &Track, now_ns: i64, config: &TrackingConfig) -> bool {
    track.asked_ns.is_some_and(|ns| (now_ns - ns) as f64 * 1e-9 < config.look_timeout_s)
}

/// The tracks to be looked at in this frame, the most urgent first.
pub(crate) fn wanted(tracks: &[Track], now_ns: i64, config: &TrackingConfig) -> Vec<usize> {
    let since = |ns: Option<i64>| ns.map_or(f64::INFINITY, |ns| (now_ns - ns) as f64 * 1e-9);
    // Newest wins in a live graph: a second request would push aside the one that the network has not begun with.
    if tracks.iter().any(|t| is_asked(t, now_ns, config)) {
        return Vec::new();
    }
    let urgency = |t: &Track| {
        let age_s = since(t.looked_ns);
        let (due_s, weight) = match (t.measured, t.phase) {
            (true, Phase::Tracking) if !t.disputed => (config.look_every_s, 1.0),
            (true, Phase::Tracking) => (config.look_again_s, 2.0),
            (_, Phase::Lost) => (config.look_again_s * 2.0, 2.0),
            _ => (config.look_again_s, 4.0),
        };
        (t.known && age_s >= due_s).then(|| weight * age_s.min(100.0) / due_s)
    };
    let mut ranked: Vec<(f64, usize)> =
        tracks.iter().enumerate().filter_map(|(i, t)| urgency(t).map(|u| (u, i))).collect();
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    ranked.into_iter().take(config.looks_at_once).map(|(_, i)| i).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{found, object, picture, step, truth};
    use crate::{Correction, CorrectionKind};
    use pseudoflow_geometry::rotation_angle_rad;

    #[test]
    fn the_next_looks_are_asked_for_when_the_last_have_come() {
        let config = TrackingConfig::default();
        let s = |s: f64| (s * 1e9) as i64;
        let track = |looked_ns: Option<i64>, disputed: bool| {
            let base = Track { known: true, measured: true, phase: Phase::Tracking, ..Track::new(0) };
            Track { looked_ns, disputed, ..base }
        };
        let now = s(100.0);
        let agreed = |since: f64| track(Some(now - s(since)), false);
        let disputed = track(Some(now - s(0.5)), true);
        assert_eq!(
            wanted(&[agreed(0.5), disputed.clone(), agreed(2.0)], now, &config),
            [1, 2],
            "the most urgent first"
        );
        let asked = Track { asked_ns: Some(now - s(0.3)), ..agreed(0.3) };
        assert!(wanted(&[asked.clone(), disputed.clone()], now, &config).is_empty());
        let given_up = Track { asked_ns: Some(now - s(2.0)), ..asked };
        assert_eq!(wanted(&[given_up, disputed], now, &config)[0], 1);
    }

    /// A tracker whose object was found in frame 0 at two poses, after so many frames.
    fn found_and_waiting(frames: u64, poses: [Pose; 2]) -> Tracker {
        let mut tracker = Tracker::new(vec![object().clone()], TrackingConfig::default()).unwrap();
        tracker.expect_looks();
        assert_eq!(tracker.missing(), [4]);
        let news = poses.map(|camera_from_object| Correction { camera_from_object, ..found(0) });
        for i in 0..frames {
            step(&mut tracker, i, &picture(i, false), if i == 0 { &news } else { &[] });
        }
        tracker
    }

    #[test]
    fn what_waits_for_a_look_is_not_searched_for_until_the_look_says_no() {
        let wrong = [1.2, -1.2].map(|y| truth(0) * Pose::rotation([0.0, y, 0.0].into()));
        let mut tracker = found_and_waiting(4, wrong);
        assert!(tracker.missing().is_empty(), "it will be looked at");
        assert!(!tracker.ask().is_empty());
        assert!(tracker.missing().is_empty(), "it is being looked at");
        let kind = CorrectionKind::Look { accepted: false, score: 0.05 };
        let no = Correction { frame: 3, camera_from_object: wrong[0], kind, ..found(3) };
        step(&mut tracker, 4, &picture(4, false), &[no]);
        assert_eq!(tracker.missing(), [4]);
    }

    #[test]
    fn a_look_begins_where_what_was_found_is_now() {
        let turned = Pose::rotation([0.0, 0.0, 1.5].into());
        let looks = found_and_waiting(8, [truth(0), truth(0) * turned]).ask();
        assert_eq!(looks.len(), 2, "{looks:?}");
        let there = truth(7) * turned;
        assert!(rotation_angle_rad(&looks[1].camera_from_object, &there) < 0.05);
        assert!(rotation_angle_rad(&(truth(0) * turned), &there) > 0.1, "it has moved");
    }
}
