//! What was found in an earlier frame, brought to the present.

use crate::evidence::TELLING;
use crate::follow::{hiders, subject};
use crate::history::Sighting;
use crate::measure::Trial;
use crate::rest::{Body, body, motion_of};
use crate::track::{Phase, Track};
use crate::tracker::{Now, Tracker};
use crate::types::{Correction, CorrectionKind};
use nalgebra::Point3;
use pseudoflow_contour::Colours;
use pseudoflow_geometry::{Intrinsics, Pose, rotation_angle_rad};

impl Tracker {
    /// The better of the prediction and of what others have found.
    pub(crate) fn correct(
        &mut self,
        i: usize,
        now: &Now<'_>,
        own: Option<Trial>,
        (predicted, corrections): (&[Pose], &[Correction]),
        poses: &[Pose],
    ) -> Option<Trial> {
        let id = self.objects[self.tracks[i].object].id;
        let mut best = own;
        for correction in corrections.iter().filter(|c| c.object_id == id) {
            let search = correction.kind == CorrectionKind::Found;
            let said = Sighting { frame: correction.frame, pose: correction.camera_from_object };
            let sure = self.tracks[i].phase == Phase::Tracking && self.tracks[i].measured;
            if search && sure && self.tracks[i].known {
                continue;
            }
            if !search {
                self.tracks[i].asked_ns = None;
            }
            // From frame to frame contour and texture are more exact than a look; over a long gap a look is.
            let exact = !search && self.after_long_gap(now);
            let followed = best.filter(|own| exact && self.follows(i, own));
            let start = match followed.and_then(|own| self.moved_with(i, &own.pose, &said)) {
                Some(start) => start,
                None => self.carried(i, &said, predicted, &now.frame.intrinsics),
            };
            // Where its own motion has brought a look here, its pose is as well known as that of the frame before: from further away
            // the contour would lead it back to what it says itself.
            let gap_s = if followed.is_some() { self.config.frame_s } else { now.gap_s };
            let trial = self.try_at(i, &Now { gap_s, ..*now }, &start, poses);
            let Some(own) = best.filter(|_| self.tracks[i].known) else {
                self.log(now, correction, (None, &trial), "begun");
                best = Some(self.begin(i, now, trial));
                self.consider(i, now, start);
                continue;
            };
            if search {
                self.consider(i, now, start);
            }
            if self.near(i, &own.pose, &trial.pose) {
                self.log(now, correction, (Some(&own), &trial), "there");
                self.note_look(i, correction, LookOutcome::There);
                continue;
            }
            let (own, mut trial) = (self.compared(i, now, &own, poses), self.compared(i, now, &trial, poses));
            if !search {
                trial = self.polished(i, now, trial, &start, poses);
            }
            let given_up = self.tracks[i].unseen_s(now.frame.stamp_ns) > self.config.look_timeout_s;
            if search && (trial.confidence > own.confidence || given_up) {
                self.log(now, correction, (Some(&own), &trial), "begun anew");
                let candidates = std::mem::take(&mut self.tracks[i].candidates);
                best = Some(self.begin(i, now, trial));
                self.tracks[i].candidates = candidates;
            } else if !search {
                let taken = self.takes_look(i, exact, (&own, &trial), correction);
                self.log(now, correction, (Some(&own), &trial), if taken { "taken" } else { "not taken" });
                self.note_look(i, correction, if taken { LookOutcome::Elsewhere } else { LookOutcome::NotTaken });
                if taken {
                    self.jump(i, &own.pose, &trial.pose);
                    best = Some(trial);
                }
            }
        }
        best
    }

    /// A pose that was found will be looked at as it was found: the contour alone may lead it astray.
    fn consider(&mut self, i: usize, now: &Now<'_>, pose: Pose) {
        let candidates = &mut self.tracks[i].candidates;
        if candidates.len() < MOST_CANDIDATES {
            candidates.push(Sighting { frame: now.frame.index, pose });
        }
    }

    /// A look that says that it is right goes before a track of which none has said so, and, where it is `exact` and only corrects the
    /// pose, before one that is less sure than the look: both are probabilities of being right. Of quite another pose (a bottle
    /// turned by half a turn) a look may be as sure, and the picture decides.
    fn takes_look(&self, i: usize, exact: bool, (own, look): (&Trial, &Trial), correction: &Correction) -> bool {
        let sure = match correction.kind {
            CorrectionKind::Look { accepted: true, score } => {
                let corrects = exact && self.apart(i, &own.pose, &look.pose).is_within(CORRECTS);
                !self.tracks[i].verified || corrects && score > own.confidence
            }
            _ => false,
        };
        if sure && look.evidence.seen() >= self.config.min_seen {
            return true;
        }
        let accepted = matches!(correction.kind, CorrectionKind::Look { accepted: true, .. });
        if self.tracks[i].phase == Phase::Tracking && !accepted {
            // A look that does not believe itself, mostly of what is hidden: only where the picture shows the object there and not here.
            let shown = look.confidence >= self.config.min_confidence && look.evidence.seen() >= self.config.min_seen;
            return shown && look.confidence > own.confidence + ALIKE;
        }
        self.prefers(own, look, accepted)
    }

    /// Whether a track is followed in this frame, as `own` says.
    fn follows(&self, i: usize, own: &Trial) -> bool {
        self.tracks[i].known && own.evidence.seen() >= self.config.min_seen
    }

    /// Where a pose in an earlier frame is now, as an object moved that was followed since.
    fn moved_with(&self, i: usize, now: &Pose, seen: &Sighting) -> Option<Pose> {
        let then = self.tracks[i].history.at(seen.frame)?;
        Some(now * (then.pose.inverse() * seen.pose))
    }

    /// What a look says of the track. A look that has moved it far is believed only when it is very sure: from near, right and
    /// wrong poses differ more, and it is asked again at once.
    fn note_look(&mut self, i: usize, correction: &Correction, outcome: LookOutcome) {
        let CorrectionKind::Look { accepted, score } = correction.kind else { return };
        let (sure, doubtful) = (score >= self.config.sure_score, score < self.config.doubtful_score);
        let track = &mut self.tracks[i];
        track.look_score = Some(score);
        track.disputed = outcome != LookOutcome::There;
        match outcome {
            LookOutcome::There | LookOutcome::Elsewhere if accepted => {
                track.verified |= outcome == LookOutcome::There || sure;
                track.doubts = 0;
            }
            // What is hidden cannot be looked at, which says nothing of its pose; and a track that contour, texture and rendering are
            // sure of is not given up for what a look at few pixels says.
            _ if track.measured
                && track.confidence < DOUBTFUL_CONFIDENCE
                && (doubtful || accepted && score > track.confidence) =>
            {
                track.doubts += 1
            }
            _ => {}
        }
    }

    /// Says what became of a correction, for whoever asks why an object was not put right.
    fn log(&self, now: &Now<'_>, said: &Correction, (own, trial): (Option<&Trial>, &Trial), outcome: &str) {
        let say = |t: &Trial| {
            let e = t.evidence;
            format!("{:.2} (contour {:.2}, likeness {:.2})", t.confidence, e.of_contour(), e.likeness)
        };
        let (frame, age) = (now.frame.index, now.frame.index.saturating_sub(said.frame));
        log::debug!(
            "frame {frame}, object {}: {:?}, {age} frames old, {outcome}: {}, own {}",
            said.object_id,
            said.kind,
            say(trial),
            own.map_or("nothing".into(), say)
        );
    }

    /// A pose that others have found, in this frame.
    pub(crate) fn try_at(&mut self, i: usize, now: &Now<'_>, start: &Pose, poses: &[Pose]) -> Trial {
        match self.tracks[i].measured {
            true => self.follow_contour(i, now, start, poses),
            false => {
                let Self { tools, objects, tracks, .. } = self;
                let hiders = hiders(objects, tracks, i, poses);
                tools.measurer.find(&subject(now, &objects[tracks[i].object], &hiders), start)
            }
        }
    }

    /// Begins a track anew where a search has found its object.
    pub(crate) fn begin(&mut self, i: usize, now: &Now<'_>, trial: Trial) -> Trial {
        let track = &mut self.tracks[i];
        let phase = track.phase;
        *track = Track::new(track.object);
        (track.phase, track.known, track.pose, track.seen_ns) = (phase, true, trial.pose, now.frame.stamp_ns);
        trial
    }

    /// A track goes on elsewhere in this frame: what was remembered of it moves along.
    pub(crate) fn jump(&mut self, i: usize, from: &Pose, to: &Pose) {
        let object_from_corrected = from.inverse() * to;
        let track = &mut self.tracks[i];
        track.pose *= object_from_corrected;
        track.history.correct(&object_from_corrected);
        track.velocity.turn(&object_from_corrected);
        track.colours = Colours::default();
        track.keyframes.clear();
        (track.likeness, track.compared_at) = (None, 0);
    }

    /// Where a pose of an object in an earlier frame is now: by the object's own motion since, if it was seen then and in the last frame;
    /// else by that of the scene, since what is only believed to be somewhere may have moved otherwise. As it is where nothing tells.
    pub(crate) fn carried(&self, i: usize, seen: &Sighting, now: &[Pose], camera: &Intrinsics) -> Pose {
        let own = || self.moved_with(i, &now[i], seen);
        let scene = || self.motion_since(seen.frame, now, camera).map(|motion| motion * seen.pose);
        let track = &self.tracks[i];
        let carried = match track.measured && track.history.at(seen.frame).is_some_and(|then| then.measured) {
            true => own(),
            false => scene().or_else(own),
        };
        carried.unwrap_or(seen.pose)
    }

    /// Motion of the scene at rest since a frame, as the objects show it that are followed; of one alone where there is no other.
    fn motion_since(&self, frame: u64, now: &[Pose], camera: &Intrinsics) -> Option<Pose> {
        let followed = |i: usize| self.tracks[i].phase == Phase::Tracking;
        let bodies: Vec<Body> = self.bodies(frame, now, followed).into_iter().flatten().collect();
        motion_of(&bodies, camera)
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
        self.apart(track, a, b).is_within(NEAR)
    }

    /// How far two poses of an object are from each other.
    pub(crate) fn apart(&self, track: usize, a: &Pose, b: &Pose) -> Apart {
        let object = &self.objects[self.tracks[track].object];
        let middle: Point3<f64> = object.contour.centre_m();
        Apart { diameters: (a * middle - b * middle).norm() / object.diameter_m, rad: rotation_angle_rad(a, b) }
    }

    /// Whether what a look has seen elsewhere goes before what was predicted. Textures are those of the prediction's own keyframes, so
    /// contours are compared, and renderings of the mesh with the picture.
    fn prefers(&self, own: &Trial, other: &Trial, accepted: bool) -> bool {
        let (before, after) = (own.evidence.of_contour(), other.evidence.of_contour());
        let enough = other.evidence.seen() >= self.config.min_seen;
        if own.confidence < self.config.min_confidence && other.confidence > own.confidence + ALIKE {
            return true;
        }
        let told = own.evidence.contrast.min(other.evidence.contrast) > TELLING;
        let gain = if told { other.evidence.likeness - own.evidence.likeness } else { 0.0 };
        if gain.abs() > ALIKE {
            return gain > 0.0 && enough;
        }
        let bonus = if accepted { LOOK_BONUS } else { -LOOK_BONUS };
        enough && after > before - bonus
    }
}

/// Looks speak against tracks that are less sure than this. On tabletop's train split nine tenths of the wrong tracks are.
const DOUBTFUL_CONFIDENCE: f64 = 0.8;

/// How far two poses of an object are from each other: shift of its middle, and turn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Apart {
    pub(crate) diameters: f64,
    pub(crate) rad: f64,
}

impl Apart {
    pub(crate) fn is_within(&self, limit: Self) -> bool {
        self.diameters < limit.diameters && self.rad < limit.rad
    }
}

/// Poses that are the same for tracking.
const NEAR: Apart = Apart { diameters: 0.04, rad: 0.09 };
/// Poses of which one corrects the other.
const CORRECTS: Apart = Apart { diameters: 0.3, rad: 0.35 };

/// Where a look has found an object.
#[derive(Debug, Clone, Copy, PartialEq)]
enum LookOutcome {
    /// Where the track is.
    There,
    /// Elsewhere, and the track has gone there.
    Elsewhere,
    /// Elsewhere, and the track stays where it was.
    NotTaken,
}

/// Poses of what was found that are looked at.
const MOST_CANDIDATES: usize = 12;
/// How much less sure a contour may be of a pose that a look has found: a look sees what is inside of it.
const LOOK_BONUS: f64 = 0.2;
/// The difference of correlations that tells poses apart.
const ALIKE: f64 = 0.04;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::Evidence;
    use crate::tests::started;
    use nalgebra::Matrix6;

    #[test]
    fn a_look_that_is_surer_than_a_track_goes_before_it_though_the_picture_likes_it_less() {
        let mut tracker = started(12);
        tracker.tracks[0].verified = true;
        let evidence = Evidence { likeness: 0.8, contrast: 0.7, ..tracker.tracks[0].evidence };
        let own = Trial { evidence, confidence: 0.7, ..tracker_trial(&tracker) };
        let seen = Trial { evidence: Evidence { likeness: 0.6, ..evidence }, confidence: 0.4, ..own };
        let hidden = Trial { evidence: Evidence::default(), ..seen };
        let turned = Trial { pose: own.pose * Pose::rotation([0.0, 0.0, 3.1].into()), ..seen };
        let decides = |exact: bool, look: &Trial, accepted: bool, score: f64| {
            let kind = CorrectionKind::Look { accepted, score };
            let correction = Correction { object_id: 4, frame: 11, camera_from_object: own.pose, kind };
            tracker.takes_look(0, exact, (&own, look), &correction)
        };
        let takes = |look: &Trial, accepted: bool, score: f64| decides(true, look, accepted, score);
        assert!(!decides(false, &seen, true, 0.8), "from frame to frame the picture decides");
        assert!(takes(&seen, true, 0.8));
        assert!(!takes(&turned, true, 0.99), "quite another pose");
        assert!(!takes(&seen, true, 0.6) && !takes(&seen, false, 0.8) && !takes(&hidden, true, 0.8));
    }

    #[test]
    fn a_look_that_does_not_believe_itself_moves_a_track_only_where_the_picture_shows_the_object() {
        let tracker = started(12);
        let seen = tracker.tracks[0].evidence;
        let hidden = Evidence { agreement: 0.05, texture: 0.0, ..seen };
        let takes = |evidence: Evidence, confidence: f64, own: f64| {
            let kind = CorrectionKind::Look { accepted: false, score: 0.1 };
            let correction = Correction { object_id: 4, frame: 11, camera_from_object: tracker.tracks[0].pose, kind };
            let (own, look) = (
                Trial { confidence: own, ..tracker_trial(&tracker) },
                Trial { evidence, confidence, ..tracker_trial(&tracker) },
            );
            tracker.takes_look(0, false, (&own, &look), &correction)
        };
        assert!(takes(seen, 0.9, 0.1), "the picture shows it there and not here");
        assert!(!takes(seen, 0.2, 0.1), "the best of two bad ones");
        assert!(!takes(seen, 0.8, 0.9), "the track is surer");
        assert!(!takes(hidden, 0.9, 0.1), "nothing is seen there");
    }

    fn tracker_trial(tracker: &Tracker) -> Trial {
        let track = &tracker.tracks[0];
        Trial {
            pose: track.pose,
            information: Matrix6::zeros(),
            evidence: track.evidence,
            confidence: track.confidence,
        }
    }

    #[test]
    fn a_look_is_brought_here_by_the_motion_that_was_measured() {
        let tracker = started(12);
        let then = tracker.tracks[0].history.at(8).unwrap().pose;
        let (away, now) = (Pose::translation(0.0, 0.0, 0.01), tracker.tracks[0].pose);
        let seen = Sighting { frame: 8, pose: then * away };
        let here = tracker.moved_with(0, &now, &seen).unwrap();
        assert!((here.inverse() * (now * away)).translation.vector.norm() < 1e-9);
        assert!(tracker.moved_with(0, &now, &Sighting { frame: 99, ..seen }).is_none());
    }
}
