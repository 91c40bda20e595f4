//! One object in one picture: its contour, with the motion since the last frame as prior.

use crate::config::TextureConfig;
use crate::evidence::Evidence;
use crate::texture::{Keyframe, Pyramid, TextureTerm, matches};
use crate::tracker::is_long_gap;
use crate::types::KnownObject;
use crate::{TrackingConfig, TrackingError};
use nalgebra::Matrix6;
use pseudoflow_contour::{Colours, Hider, Image, Prior, Refiner, Region, Task};
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
}

/// What a picture is measured with. Holds its working memory.
#[derive(Debug, Clone)]
pub(crate) struct Measurer {
    near: Refiner,
    far: Refiner,
    frame_s: f64,
    texture: TextureConfig,
}

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
