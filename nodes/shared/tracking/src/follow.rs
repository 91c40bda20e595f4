//! All objects of a frame, each from its prediction.

use crate::measure::{Subject, Trial};
use crate::texture::Keyframe;
use crate::track::{Phase, Track};
use crate::tracker::{Now, Tracker};
use crate::types::{Correction, KnownObject};
use pseudoflow_contour::{Hider, Image};
use pseudoflow_geometry::Pose;

impl Tracker {
    /// Measures every known object, nearer ones first, since they hide those behind.
    pub(crate) fn measure_all(
        &mut self,
        now: &Now<'_>,
        predicted: &[Pose],
        corrections: &[Correction],
    ) -> Vec<Option<Trial>> {
        let mut poses = predicted.to_vec();
        let mut trials = vec![None; self.tracks.len()];
        for group in self.groups(now, predicted) {
            let measured = self.side_by_side(&group, |this, i| {
                let own = this.tracks[i].known.then(|| this.follow(i, now, &predicted[i], &poses));
                this.correct(i, now, own, (predicted, corrections), &poses)
            });
            for (i, trial) in group.into_iter().zip(measured) {
                if let Some(trial) = trial.filter(|t| t.evidence.seen() >= self.config.min_seen) {
                    poses[i] = trial.pose;
                }
                trials[i] = trial;
            }
        }
        trials
    }

    pub(crate) fn by_depth(&self, poses: &[Pose]) -> Vec<usize> {
        let mut order: Vec<usize> = (0..poses.len()).collect();
        order.sort_by(|a, b| poses[*a].translation.z.total_cmp(&poses[*b].translation.z));
        order
    }

    pub(crate) fn follow(&mut self, i: usize, now: &Now<'_>, start: &Pose, poses: &[Pose]) -> Trial {
        let keyframes = std::mem::take(&mut self.tracks[i].keyframes);
        let trial = self.follow_with(i, now, start, poses, &keyframes);
        self.tracks[i].keyframes = keyframes;
        trial
    }

    pub(crate) fn follow_contour(&mut self, i: usize, now: &Now<'_>, start: &Pose, poses: &[Pose]) -> Trial {
        self.follow_with(i, now, start, poses, &[])
    }

    pub(crate) fn follow_with(
        &mut self,
        i: usize,
        now: &Now<'_>,
        start: &Pose,
        poses: &[Pose],
        keyframes: &[Keyframe],
    ) -> Trial {
        let mut colours = std::mem::take(&mut self.tracks[i].colours);
        let Self { tools, objects, tracks, .. } = self;
        let hiders = hiders(objects, tracks, i, poses);
        let subject = subject(now, &objects[tracks[i].object], &hiders);
        if colours.is_empty() && !keyframes.is_empty() {
            tools.measurer.learn(&subject, start, &mut colours, 1.0);
        }
        let trial = match colours.is_empty() {
            true => tools.measurer.find(&subject, start),
            false => tools.measurer.follow(&subject, start, &mut colours, keyframes),
        };
        self.tracks[i].colours = colours;
        trial
    }
}

pub(crate) fn poses_of(trials: &[Option<Trial>], otherwise: &[Pose]) -> Vec<Pose> {
    trials.iter().zip(otherwise).map(|(t, p)| t.map_or(*p, |t| t.pose)).collect()
}

/// The other objects that may hide one.
pub(crate) fn hiders<'a>(objects: &'a [KnownObject], tracks: &[Track], i: usize, poses: &[Pose]) -> Vec<Hider<'a>> {
    let others = (0..tracks.len()).filter(|j| *j != i && tracks[*j].known && tracks[*j].phase == Phase::Tracking);
    others.map(|j| Hider { model: &objects[tracks[j].object].contour, camera_from_object: poses[j] }).collect()
}

pub(crate) fn subject<'a>(now: &Now<'a>, object: &'a KnownObject, hiders: &'a [Hider<'a>]) -> Subject<'a> {
    let image = Image { rgb: now.frame.rgb, intrinsics: now.frame.intrinsics };
    Subject { image, object, hiders, pyramid: now.pyramid, gap_s: now.gap_s }
}
