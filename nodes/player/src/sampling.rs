//! Which frames a training sees, in which order, with which partners (docs/method.md, "Self-supervision").
//!
//! A sample is one instance: a frame and one of its initial poses. Every epoch goes through all samples in an order of
//! its own. Whatever is drawn depends on the seed and the sample's place in the training alone, so that any sample can
//! be made again.

use crate::source::FrameFacts;
use nalgebra::{UnitQuaternion, Vector3};
use pseudoflow_geometry::pose_from_quaternion;
use pseudoflow_msgs::ObjectPose;
use pseudoflow_runtime::Stride;
use rand::Rng;
use rand::seq::SliceRandom;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::num::NonZeroU64;

/// Settings of sampling.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sampling {
    /// Samples to send.
    pub samples: u64,
    /// Samples of the training that were sent before this run.
    #[serde(default)]
    pub first: u64,
    /// Other frames that go with each sample for the photometric loss.
    #[serde(default = "default_partners")]
    pub partners: u32,
    /// Largest angle between the views of the object in a sample and its partner, degrees.
    #[serde(default = "default_angle_deg")]
    pub partner_angle_deg: u32,
    /// Leaves out every n-th frame of the recordings, to judge the training by.
    #[serde(default)]
    pub held_out_every: Option<u64>,
    /// Uses this many frames only, drawn at random.
    #[serde(default)]
    pub budget_frames: Option<u64>,
}

fn default_partners() -> u32 {
    1
}

fn default_angle_deg() -> u32 {
    25
}

impl Sampling {
    /// The held-out frames of `count`, at most `most` of them, evenly spread.
    #[must_use]
    pub fn held_out(every: NonZeroU64, count: u64, most: NonZeroU64) -> Stride {
        let all = Stride { start: every.get() - 1, step: every };
        let thinned = all.count(count).div_ceil(most.get()).max(1);
        Stride { step: every.saturating_mul(NonZeroU64::new(thinned).unwrap_or(NonZeroU64::MIN)), ..all }
    }

    /// Whether a frame is left out of the training.
    #[must_use]
    pub fn is_held_out(&self, number: usize) -> bool {
        self.held_out_every.is_some_and(|every| number as u64 % every == every - 1)
    }
}

/// One sample of a recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Number of the frame.
    pub frame: usize,
    /// Which of its initial poses.
    pub pose: usize,
    object_id: u32,
    /// The object as its own crop shows it: rotation seen along the ray through its origin.
    crop_from_object: UnitQuaternion<f64>,
}

/// All samples of a recording.
#[derive(Debug, Clone, Default)]
pub struct Sampler {
    samples: Vec<Sample>,
    /// Order of one epoch.
    order: Option<(u64, Vec<usize>)>,
}

/// Rotation of the object in a camera that looks straight at it.
fn seen_rotation(pose: &ObjectPose) -> Option<UnitQuaternion<f64>> {
    let camera_from_object = pose_from_quaternion(&pose.rotation_xyzw, &pose.translation_m).ok()?;
    let ray = camera_from_object.translation.vector;
    let straight_from_camera = UnitQuaternion::rotation_between(&ray, &Vector3::z())?;
    (ray.z > 0.0).then(|| straight_from_camera * camera_from_object.rotation)
}

impl Sampler {
    /// Takes the frames that may be used, with their initial poses. `rng` draws the budget.
    #[must_use]
    pub fn new(frames: &[FrameFacts], settings: &Sampling, rng: &mut impl Rng) -> Self {
        let usable = |number: &usize| !settings.is_held_out(*number) && !frames[*number].initial_poses.is_empty();
        let mut numbers: Vec<usize> = (0..frames.len()).filter(usable).collect();
        if let Some(budget) = settings.budget_frames {
            numbers.shuffle(rng);
            numbers.truncate(budget as usize);
            numbers.sort_unstable();
        }
        let of_frame = |number: usize| {
            let poses = frames[number].initial_poses.iter().enumerate();
            poses.filter_map(move |(pose, initial)| {
                let crop_from_object = seen_rotation(initial)?;
                Some(Sample { frame: number, pose, object_id: initial.object_id, crop_from_object })
            })
        };
        Self { samples: numbers.into_iter().flat_map(of_frame).collect(), order: None }
    }

    /// Samples of an epoch.
    #[must_use]
    pub fn len(&self) -> usize {
        self.samples.len()
    }

    /// Whether there is nothing to train on.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.samples.is_empty()
    }

    /// The sample at a place of the training; `shuffle_rng` gives the random source of an epoch.
    ///
    /// # Panics
    /// When there are no samples.
    pub fn at<R: Rng>(&mut self, place: u64, shuffle_rng: impl Fn(u64) -> R) -> Sample {
        let count = self.samples.len() as u64;
        let epoch = place / count;
        if self.order.as_ref().is_none_or(|(of, _)| *of != epoch) {
            let mut order: Vec<usize> = (0..self.samples.len()).collect();
            order.shuffle(&mut shuffle_rng(epoch));
            self.order = Some((epoch, order));
        }
        let at = self.order.as_ref().map_or(0, |(_, order)| order[(place % count) as usize]);
        self.samples[at]
    }

    /// Up to `most` samples of other frames that show the object from nearly the same side, drawn at random.
    pub fn partners(&self, of: &Sample, most: u32, angle_rad: f64, rng: &mut impl Rng) -> Vec<Sample> {
        let near = |other: &&Sample| {
            other.object_id == of.object_id
                && other.frame != of.frame
                && of.crop_from_object.angle_to(&other.crop_from_object) <= angle_rad
        };
        let mut found: Vec<Sample> = self.samples.iter().filter(near).copied().collect();
        let (drawn, _) = found.partial_shuffle(rng, most as usize);
        drawn.to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_geometry::{Pose, quaternion_xyzw};
    use rand::SeedableRng;
    use rand::rngs::StdRng;
    use std::collections::BTreeSet;

    fn initial(object_id: u32, yaw_deg: f64, x_m: f64) -> ObjectPose {
        let pose = Pose::new(Vector3::new(x_m, 0.0, 0.5), Vector3::y() * yaw_deg.to_radians());
        let mut given: ObjectPose = bytemuck::Zeroable::zeroed();
        given.object_id = object_id;
        given.rotation_xyzw = quaternion_xyzw(&pose);
        given.translation_m = pose.translation.vector.into();
        given
    }

    fn frames(count: usize) -> Vec<FrameFacts> {
        let facts = |i: usize| FrameFacts {
            scene_id: 1,
            image_id: i as u32,
            intrinsics: [500.0, 500.0, 320.0, 240.0],
            initial_poses: vec![initial(1, 10.0 * i as f64, 0.0), initial(2, 0.0, 0.0)],
        };
        (0..count).map(facts).collect()
    }

    fn settings() -> Sampling {
        serde_json::from_str(r#"{"samples": 100, "held_out_every": 4, "budget_frames": 5}"#).unwrap()
    }

    #[test]
    fn an_epoch_has_every_sample_once_and_each_epoch_its_order() {
        let settings = Sampling { budget_frames: None, ..settings() };
        let mut sampler = Sampler::new(&frames(8), &settings, &mut StdRng::seed_from_u64(0));
        assert_eq!(sampler.len(), 12, "frames 3 and 7 are held out");
        let mut epoch = |first: u64| -> Vec<(usize, usize)> {
            (first..first + 12).map(|k| sampler.at(k, StdRng::seed_from_u64)).map(|s| (s.frame, s.pose)).collect()
        };
        let (one, two) = (epoch(0), epoch(12));
        assert_ne!(one, two);
        for order in [&one, &two] {
            assert_eq!(order.iter().collect::<BTreeSet<_>>().len(), 12);
            assert!(order.iter().all(|(frame, _)| frame % 4 != 3));
        }
        assert_eq!(epoch(0), one, "an epoch can be made again");
    }

    #[test]
    fn a_budget_is_drawn_from_what_is_not_held_out() {
        let sampler = Sampler::new(&frames(20), &settings(), &mut StdRng::seed_from_u64(3));
        let used: BTreeSet<usize> = sampler.samples.iter().map(|s| s.frame).collect();
        assert_eq!(used.len(), 5);
        assert!(used.iter().all(|frame| frame % 4 != 3), "{used:?}");
    }

    #[test]
    fn partners_are_other_frames_of_the_object_seen_from_near() {
        let settings = Sampling { held_out_every: None, budget_frames: None, ..settings() };
        let sampler = Sampler::new(&frames(9), &settings, &mut StdRng::seed_from_u64(0));
        let of = sampler.samples[6]; // frame 3, object 1, 30 degrees
        let mut rng = StdRng::seed_from_u64(1);
        let all: BTreeSet<usize> =
            sampler.partners(&of, 9, 25_f64.to_radians(), &mut rng).iter().map(|s| s.frame).collect();
        assert_eq!(all, BTreeSet::from([1, 2, 4, 5]));
        let drawn = |rng: &mut StdRng| sampler.partners(&of, 3, 25_f64.to_radians(), rng);
        assert_eq!(drawn(&mut rng).len(), 3);
        assert!((0..20).any(|_| drawn(&mut rng) != drawn(&mut rng)), "drawn at random");
    }

    #[test]
    fn held_out_frames_are_those_that_no_sample_is_drawn_from() {
        let number = |n| NonZeroU64::new(n).unwrap();
        let all: Vec<u64> = Sampling::held_out(number(4), 20, number(80)).numbers(20).collect();
        assert_eq!(all, [3, 7, 11, 15, 19]);
        assert!((0..20).all(|n| settings().is_held_out(n as usize) == all.contains(&n)));
        let few: Vec<u64> = Sampling::held_out(number(4), 20, number(3)).numbers(20).collect();
        assert_eq!(few, [3, 11, 19]);
        assert_eq!(Sampling::held_out(number(4), 2, number(3)).count(2), 0);
    }

    #[test]
    fn nearness_is_that_of_the_crops() {
        // Aside of the optical axis the same rotation shows another side.
        let straight = seen_rotation(&initial(1, 0.0, 0.0)).unwrap();
        let aside = seen_rotation(&initial(1, 0.0, 0.5)).unwrap();
        let turned = seen_rotation(&initial(1, 45.0, 0.5)).unwrap();
        assert!((straight.angle_to(&aside).to_degrees() - 45.0).abs() < 1e-6);
        assert!(straight.angle_to(&turned) < 1e-6);
    }
}
