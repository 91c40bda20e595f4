//! One object in one picture: its contour, with the motion since the last frame as prior.

use crate::config::TextureConfig;
use crate::evidence::Evidence;
use crate::texture::{Keyframe, Likeness, Pyramid, TextureTerm, matches};
use crate::tracker::is_long_gap;
use crate::types::KnownObject;
use crate::{TrackingConfig, TrackingError};
use nalgebra::{Matrix6, Vector6};
use pseudoflow_contour::{Colours, Hider, Image, Prior, Refiner, Region, Task, Term, retract};
use pseudoflow_geometry::{Pose, rotation_angle_rad};

/// A pose and what the picture says of it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Trial {
    pub(crate) pose: Pose,
    /// Inverse covariance, tangent of the solver.
    pub(crate) information: Matrix6<f64>,
    pub(crate) evidence: Evidence,
    pub(crate) confidence: f64,
}

impl Trial {
    /// A prediction that no picture speaks for.
    pub(crate) fn blind(pose: Pose) -> Self {
        Self { pose, information: Matrix6::zeros(), evidence: Evidence::default(), confidence: 0.0 }
    }

    /// The same with what a rendering of the mesh says.
    pub(crate) fn with_likeness(mut self, likeness: Option<Likeness>) -> Self {
        self.evidence.looked_at(likeness);
        self.confidence = self.evidence.confidence();
        self
    }
}

/// What a picture is measured with. Holds its working memory.
#[derive(Debug, Clone)]
pub(crate) struct Measurer {
    near: Refiner,
    far: Refiner,
    frame_s: f64,
    texture: TextureConfig,
}

/// How exactly points of a rendering are found in the picture, at best, pixels; steps of the fit.
const ANCHOR_SIGMA_PX: f64 = 0.35;
const ANCHOR_STEPS: usize = 10;
/// A point agrees that is missed by less, pixels; this many times as many, and so many more, must agree with the pose that they lead
/// to. Of 1.2, 1.3 and 1.5 times 1.3 was best on the rendered sequences of the train side.
const ANCHOR_AGREE_PX: f64 = 0.6;
const ANCHOR_MORE: f64 = 1.3;
const ANCHOR_FEWEST: f64 = 2.0;

/// The keyframe that shows an object most as a pose does.
pub(crate) fn nearest<'a>(keyframes: &'a [Keyframe], pose: &Pose) -> Option<&'a Keyframe> {
    keyframes.iter().min_by(|a, b| apart(a, pose).total_cmp(&apart(b, pose)))
}

/// How differently a keyframe shows an object, radians; half as large or twice as large counts as much as 40 degrees.
pub(crate) fn apart(keyframe: &Keyframe, pose: &Pose) -> f64 {
    let scale = (pose.translation.z / keyframe.pose.translation.z).max(1e-3).ln().abs();
    rotation_angle_rad(&keyframe.pose, pose) + scale
}

/// An object to be measured.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Subject<'a> {
    pub(crate) image: Image<'a>,
    pub(crate) object: &'a KnownObject,
    pub(crate) hiders: &'a [Hider<'a>],
    /// The picture as brightness.
    pub(crate) pyramid: &'a Pyramid,
    /// Time since the last frame, seconds.
    pub(crate) gap_s: f64,
}

impl Measurer {
    pub(crate) fn new(config: &TrackingConfig) -> Result<Self, TrackingError> {
        let (near, far) = (Refiner::new(config.region.clone())?, Refiner::new(config.first.clone())?);
        Ok(Self { near, far, frame_s: config.frame_s, texture: config.texture.clone() })
    }

    /// From a prediction, with the colours of the frames before.
    pub(crate) fn follow(
        &mut self,
        subject: &Subject<'_>,
        start: &Pose,
        colours: &mut Colours,
        keyframes: &[Keyframe],
    ) -> Trial {
        let prior = self.prior(subject, start);
        let task = subject.task(&prior);
        let camera = subject.image.intrinsics;
        // After a long gap the contour may be further away than the fine schedule reads.
        let far = is_long_gap(subject.gap_s, self.frame_s);
        let seen =
            nearest(keyframes, start).map(|k| matches(k, subject.pyramid, start, &camera, self.reach(subject, start)));
        let Some(seen) = seen.filter(|seen| !seen.is_empty()) else {
            let refiner = if far { &mut self.far } else { &mut self.near };
            return subject.trial(&refiner.follow(&task, start, colours, None));
        };
        let mut term =
            TextureTerm { matches: &seen, camera, sigma_px: self.texture.sigma_px, share: self.texture.share };
        let refiner = if far { &mut self.far } else { &mut self.near };
        let region = refiner.follow(&task, start, colours, Some(&mut term));
        let mut trial = subject.trial(&region);
        trial.evidence.texture = term.agreeing(&trial.pose);
        trial.evidence.textured = seen.len() as f64 / (seen.len() as f64 + 10.0);
        if trial.confidence > 0.0 {
            trial.confidence = trial.evidence.confidence();
        }
        trial
    }

    /// Where the points of a keyframe of the mesh say that an object is, if clearly more of them agree with that than with `start`. The
    /// contour has no part in it: its colours may have been learnt at a wrong pose.
    pub(crate) fn anchored(&self, subject: &Subject<'_>, start: &Pose, keyframe: &Keyframe) -> Option<Pose> {
        let (camera, prior) = (subject.image.intrinsics, self.prior(subject, start));
        let seen = matches(keyframe, subject.pyramid, start, &camera, self.reach(subject, start));
        let sigma_px = [ANCHOR_SIGMA_PX, self.texture.sigma_px[1]];
        let mut term = TextureTerm { matches: &seen, camera, sigma_px, share: 1.0 };
        let mut pose = *start;
        for _ in 0..ANCHOR_STEPS {
            let (mut hessian, mut gradient) = (Matrix6::zeros(), Vector6::zeros());
            prior.accumulate(&pose, &mut hessian, &mut gradient);
            term.accumulate(&pose, &mut hessian, &mut gradient);
            pose = retract(&pose, &-hessian.cholesky()?.solve(&gradient));
        }
        let (before, after) = (term.within(start, ANCHOR_AGREE_PX), term.within(&pose, ANCHOR_AGREE_PX));
        (after as f64 > ANCHOR_MORE * before as f64 + ANCHOR_FEWEST).then_some(pose)
    }

    /// How far patches may have moved beside the prediction, and the levels that this needs.
    fn reach(&self, subject: &Subject<'_>, start: &Pose) -> (usize, f32) {
        let size_px = subject.object.diameter_m * subject.image.intrinsics.fx / start.translation.z.max(1e-3);
        let slower = (subject.gap_s / self.frame_s).sqrt().clamp(1.0, 4.0);
        let most_px = (self.texture.reach * size_px * slower) as f32;
        (if most_px > 6.0 { 3 } else { 2 }, most_px.max(3.0))
    }

    /// From a pose that may be further off, with colours of its own.
    pub(crate) fn find(&mut self, subject: &Subject<'_>, start: &Pose) -> Trial {
        let prior = self.far.prior(start, &subject.object.contour, subject.object.diameter_m);
        let region = self.far.refine(&subject.task(&prior), &[*start], None);
        subject.trial(&region)
    }

    /// Learns colours at a pose that is believed.
    pub(crate) fn learn(&mut self, subject: &Subject<'_>, pose: &Pose, colours: &mut Colours, renewal: f32) {
        let prior = self.prior(subject, pose);
        let task = subject.task(&prior);
        self.near.learn(&task, pose, colours, renewal);
    }

    /// The prior of a prediction: its spread grows with the root of the time since the last frame.
    fn prior(&self, subject: &Subject<'_>, at: &Pose) -> Prior {
        let mut prior = self.near.prior(at, &subject.object.contour, subject.object.diameter_m);
        let narrower = (self.frame_s / subject.gap_s.max(1e-3)).clamp(0.01, 1.0);
        prior.information.iter_mut().for_each(|i| *i *= narrower);
        prior
    }
}

impl<'a> Subject<'a> {
    fn task<'b>(&'b self, prior: &'b Prior) -> Task<'b>
    where
        'a: 'b,
    {
        Task { image: self.image, model: &self.object.contour, prior, hiders: self.hiders }
    }

    fn trial(&self, region: &Region) -> Trial {
        let points = self.object.contour.view(&region.camera_from_object).len().max(1);
        let evidence = Evidence {
            agreement: region.agreement,
            lines: region.lines as f64 / points as f64,
            overlap: f64::from(region.overlap),
            ..Evidence::default()
        };
        Trial {
            pose: region.camera_from_object,
            information: region.information,
            evidence,
            confidence: if region.status.is_ok() { evidence.confidence() } else { 0.0 },
        }
    }
}
