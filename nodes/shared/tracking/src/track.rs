//! What is known of one object.

use crate::compare::Retries;
use crate::evidence::Evidence;
use crate::history::{History, Sighting, Velocity};
use crate::texture::{Keyframe, Likeness};
use nalgebra::Matrix6;
use pseudoflow_contour::Colours;
use pseudoflow_geometry::Pose;

/// Where the tracking of an object stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Nothing was ever found, or not confirmed.
    Searching,
    /// It is followed, or has been hidden for a short while.
    Tracking,
    /// It has not been seen for too long.
    Lost,
}

/// One object over time.
#[derive(Debug, Clone)]
pub(crate) struct Track {
    /// Index into the tracker's objects.
    pub(crate) object: usize,
    pub(crate) phase: Phase,
    /// Where it is, or is believed to be; meaningless while nothing was ever found.
    pub(crate) pose: Pose,
    pub(crate) known: bool,
    /// Whether the last frame's pose was measured.
    pub(crate) measured: bool,
    /// Whether colours and texture may be learnt from the last frame.
    pub(crate) learnt: bool,
    /// When its confidence was last enough.
    pub(crate) sure_ns: i64,
    pub(crate) confidence: f64,
    pub(crate) covariance: Matrix6<f64>,
    pub(crate) velocity: Velocity,
    pub(crate) colours: Colours,
    pub(crate) keyframes: Vec<Keyframe>,
    /// Whether its mesh was just found to look as the picture does: a frame to remember.
    pub(crate) texture_due: bool,
    /// No keyframe is tried before this frame.
    pub(crate) texture_from: u64,
    pub(crate) history: History,
    /// When it was last measured, and how often in a row.
    pub(crate) seen_ns: i64,
    pub(crate) good: u32,
    pub(crate) bad: u32,
    /// Frames in a row in which it moved as the scene at rest does.
    pub(crate) at_rest: u32,
    /// How alike its rendering and the picture were when they were compared last, and the frame after that.
    pub(crate) likeness: Option<Likeness>,
    pub(crate) compared_at: u64,
    /// When a rendering of it is tried again.
    pub(crate) anchoring: Retries,
    /// When half turns are tried again, and how many were.
    pub(crate) turning: Retries,
    pub(crate) turns: usize,
    /// Where those at rest say that it is, when this frame does not show it surely.
    pub(crate) resting: Option<Pose>,
    /// Where it was found: to be looked at once, with its own pose.
    pub(crate) candidates: Vec<Sighting>,
    /// Whether a look has said that its pose is right.
    pub(crate) verified: bool,
    /// What the last look that came said of it: the probability that the look's pose is right.
    pub(crate) look_score: Option<f64>,
    /// Whether the last look that came was of another pose, taken or not.
    pub(crate) disputed: bool,
    /// Looks in a row that spoke against it.
    pub(crate) doubts: u32,
    /// When a look was asked for that has not come back.
    pub(crate) asked_ns: Option<i64>,
    /// When a look was last asked for.
    pub(crate) looked_ns: Option<i64>,
    /// What the last frame's picture said.
    pub(crate) evidence: Evidence,
}

impl Track {
    pub(crate) fn new(object: usize) -> Self {
        Self {
            object,
            phase: Phase::Searching,
            pose: Pose::identity(),
            known: false,
            measured: false,
            learnt: false,
            sure_ns: 0,
            confidence: 0.0,
            covariance: Matrix6::zeros(),
            velocity: Velocity::default(),
            colours: Colours::default(),
            keyframes: Vec::new(),
            texture_due: false,
            texture_from: 0,
            history: History::default(),
            seen_ns: 0,
            good: 0,
            bad: 0,
            at_rest: 0,
            likeness: None,
            compared_at: 0,
            anchoring: Retries::default(),
            turning: Retries::default(),
            turns: 0,
            resting: None,
            candidates: Vec::new(),
            verified: false,
            look_score: None,
            disputed: false,
            doubts: 0,
            asked_ns: None,
            looked_ns: None,
            evidence: Evidence::default(),
        }
    }

    /// What other objects' work may ask of this one: all but what it looks like.
    pub(crate) fn seen_from_outside(&mut self) -> Self {
        let (colours, keyframes) = (std::mem::take(&mut self.colours), std::mem::take(&mut self.keyframes));
        let copy = self.clone();
        (self.colours, self.keyframes) = (colours, keyframes);
        copy
    }

    /// The phase of an object that turns out not to be where it was followed.
    pub(crate) fn gone(&self) -> Phase {
        if self.phase == Phase::Searching { Phase::Searching } else { Phase::Lost }
    }

    /// Seconds since it was last measured.
    pub(crate) fn unseen_s(&self, now_ns: i64) -> f64 {
        (now_ns - self.seen_ns) as f64 * 1e-9
    }
}
