//! The picture against the mesh itself, and keyframes of it: what contours do not tell.

use crate::config::TextureConfig;
use crate::follow::{poses_of, subject};
use crate::measure::{Trial, apart, nearest};
use crate::texture::Likeness;
use crate::track::{Phase, Track};
use crate::tracker::{Now, Tracker};
use crate::types::KnownObject;
use pseudoflow_geometry::Pose;
use pseudoflow_imaging::raster::Item;

/// Objects that are compared in one frame: as many cores as a robot spares.
const COMPARED_TOGETHER: usize = 2;
/// Frames for each comparison where frames were dropped; else one.
const LATE_FRAMES: u64 = 6;
/// Objects are bound to a rendering of their mesh, if it has so much contrast (grey levels). The picture may be less like the mesh
/// there by so much: on a plain face correlation hangs on light and sharpness more than on a turn of ten degrees.
pub(crate) const ANCHOR_CONTRAST: f64 = 5.0;
const ANCHOR_LOSS: f64 = 0.05;
/// A rendering that brought nothing is tried again after 1, 3, then 7 further comparisons of its object, or once the picture is so
/// much less like the mesh.
const MOST_SKIPPED: u32 = 7;
const WORSE: f64 = 0.05;
/// How far off a rendering may be: as far as things move in this time.
const ANCHOR_GAP_S: f64 = 0.5;
/// Confidence from which a frame is a keyframe: a wrong one would hold the object where it is.
const KEYFRAME_CONFIDENCE: f64 = 0.15;

impl Tracker {
    /// A trial with what a rendering of it says.
    pub(crate) fn compared(&mut self, i: usize, now: &Now<'_>, trial: &Trial, poses: &[Pose]) -> Trial {
        let likeness = self.likeness(i, now, &trial.pose, poses);
        trial.with_likeness(likeness)
    }

    pub(crate) fn likeness(&mut self, i: usize, now: &Now<'_>, pose: &Pose, poses: &[Pose]) -> Option<Likeness> {
        let Self { tools, objects, tracks, .. } = self;
        let items = items(objects, tracks, i, pose, poses);
        tools.maker.likeness(now.pyramid, &items, &now.frame.intrinsics)
    }

    /// Compares renderings of objects with the picture, two every other frame, all in turn, so that no frame takes long.
    pub(crate) fn compare_some(&mut self, now: &Now<'_>, trials: &mut [Option<Trial>], predicted: &[Pose]) {
        let there = |i: &usize| trials[*i].is_some_and(|t| t.evidence.lines > 0.0);
        let mut due: Vec<usize> = (0..trials.len()).filter(there).collect();
        due.sort_by_key(|i| self.tracks[*i].compared_at);
        let last = self.tracks.iter().map(|t| t.compared_at).max().unwrap_or(0);
        let together = due.len().min(COMPARED_TOGETHER);
        // Whoever is late has little time for it.
        let frames_each = if now.late { LATE_FRAMES } else { 1 };
        // After a long gap what was seen before tells little.
        due.truncate(match self.after_long_gap(now) && !now.late {
            true => due.len(),
            false if now.frame.index + 1 >= last + frames_each * together as u64 => together,
            false => 0,
        });
        let poses = poses_of(trials, predicted);
        let moved = self.side_by_side(&due, |this, i| this.compare(i, now, trials[i].as_ref(), &poses));
        for (i, trial) in due.into_iter().zip(moved) {
            trials[i] = trial.or(trials[i]);
        }
    }

    /// Compares a rendering of an object with the picture; where else it is, if the mesh itself or half a turn leads there.
    fn compare(&mut self, i: usize, now: &Now<'_>, own: Option<&Trial>, poses: &[Pose]) -> Option<Trial> {
        self.tracks[i].compared_at = now.frame.index + 1;
        self.tracks[i].likeness = self.likeness(i, now, &poses[i], poses);
        self.anchored(i, now, poses).or_else(|| self.turned(i, now, own?, poses))
    }

    /// The pose that the mesh itself, rendered where the object is believed to be, leads to, if clearly more of it agrees with that:
    /// keyframes and colours hold an object where it was believed to be when they were taken, wrongly turned or not.
    pub(crate) fn anchored(&mut self, i: usize, now: &Now<'_>, poses: &[Pose]) -> Option<Trial> {
        let before = self.tracks[i].likeness.filter(|l| l.contrast > ANCHOR_CONTRAST)?;
        if !self.tracks[i].anchoring.is_due(before.correlation) {
            return None;
        }
        let found = self.moved_to_rendering(i, now, poses, before.correlation - ANCHOR_LOSS);
        self.tracks[i].anchoring.note(before.correlation, found.is_some());
        let (trial, after) = found?;
        self.jump(i, &poses[i], &trial.pose);
        (self.tracks[i].likeness, self.tracks[i].texture_due) = (Some(after), true);
        Some(trial)
    }

    /// What a look is worth, bound to the mesh as tracks are: a look is right to a few pixels, a track lies on the texture to a fraction
    /// of one, and would win though it is wrongly turned. The mesh is rendered where the contour led the look (`trial`), and where the
    /// look said (`look`): beside something that hides the object the contour may lead it away.
    pub(crate) fn polished(&mut self, i: usize, now: &Now<'_>, trial: Trial, look: &Pose, poses: &[Pose]) -> Trial {
        let mut there = poses.to_vec();
        let mut best = trial;
        for start in [trial.pose, *look] {
            there[i] = start;
            let moved = self.moved_to_rendering(i, now, &there, trial.evidence.likeness);
            let moved = moved.map(|(moved, likeness)| moved.with_likeness(Some(likeness)));
            if let Some(moved) = moved.filter(|m| m.confidence > best.confidence) {
                best = moved;
            }
        }
        best
    }

    /// The pose that a rendering of the mesh leads to, and how like the picture the mesh is there, if that is at least `least`.
    fn moved_to_rendering(&mut self, i: usize, now: &Now<'_>, poses: &[Pose], least: f64) -> Option<(Trial, Likeness)> {
        let keyframe = {
            let Self { tools, objects, tracks, .. } = self;
            tools.maker.rendered(now.pyramid, &items(objects, tracks, i, &poses[i], poses), &now.frame.intrinsics)?
        };
        let wide = now.reaching_far();
        let there = {
            let Self { tools, objects, tracks, .. } = self;
            tools.measurer.anchored(&subject(&wide, &objects[tracks[i].object], &[]), &poses[i], &keyframe)?
        };
        let colours = std::mem::take(&mut self.tracks[i].colours);
        let trial = self.follow_with(i, now, &there, poses, &[keyframe]);
        self.tracks[i].colours = colours;
        if trial.evidence.seen() < self.config.min_seen {
            return None;
        }
        let after = self.likeness(i, now, &trial.pose, poses)?;
        (after.correlation >= least).then_some((trial, after))
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
        let made = self.tools.maker.make(now.pyramid, &items, &now.frame.intrinsics);
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

impl Now<'_> {
    /// The same frame for a start that may be further off than things move from frame to frame.
    pub(crate) fn reaching_far(&self) -> Self {
        Self { gap_s: self.gap_s.max(ANCHOR_GAP_S), ..*self }
    }
}

/// When what brought nothing is to be tried again: to move an object to a rendering of it, or to turn it.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Retries {
    /// Comparisons that are still to be left out, and how many were the last time.
    skip: u32,
    skipped: u32,
    /// How like the mesh the picture was when a rendering last brought nothing.
    failed_at: f64,
}

impl Retries {
    pub(crate) fn is_due(&mut self, correlation: f64) -> bool {
        if self.skip == 0 || correlation < self.failed_at - WORSE {
            return true;
        }
        self.skip -= 1;
        false
    }

    pub(crate) fn note(&mut self, correlation: f64, moved: bool) {
        *self = match moved {
            true => Self::default(),
            false => {
                let skipped = (2 * self.skipped + 1).min(MOST_SKIPPED);
                Self { skip: skipped, skipped, failed_at: correlation }
            }
        };
    }
}

/// An object, and the others that may hide it, to be rendered.
fn items<'a>(objects: &'a [KnownObject], tracks: &[Track], i: usize, pose: &Pose, poses: &[Pose]) -> Vec<Item<'a>> {
    let item = |j: usize, pose: &Pose| Item { mesh: &objects[tracks[j].object].mesh, camera_from_object: *pose };
    let others = (0..tracks.len()).filter(|j| *j != i && tracks[*j].known && tracks[*j].phase == Phase::Tracking);
    std::iter::once(item(i, pose)).chain(others.map(|j| item(j, &poses[j]))).collect()
}
