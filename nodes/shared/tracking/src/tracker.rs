use crate::config::TextureConfig;
use crate::history::Moment;
use crate::judge::Evidence;
use crate::looks::{self, Budget, Look};
use crate::measure::{Eye, Subject, Trial, apart, nearest};
use crate::rest::{Common, common_motion};
use crate::texture::{Keyframe, Maker, Pyramid};
use crate::track::{Phase, Track};
use crate::{TrackingConfig, TrackingError};
use nalgebra::Matrix6;
use pseudoflow_contour::{ContourModel, Hider, Image};
use pseudoflow_geometry::{Intrinsics, Pose};
use pseudoflow_imaging::raster::Item;
use pseudoflow_imaging::{Mesh, RgbImage};
use std::fmt;
use std::sync::Arc;

/// An object that can be followed.
#[derive(Debug, Clone)]
pub struct KnownObject {
    /// Its id in the set.
    pub id: u32,
    /// Its mesh.
    pub mesh: Arc<Mesh>,
    /// Its contour from all sides.
    pub contour: ContourModel,
    /// Its diameter, metres.
    pub diameter_m: f64,
}

/// A frame of the camera.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    /// Its number; grows.
    pub index: u64,
    /// Its time, nanoseconds; grows.
    pub stamp_ns: i64,
    /// The pixels.
    pub rgb: &'a RgbImage,
    /// The camera.
    pub intrinsics: Intrinsics,
}

/// Who found a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CorrectionKind {
    /// A search, which knows nothing of the track: rough.
    Found,
    /// The network's look that was asked for.
    Look {
        /// Whether the look was judged better than the pose that it began from, or that pose right.
        accepted: bool,
    },
}

/// A pose that others have found in an earlier frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correction {
    /// The object.
    pub object_id: u32,
    /// The frame that it was found in.
    pub frame: u64,
    /// Its pose there.
    pub camera_from_object: Pose,
    /// Who found it.
    pub kind: CorrectionKind,
}

/// An object in a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// The object.
    pub object_id: u32,
    /// Its pose.
    pub camera_from_object: Pose,
    /// Whether the frame shows it there; else it is only believed to be there.
    pub measured: bool,
    /// Probability that the pose is right to a tenth of the diameter.
    pub confidence: f64,
    /// Row-major 6 x 6, tangent of `pseudoflow-contour`'s `retract`; grows while the pose is not measured.
    pub covariance: [f64; 36],
    /// Where its tracking stands.
    pub phase: Phase,
    /// Frames in a row in which it was seen, and in which it was not.
    pub good_frames: u32,
    /// See `good_frames`.
    pub bad_frames: u32,
    /// What the picture says.
    pub evidence: Evidence,
}

/// Why a frame could not be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameProblem {
    /// Its time is not after that of the frame before.
    OutOfOrder,
    /// It is black, or of one colour.
    Dark,
}

impl fmt::Display for FrameProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::OutOfOrder => "older than one before it: not used",
            Self::Dark => "black or of one colour: objects are held where they are believed to be",
        })
    }
}

/// What became of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// Every object that was ever found; none when the frame is out of order.
    pub estimates: Vec<Estimate>,
    /// Why the frame could not be used.
    pub problem: Option<FrameProblem>,
}

/// A frame with what is made of it once for all objects.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Now<'a> {
    frame: Frame<'a>,
    pyramid: &'a Arc<Pyramid>,
    gap_s: f64,
}

/// Follows objects from frame to frame.
#[derive(Debug)]
pub struct Tracker {
    pub(crate) config: TrackingConfig,
    pub(crate) objects: Vec<KnownObject>,
    pub(crate) tracks: Vec<Track>,
    eye: Eye,
    maker: Maker,
    last: Option<(u64, i64)>,
    camera: Option<((u32, u32), Intrinsics)>,
    budget: Budget,
}

impl Tracker {
    /// A tracker that has seen nothing yet.
    ///
    /// # Errors
    /// [`TrackingError`] when a setting is out of range or there is no object.
    pub fn new(objects: Vec<KnownObject>, config: TrackingConfig) -> Result<Self, TrackingError> {
        config.validate()?;
        if objects.is_empty() {
            return Err(TrackingError::NoObject);
        }
        let tracks = (0..objects.len()).map(Track::new).collect();
        Ok(Self {
            eye: Eye::new(&config)?,
            maker: Maker::default(),
            config,
            objects,
            tracks,
            last: None,
            camera: None,
            budget: Budget::default(),
        })
    }

    /// Follows all objects into a frame, with what others have found in earlier ones.
    pub fn step(&mut self, frame: &Frame<'_>, corrections: &[Correction]) -> Step {
        let Some(gap_s) = self.gap_s(frame) else {
            return Step { estimates: Vec::new(), problem: Some(FrameProblem::OutOfOrder) };
        };
        self.meet_camera(frame);
        let pyramid = Arc::new(Pyramid::new(frame.rgb));
        let dark = pyramid.brightness().1 < DARK_SPREAD;
        let now = &Now { frame: *frame, pyramid: &pyramid, gap_s };
        let predicted: Vec<Pose> = self.tracks.iter().map(|t| self.predict(t, gap_s)).collect();
        let trials = match dark {
            true => self.tracks.iter().zip(&predicted).map(|(t, p)| t.known.then(|| Trial::blind(*p))).collect(),
            false => self.measure(now, &predicted, corrections),
        };
        for i in 0..self.tracks.len() {
            self.settle(i, now, &predicted[i], &trials);
        }
        if !dark {
            self.remember_texture(now);
        }
        self.last = Some((frame.index, frame.stamp_ns));
        self.budget.earn(&self.config);
        Step { estimates: self.estimates(), problem: dark.then_some(FrameProblem::Dark) }
    }

    fn measure(&mut self, now: &Now<'_>, predicted: &[Pose], corrections: &[Correction]) -> Vec<Option<Trial>> {
        let mut trials = self.measure_all(now, predicted, corrections);
        let common = self.common(&trials, predicted, &now.frame);
        self.measure_at_rest(now, &mut trials, common.as_ref());
        trials
    }

    /// Patches belong to the camera that took them.
    fn meet_camera(&mut self, frame: &Frame<'_>) {
        let camera = (frame.rgb.dimensions(), frame.intrinsics);
        if self.camera.is_some_and(|before| before != camera) {
            log::info!("the camera has changed to {camera:?}: textures are learnt anew");
            self.tracks.iter_mut().for_each(|t| t.keyframes.clear());
        }
        self.camera = Some(camera);
    }

    /// Makes a keyframe of the object that needs one most; one a frame, so that no frame takes long.
    fn remember_texture(&mut self, now: &Now<'_>) {
        let TextureConfig { keyframes, keyframe_deg, .. } = self.config.texture;
        let newness = |t: &Track| match t.measured && t.confidence >= self.config.sure_confidence && keyframes > 0 {
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

    /// Time since the last frame; `None` for a frame that is older by a little. After a jump back time begins anew.
    fn gap_s(&mut self, frame: &Frame<'_>) -> Option<f64> {
        let Some((_, stamp_ns)) = self.last else { return Some(self.config.frame_s) };
        let gap_s = (frame.stamp_ns - stamp_ns) as f64 * 1e-9;
        if gap_s.abs() <= self.config.longest_gap_s {
            return (gap_s > 0.0).then_some(gap_s);
        }
        for track in &mut self.tracks {
            track.velocity.slow(0.0);
            if gap_s < 0.0 {
                (track.asked_ns, track.looked_ns, track.seen_ns) = (None, None, frame.stamp_ns);
            }
        }
        Some(gap_s.abs())
    }

    fn predict(&self, track: &Track, gap_s: f64) -> Pose {
        track.velocity.predict(&track.pose, gap_s.min(self.config.longest_gap_s))
    }

    /// Measures every known object, nearer ones first, since they hide those behind.
    fn measure_all(&mut self, now: &Now<'_>, predicted: &[Pose], corrections: &[Correction]) -> Vec<Option<Trial>> {
        let mut poses = predicted.to_vec();
        let mut trials = vec![None; self.tracks.len()];
        for i in self.by_depth(predicted) {
            let own = self.tracks[i].known.then(|| self.follow(i, now, &predicted[i], &poses));
            let trial = self.correct(i, now, own, (predicted, corrections), &poses);
            if let Some(trial) = trial.filter(|t| t.confidence >= self.config.min_confidence) {
                poses[i] = trial.pose;
            }
            trials[i] = trial;
        }
        trials
    }

    fn by_depth(&self, poses: &[Pose]) -> Vec<usize> {
        let mut order: Vec<usize> = (0..poses.len()).collect();
        order.sort_by(|a, b| poses[*a].translation.z.total_cmp(&poses[*b].translation.z));
        order
    }

    fn follow(&mut self, i: usize, now: &Now<'_>, start: &Pose, poses: &[Pose]) -> Trial {
        let keyframes = std::mem::take(&mut self.tracks[i].keyframes);
        let trial = self.follow_with(i, now, start, poses, &keyframes);
        self.tracks[i].keyframes = keyframes;
        trial
    }

    fn follow_contour(&mut self, i: usize, now: &Now<'_>, start: &Pose, poses: &[Pose]) -> Trial {
        self.follow_with(i, now, start, poses, &[])
    }

    fn follow_with(&mut self, i: usize, now: &Now<'_>, start: &Pose, poses: &[Pose], keyframes: &[Keyframe]) -> Trial {
        let mut colours = std::mem::take(&mut self.tracks[i].colours);
        let Self { eye, objects, tracks, .. } = self;
        let hiders = hiders(objects, tracks, i, poses);
        let subject = subject(now, &objects[tracks[i].object], &hiders);
        let trial = match colours.is_empty() {
            true => eye.find(&subject, start),
            false => eye.follow(&subject, start, &mut colours, keyframes),
        };
        self.tracks[i].colours = colours;
        trial
    }

    /// The better of the prediction and of what others have found.
    fn correct(
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
            let sure = best.is_some_and(|b| b.confidence >= self.config.min_confidence);
            if search && sure && self.tracks[i].known {
                continue;
            }
            if !search {
                self.tracks[i].asked_ns = None;
            }
            let start = self.carried(i, correction, predicted, &now.frame.intrinsics);
            let trial = self.try_at(i, now, &start, poses);
            let Some(own) = best.filter(|_| self.tracks[i].known) else {
                best = Some(self.begin(i, now, trial));
                continue;
            };
            if self.near(i, &own.pose, &trial.pose) {
                continue;
            }
            let given_up = self.tracks[i].unseen_s(now.frame.stamp_ns) > self.config.look_timeout_s;
            if search && (trial.confidence > own.confidence || given_up) {
                best = Some(self.begin(i, now, trial));
            } else if !search && self.prefers(&own, &trial, correction) {
                self.jump(i, &trial);
                best = Some(trial);
            }
        }
        best
    }

    /// A pose that others have found, in this frame.
    fn try_at(&mut self, i: usize, now: &Now<'_>, start: &Pose, poses: &[Pose]) -> Trial {
        match self.tracks[i].measured {
            true => self.follow_contour(i, now, start, poses),
            false => {
                let Self { eye, objects, tracks, .. } = self;
                let hiders = hiders(objects, tracks, i, poses);
                eye.find(&subject(now, &objects[tracks[i].object], &hiders), start)
            }
        }
    }

    /// Begins a track anew where a search has found its object.
    fn begin(&mut self, i: usize, now: &Now<'_>, trial: Trial) -> Trial {
        let track = &mut self.tracks[i];
        let phase = track.phase;
        *track = Track::new(track.object);
        (track.phase, track.known, track.pose, track.seen_ns) = (phase, true, trial.pose, now.frame.stamp_ns);
        trial
    }

    /// A track goes on elsewhere: what was remembered moves with it.
    fn jump(&mut self, i: usize, to: &Trial) {
        let track = &mut self.tracks[i];
        track.history.correct(&(track.pose.inverse() * to.pose));
        track.velocity.slow(0.0);
        track.colours = Default::default();
        track.keyframes.clear();
        track.jumped = true;
    }

    /// How what is at rest moved since some frames ago.
    fn common(&self, trials: &[Option<Trial>], predicted: &[Pose], frame: &Frame<'_>) -> Option<(Common, Vec<usize>)> {
        let (last, _) = self.last?;
        let now = poses_of(trials, predicted);
        let sure = |i: usize| trials[i].is_some_and(|t| t.confidence >= self.config.sure_confidence);
        let bodies = self.bodies(last.saturating_sub(BASELINE - 1), &now, |i| sure(i) && !self.tracks[i].jumped);
        let places: Vec<usize> = (0..bodies.len()).filter(|i| bodies[*i].is_some()).collect();
        let bodies: Vec<_> = bodies.into_iter().flatten().collect();
        Some((common_motion(&bodies, &frame.intrinsics)?, places))
    }

    /// Counts who is at rest, and looks for what is not sure where those at rest say that it is.
    fn measure_at_rest(&mut self, now: &Now<'_>, trials: &mut [Option<Trial>], common: Option<&(Common, Vec<usize>)>) {
        let Some((common, places)) = common else { return };
        for (member, i) in common.members.iter().zip(places) {
            self.tracks[*i].at_rest = if *member { self.tracks[*i].at_rest + 1 } else { 0 };
        }
        let poses: Vec<Pose> = poses_of(trials, &self.tracks.iter().map(|t| t.pose).collect::<Vec<_>>());
        let sure: Vec<bool> =
            (0..poses.len()).map(|i| common.members.iter().zip(places).any(|(m, p)| *p == i && *m)).collect();
        for i in 0..self.tracks.len() {
            let unsure = trials[i].is_some_and(|t| t.confidence < self.config.sure_confidence);
            self.tracks[i].resting = None;
            if !(unsure && self.tracks[i].at_rest >= REST_FRAMES) {
                continue;
            }
            let Some(there) = self.resting_pose(i, &poses, &sure, &now.frame.intrinsics) else { continue };
            self.tracks[i].resting = Some(there);
            let trial = self.follow(i, now, &there, &poses);
            if trials[i].is_none_or(|own| trial.confidence >= own.confidence - REST_BONUS) {
                trials[i] = Some(trial);
            }
        }
    }

    /// Where an object must be if it has not been moved since it was last seen.
    fn resting_pose(&self, i: usize, now: &[Pose], sure: &[bool], camera: &Intrinsics) -> Option<Pose> {
        let seen = self.tracks[i].history.last_measured()?;
        let bodies: Vec<_> = self
            .bodies(seen.frame, now, |j| j != i && sure[j] && self.tracks[j].at_rest >= REST_FRAMES)
            .into_iter()
            .flatten()
            .collect();
        Some(common_motion(&bodies, camera)?.motion * seen.pose)
    }

    /// Takes a measured pose over, or holds the object where it is believed to be.
    fn settle(&mut self, i: usize, now: &Now<'_>, predicted: &Pose, trials: &[Option<Trial>]) {
        let Some(trial) = trials[i].filter(|_| self.tracks[i].known) else { return };
        let believed = trial.confidence >= self.config.min_confidence;
        self.tracks[i].evidence = trial.evidence;
        match believed {
            true => self.take(i, now, &trial, trials),
            false => self.hold(i, now, predicted),
        }
        let track = &mut self.tracks[i];
        track.confidence = trial.confidence;
        track.history.push(Moment { frame: now.frame.index, pose: track.pose, measured: track.measured });
        track.jumped = false;
    }

    fn take(&mut self, i: usize, now: &Now<'_>, trial: &Trial, trials: &[Option<Trial>]) {
        let sure = trial.confidence >= self.config.sure_confidence;
        let track = &mut self.tracks[i];
        if track.measured && !track.jumped && track.good > 0 {
            track.velocity.learn(&track.pose, &trial.pose, now.gap_s, self.config.velocity_gain);
        }
        (track.pose, track.measured, track.seen_ns) = (trial.pose, true, now.frame.stamp_ns);
        (track.good, track.bad) = (track.good + 1, 0);
        track.covariance = inverse(&trial.information) * self.config.covariance_scale;
        if track.phase == Phase::Tracking || track.good >= CONFIRM_FRAMES {
            track.phase = Phase::Tracking;
        }
        if sure || track.colours.is_empty() {
            let poses = poses_of(trials, &self.tracks.iter().map(|t| t.pose).collect::<Vec<_>>());
            let mut colours = std::mem::take(&mut self.tracks[i].colours);
            let Self { eye, objects, tracks, config, .. } = self;
            let hiders = hiders(objects, tracks, i, &poses);
            let subject = subject(now, &objects[tracks[i].object], &hiders);
            eye.learn(&subject, &trial.pose, &mut colours, config.renewal);
            self.tracks[i].colours = colours;
        }
    }

    fn hold(&mut self, i: usize, now: &Now<'_>, predicted: &Pose) {
        let gap_s = now.gap_s;
        let (hold_s, frame_s) = (self.config.hold_s, self.config.frame_s);
        let diameter_m = self.objects[self.tracks[i].object].diameter_m;
        let track = &mut self.tracks[i];
        track.pose = track.resting.unwrap_or(*predicted);
        (track.measured, track.good, track.bad) = (false, 0, track.bad + 1);
        track.velocity.slow(SLOWING.powf(gap_s / frame_s));
        track.covariance += spread_per_s(diameter_m) * gap_s;
        let hold_s = if track.resting.is_some() { hold_s * REST_PATIENCE } else { hold_s };
        if track.phase == Phase::Tracking && track.unseen_s(now.frame.stamp_ns) > hold_s {
            track.phase = Phase::Lost;
        }
    }

    /// The looks that are wanted of a network at the last frame; they count as asked for.
    pub fn ask(&mut self) -> Vec<Look> {
        let Some((_, now_ns)) = self.last else { return Vec::new() };
        let wanted = self.budget.spend(looks::wanted(&self.tracks, now_ns, &self.config), &self.config);
        let ask = |i: usize| {
            let track = &mut self.tracks[i];
            (track.asked_ns, track.looked_ns) = (Some(now_ns), Some(now_ns));
            Look { object_id: self.objects[track.object].id, camera_from_object: track.pose }
        };
        wanted.into_iter().map(ask).collect()
    }

    /// Every object that was ever found.
    fn estimates(&self) -> Vec<Estimate> {
        let of = |t: &Track| Estimate {
            object_id: self.objects[t.object].id,
            camera_from_object: t.pose,
            measured: t.measured,
            confidence: t.confidence,
            covariance: std::array::from_fn(|k| t.covariance[(k / 6, k % 6)]),
            phase: t.phase,
            good_frames: t.good,
            bad_frames: t.bad,
            evidence: t.evidence,
        };
        self.tracks.iter().filter(|t| t.known).map(of).collect()
    }

    /// Ids of the objects that should be searched for: never found, or lost.
    #[must_use]
    pub fn missing(&self) -> Vec<u32> {
        let gone = |t: &&Track| t.phase != Phase::Tracking;
        self.tracks.iter().filter(gone).map(|t| self.objects[t.object].id).collect()
    }
}

/// A picture whose brightness has a smaller standard deviation shows nothing, grey levels.
const DARK_SPREAD: f32 = 2.0;
/// Frames over which rest is judged, and for how many it must last.
const BASELINE: u64 = 6;
const REST_FRAMES: u32 = 5;
/// How much less sure a pose may be that those at rest speak for.
const REST_BONUS: f64 = 0.1;
/// How much longer than others an object is held that others say is still there.
const REST_PATIENCE: f64 = 10.0;
/// Frames in a row that make what was found a track without a look of the network.
const CONFIRM_FRAMES: u32 = 5;
/// Share of the velocity that is left after a frame that did not show the object.
const SLOWING: f64 = 0.85;

/// How fast the place of an object becomes unknown that is not seen: a tenth of the diameter and 10 degrees in a second.
fn spread_per_s(diameter_m: f64) -> Matrix6<f64> {
    let (m2, rad2) = ((0.1 * diameter_m).powi(2), 10_f64.to_radians().powi(2));
    Matrix6::from_diagonal(&nalgebra::Vector6::new(m2, m2, m2, rad2, rad2, rad2))
}

fn inverse(information: &Matrix6<f64>) -> Matrix6<f64> {
    information.cholesky().map_or_else(Matrix6::identity, |c| c.inverse())
}

fn poses_of(trials: &[Option<Trial>], otherwise: &[Pose]) -> Vec<Pose> {
    trials.iter().zip(otherwise).map(|(t, p)| t.map_or(*p, |t| t.pose)).collect()
}

/// The other objects that may hide one.
fn hiders<'a>(objects: &'a [KnownObject], tracks: &[Track], i: usize, poses: &[Pose]) -> Vec<Hider<'a>> {
    let others = (0..tracks.len()).filter(|j| *j != i && tracks[*j].known && tracks[*j].phase == Phase::Tracking);
    others.map(|j| Hider { model: &objects[tracks[j].object].contour, camera_from_object: poses[j] }).collect()
}

fn subject<'a>(now: &Now<'a>, object: &'a KnownObject, hiders: &'a [Hider<'a>]) -> Subject<'a> {
    let image = Image { rgb: now.frame.rgb, intrinsics: now.frame.intrinsics };
    Subject { image, object, hiders, pyramid: now.pyramid, gap_s: now.gap_s }
}
