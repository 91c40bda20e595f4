//! The picture against the mesh itself, and keyframes of it: what contours do not tell.

use crate::config::TextureConfig;
use crate::follow::poses_of;
use crate::measure::{Trial, apart, nearest};
use crate::texture::Likeness;
use crate::track::{Phase, Track};
use crate::tracker::{Now, Tracker};
use crate::types::KnownObject;
use pseudoflow_geometry::Pose;
use pseudoflow_imaging::raster::Item;

/// Renderings less like the picture than this are moved to it, if they have so much contrast (grey levels); by at least so much
/// they must then be more alike.
const ANCHORED: f64 = 0.8;
const ANCHOR_CONTRAST: f64 = 5.0;
const ANCHOR_GAIN: f64 = 0.03;
/// How far off a rendering may be: as far as things move in this time.
const ANCHOR_GAP_S: f64 = 0.5;
/// Confidence from which a frame is a keyframe: a wrong one would hold the object where it is.
const KEYFRAME_CONFIDENCE: f64 = 0.15;

impl Tracker {
    /// A trial with what a rendering of it says.
    pub(crate) fn compared(&mut self, i: usize, now: &Now<'_>, trial: &Trial, poses: &[Pose]) -> Trial {
        let likeness = self.likeness(i, now, &trial.pose, poses);
        let mut trial = *trial;
        trial.evidence.looked_at(likeness);
        trial.confidence = trial.evidence.confidence();
        trial
    }

    pub(crate) fn likeness(&mut self, i: usize, now: &Now<'_>, pose: &Pose, poses: &[Pose]) -> Option<Likeness> {
        let Self { maker, objects, tracks, .. } = self;
        let items = items(objects, tracks, i, pose, poses);
        maker.likeness(now.pyramid, &items, &now.frame.intrinsics)
    }

    /// Compares a rendering of one object with the picture, each in turn, so that no frame takes long.
    pub(crate) fn compare_one(&mut self, now: &Now<'_>, trials: &mut [Option<Trial>], predicted: &[Pose]) {
        let there = |i: &usize| trials[*i].is_some_and(|t| t.evidence.lines > 0.0);
        let mut due: Vec<usize> = (0..trials.len()).filter(there).collect();
        due.sort_by_key(|i| self.tracks[*i].compared_at);
        // After a long gap what was seen before tells little, and there is time.
        let at_most = if self.after_long_gap(now) { due.len() } else { 1 };
        let poses = poses_of(trials, predicted);
        for i in due.into_iter().take(at_most) {
            self.tracks[i].compared_at = now.frame.index + 1;
            self.tracks[i].likeness = self.likeness(i, now, &poses[i], &poses);
            if let Some(trial) = self.anchored(i, now, &poses) {
                trials[i] = Some(trial);
            }
        }
    }

    /// A pose that the mesh itself, rendered where the object is believed to be, is more like than there.
    pub(crate) fn anchored(&mut self, i: usize, now: &Now<'_>, poses: &[Pose]) -> Option<Trial> {
        let before = self.tracks[i].likeness.filter(|l| l.contrast > ANCHOR_CONTRAST && l.correlation < ANCHORED)?;
        let keyframe = {
            let Self { maker, objects, tracks, .. } = self;
            maker.rendered(now.pyramid, &items(objects, tracks, i, &poses[i], poses), &now.frame.intrinsics)?
        };
        let wide = Now { gap_s: now.gap_s.max(ANCHOR_GAP_S), ..*now };
        let trial = self.follow_with(i, &wide, &poses[i], poses, &[keyframe]);
        if trial.evidence.seen() < self.config.min_seen {
            return None;
        }
        let after = self.likeness(i, now, &trial.pose, poses)?;
        if after.correlation < before.correlation + ANCHOR_GAIN {
            return None;
        }
        self.jump(i, &poses[i], &trial.pose);
        (self.tracks[i].likeness, self.tracks[i].texture_due) = (Some(after), true);
        Some(trial)
    }

    /// Makes a keyframe of the object that needs one most; one a frame, so that no frame takes long.
    pub(crate) fn remember_texture(&mut self, now: &Now<'_>) {
        let TextureConfig { keyframes, keyframe_deg, .. } = self.config.texture;
        let newness = |t: &Track| match keyframes > 0
            && t.measured
            && (t.texture_due || t.learnt && t.confidence >= KEYFRAME_CONFIDENCE)
        {
            true => nearest(&t.keyframes, &t.pose).map_or(f64::INFINITY, |k| apart(k, &t.pose).to_degrees()),
            false => 0.0,
        };
        let ranked = (0..self.tracks.len()).map(|i| (newness(&self.tracks[i]), i));
        let due = ranked.filter(|(n, i)| *n > keyframe_deg && now.frame.index >= self.tracks[*i].texture_from);
        let Some((_, i)) = due.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1))) else { return };
        let item = |t: &Track| Item { mesh: &self.objects[t.object].mesh, camera_from_object: t.pose };
        let others = self.tracks.iter().enumerate().filter(|(j, t)| *j != i && t.known && t.phase == Phase::Tracking);
        let items: Vec<Item<'_>> = std::iter::once(item(&self.tracks[i])).chain(others.map(|(_, t)| item(t))).collect();
        let made = self.maker.make(now.pyramid, &items, &now.frame.intrinsics);
        let track = &mut self.tracks[i];
        track.texture_due = false;
        match made {
            Some(keyframe) => track.keyframes.push(keyframe),
            // Too plain, or too small: not tried again in every frame.
            None => track.texture_from = now.frame.index + 30,
        }
        if track.keyframes.len() > keyframes {
            let pose = track.pose;
            let farthest = (0..keyframes)
                .max_by(|a, b| apart(&track.keyframes[*a], &pose).total_cmp(&apart(&track.keyframes[*b], &pose)));
            track.keyframes.remove(farthest.unwrap_or(0));
        }
    }
}

/// An object, and the others that may hide it, to be rendered.
fn items<'a>(objects: &'a [KnownObject], tracks: &[Track], i: usize, pose: &Pose, poses: &[Pose]) -> Vec<Item<'a>> {
    let item = |j: usize, pose: &Pose| Item { mesh: &objects[tracks[j].object].mesh, camera_from_object: *pose };
    let others = (0..tracks.len()).filter(|j| *j != i && tracks[*j].known && tracks[*j].phase == Phase::Tracking);
    std::iter::once(item(i, pose)).chain(others.map(|j| item(j, &poses[j]))).collect()
}
