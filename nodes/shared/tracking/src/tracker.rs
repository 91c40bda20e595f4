use crate::TrackingConfig;
use crate::at_rest::BASELINE;
use crate::error::TrackingError;
use crate::evidence::with_look;
use crate::looks::{self, Budget, Look};
use crate::measure::{Measurer, Trial};
use crate::side_by_side::Tools;
use crate::texture::Pyramid;
use crate::track::{Phase, Track};
use crate::types::{Correction, Estimate, Frame, FrameProblem, KnownObject, Step};
use pseudoflow_geometry::{Intrinsics, Pose};
use std::collections::VecDeque;
use std::sync::Arc;

/// A frame with what is made of it once for all objects.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Now<'a> {
    pub(crate) frame: Frame<'a>,
    pub(crate) pyramid: &'a Arc<Pyramid>,
    pub(crate) gap_s: f64,
    /// Whether frames before it were dropped: whoever follows is late, and has no time for more than must be.
    pub(crate) late: bool,
}

/// Follows objects from frame to frame.
#[derive(Debug)]
pub struct Tracker {
    pub(crate) config: Arc<TrackingConfig>,
    pub(crate) objects: Arc<[KnownObject]>,
    pub(crate) tracks: Vec<Track>,
    pub(crate) tools: Tools,
    /// For those who work side by side.
    pub(crate) spare: Vec<Tools>,
    pub(crate) last: Option<(u64, i64)>,
    /// The last frames, as many as rest is judged over.
    pub(crate) recent: VecDeque<u64>,
    pub(crate) camera: Option<((u32, u32), Intrinsics)>,
    pub(crate) budget: Budget,
    /// Whether looks are answered: what was found then counts from the first that says that it is right.
    pub(crate) looks_come: bool,
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
            tools: Tools::new(Measurer::new(&config)?),
            spare: Vec::new(),
            config: Arc::new(config),
            objects: objects.into(),
            tracks,
            last: None,
            recent: VecDeque::new(),
            camera: None,
            budget: Budget::default(),
            looks_come: false,
        })
    }

    /// Follows all objects into a frame, with what others have found in earlier ones.
    pub fn step(&mut self, frame: &Frame<'_>, corrections: &[Correction]) -> Step {
        let Some(gap_s) = self.gap_s(frame) else {
            return Step { estimates: Vec::new(), problem: Some(FrameProblem::OutOfOrder) };
        };
        self.meet_camera(frame);
        self.tracks.iter_mut().for_each(|t| t.resting = None);
        let pyramid = Arc::new(Pyramid::new(frame.rgb));
        let dark = pyramid.brightness().1 < DARK_SPREAD;
        let late = self.last.is_some_and(|(index, _)| frame.index > index + 1);
        let now = &Now { frame: *frame, pyramid: &pyramid, gap_s, late };
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
        self.recent.push_back(frame.index);
        if self.recent.len() > BASELINE {
            self.recent.pop_front();
        }
        self.budget.earn(&self.config);
        Step { estimates: self.estimates(), problem: dark.then_some(FrameProblem::Dark) }
    }

    fn measure(&mut self, now: &Now<'_>, predicted: &[Pose], corrections: &[Correction]) -> Vec<Option<Trial>> {
        let mut trials = self.measure_all(now, predicted, corrections);
        let common = self.common(&trials, predicted, &now.frame);
        self.measure_at_rest(now, &mut trials, common.as_ref());
        self.compare_some(now, &mut trials, predicted);
        for (track, trial) in self.tracks.iter().zip(&mut trials) {
            if let Some(trial) = trial.as_mut().filter(|t| t.evidence.lines > 0.0) {
                *trial = trial.with_likeness(track.likeness);
            }
        }
        trials
    }

    /// Whether objects have moved further since the last frame than between those of a camera.
    pub(crate) fn after_long_gap(&self, now: &Now<'_>) -> bool {
        is_long_gap(now.gap_s, self.config.frame_s)
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
                track.sure_ns = frame.stamp_ns;
            }
        }
        Some(gap_s.abs())
    }

    fn predict(&self, track: &Track, gap_s: f64) -> Pose {
        track.velocity.predict(&track.pose, gap_s.min(self.config.longest_gap_s))
    }

    /// Says that the looks that are asked for will be answered. What was found is then followed, but no track, until a look has said
    /// that its pose is right.
    pub fn expect_looks(&mut self) {
        self.looks_come = true;
    }

    /// The looks that are wanted of a network at the last frame; they count as asked for. An object that was just found may come
    /// several times, at each pose that it was found at: the answer is the best of them.
    pub fn ask(&mut self) -> Vec<Look> {
        let Some((frame, now_ns)) = self.last else { return Vec::new() };
        let wanted = self.budget.spend(looks::wanted(&self.tracks, now_ns, &self.config), &self.config);
        let ask = |i: usize| {
            let poses = self.starts_of_look(i);
            let track = &mut self.tracks[i];
            (track.asked_ns, track.looked_ns) = (Some(now_ns), Some(now_ns));
            let object_id = self.objects[track.object].id;
            poses.into_iter().map(move |camera_from_object| Look { object_id, camera_from_object }).collect::<Vec<_>>()
        };
        let looks: Vec<Look> = wanted.into_iter().flat_map(ask).collect();
        if !looks.is_empty() {
            log::debug!("frame {frame}: asks for looks at {:?}", looks.iter().map(|l| l.object_id).collect::<Vec<_>>());
        }
        looks
    }

    /// Every object that was ever found.
    fn estimates(&self) -> Vec<Estimate> {
        let of = |t: &Track| Estimate {
            object_id: self.objects[t.object].id,
            camera_from_object: t.pose,
            measured: t.measured,
            confidence: t.look_score.map_or(t.confidence, |score| with_look(t.confidence, score)),
            covariance: std::array::from_fn(|k| t.covariance[(k / 6, k % 6)]),
            phase: t.phase,
            good_frames: t.good,
            bad_frames: t.bad,
            evidence: t.evidence,
        };
        self.tracks.iter().filter(|t| t.known).map(of).collect()
    }

    /// Ids of the objects that should be searched for: never found, or lost. What was found and waits for a look is not: searched for
    /// again, it would keep the network from the others.
    #[must_use]
    pub fn missing(&self) -> Vec<u32> {
        let gone = |t: &&Track| t.phase != Phase::Tracking && !(self.looks_come && self.awaits_look(t));
        self.tracks.iter().filter(gone).map(|t| self.objects[t.object].id).collect()
    }
}

/// Gaps of more frames than this are long.
const LONG_FRAMES: f64 = 3.0;

/// Whether a gap between frames is long for a camera with `frame_s` between them.
pub(crate) fn is_long_gap(gap_s: f64, frame_s: f64) -> bool {
    gap_s > LONG_FRAMES * frame_s
}

/// A picture whose brightness has a smaller standard deviation shows nothing, grey levels.
const DARK_SPREAD: f32 = 2.0;
