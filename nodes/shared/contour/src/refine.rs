//! Coarse to fine: correspondences on lines, then a Gauss-Newton step of lines, prior and whatever else knows of the pose.

use crate::config::RegionConfig;
use crate::hiders::{Hider, Hiders};
use crate::histogram::{Histograms, NOWHERE};
use crate::lines::{Line, Reading, measure, measure_edges, project};
use crate::model::ContourModel;
use crate::picture::{Image, Picture};
use crate::prior::{Prior, retract};
use crate::{ContourError, RegionStatus};
use nalgebra::{Matrix6, Vector6};
use pseudoflow_geometry::Pose;

/// A further term of the cost, with the tangent of [`retract`].
pub trait Term {
    /// Adds its Gauss-Newton Hessian and gradient at a pose.
    fn accumulate(&mut self, pose: &Pose, hessian: &mut Matrix6<f64>, gradient: &mut Vector6<f64>);

    /// Its share of the negative log posterior.
    fn cost(&mut self, pose: &Pose) -> f64;
}

/// What there is to refine.
#[derive(Debug, Clone, Copy)]
pub struct Task<'a> {
    /// The picture.
    pub image: Image<'a>,
    /// The object's contour.
    pub model: &'a ContourModel,
    /// What is known before.
    pub prior: &'a Prior,
    /// The other objects of the frame.
    pub hiders: &'a [Hider<'a>],
}

/// What was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Region {
    /// The pose of the least cost that the steps came to; where they began when the status says that nothing is known.
    pub camera_from_object: Pose,
    /// Hessian of all terms at the pose, tangent of [`retract`]: the inverse of a covariance.
    pub information: Matrix6<f64>,
    /// Negative log posterior of lines, prior and further term, up to a constant: lower is better, for one task.
    pub cost: f64,
    /// How well the lines agree with the pose, 0..1: mean probability of the contour being where the pose puts it, in units
    /// of the most a line can say.
    pub agreement: f64,
    /// How much of the colours of both sides is the same, 0..1.
    pub overlap: f32,
    /// Lines that were read at the end.
    pub lines: usize,
    /// Whether the contour says anything.
    pub status: RegionStatus,
}

/// Refines poses by their contours. Holds its working memory.
#[derive(Debug, Clone)]
pub struct Refiner {
    pub(crate) config: RegionConfig,
    pub(crate) picture: Picture,
    pub(crate) histograms: Histograms,
    /// The colours are those of earlier frames: they are not counted anew at each step.
    pub(crate) kept: bool,
    pub(crate) log_odds: Vec<f32>,
    pub(crate) lines: Vec<Line>,
    hiders: Hiders,
}

/// How lines become a step.
struct Weighing {
    tukey_px: f64,
    sigma_px: f64,
    lines_per_error: f64,
}

/// Share of lines that may say nothing or the wrong, in the likelihood that compares poses.
const STRAY: f64 = 0.1;
/// Places of the contour on a line.
const PLACES: f64 = crate::lines::OFFSETS as f64;

impl Refiner {
    /// A refiner with these settings.
    ///
    /// # Errors
    /// [`ContourError::Setting`].
    pub fn new(config: RegionConfig) -> Result<Self, ContourError> {
        config.validate()?;
        Ok(Self {
            config,
            picture: Picture::default(),
            histograms: Histograms::new(),
            kept: false,
            log_odds: Vec::new(),
            lines: Vec::new(),
            hiders: Hiders::default(),
        })
    }

    /// What is known of an object at a rough pose.
    #[must_use]
    pub fn prior(&self, rough: &Pose, model: &ContourModel, diameter_m: f64) -> Prior {
        Prior::new(&self.config.prior, rough, model, diameter_m)
    }

    /// The pose of least cost by contour and prior, and by `term` if there is one, that steps from any of `starts` come to;
    /// a start whose contour says something goes before one whose contour does not.
    ///
    /// # Panics
    /// When there is no start.
    pub fn refine(&mut self, task: &Task<'_>, starts: &[Pose], mut term: Option<&mut dyn Term>) -> Region {
        let seen = self.open(task);
        let mut best: Option<Region> = None;
        for start in starts {
            let found = match seen {
                RegionStatus::Ok => self.descend(task, start, &mut term),
                unseen => self.without_contour(task, start, unseen, &mut term),
            };
            let better = |b: &Region| (!found.status.is_ok(), found.cost) < (!b.status.is_ok(), b.cost);
            if best.as_ref().is_none_or(better) {
                best = Some(found);
            }
        }
        best.expect("at least one start")
    }

    /// Makes the picture around the rough pose.
    pub(crate) fn open(&mut self, task: &Task<'_>) -> RegionStatus {
        let rough = &task.prior.camera_from_object;
        if !is_finite(rough) {
            return RegionStatus::NotFinite;
        }
        let (model, c) = (task.model, &self.config);
        let around = (&model.centre_m(), model.radius_m());
        if self.picture.fill(&task.image, rough, around, c.object_px, c.margin).is_none() {
            return RegionStatus::NotInView;
        }
        self.hiders.fill(task.hiders, model, rough, &self.picture);
        RegionStatus::Ok
    }

    pub(crate) fn descend(&mut self, task: &Task<'_>, start: &Pose, term: &mut Option<&mut dyn Term>) -> Region {
        let status = self.begin(task.model, start);
        if status != RegionStatus::Ok {
            return self.without_contour(task, start, status, term);
        }
        let mut pose = *start;
        for i in 0..self.config.scales_px.len() {
            let scale_px = self.config.scales_px[i];
            for _ in 0..if i == 0 { 1 } else { self.config.iterations } {
                self.look(task.model, &pose, scale_px as f32);
                let c = &self.config;
                let weighing = Weighing {
                    tukey_px: c.tukey_segments * scale_px,
                    sigma_px: c.sigma_px,
                    lines_per_error: c.lines_per_error,
                };
                pose = self.step(&pose, task.prior, term, &weighing).0;
            }
        }
        let mut information = Matrix6::zeros();
        for _ in 0..self.config.edges {
            self.place_lines(task.model, &pose);
            measure_edges(&mut self.lines, &self.picture, self.config.edge_noise);
            let c = &self.config;
            let image_px = 1.0 / f64::from(self.picture.independence);
            let weighing = Weighing {
                tukey_px: c.edge_tukey_px * image_px,
                sigma_px: c.edge_sigma_px * image_px,
                lines_per_error: c.edges_per_error,
            };
            (pose, information) = self.step(&pose, task.prior, term, &weighing);
        }
        self.judge(task, &pose, information, start, term)
    }

    /// Looks whether there is a contour to speak of.
    pub(crate) fn begin(&mut self, model: &ContourModel, start: &Pose) -> RegionStatus {
        if !is_finite(start) {
            return RegionStatus::NotFinite;
        }
        if !self.kept {
            self.histograms.clear();
        }
        self.place_lines(model, start);
        let used = self.used();
        if used < self.config.min_lines {
            return RegionStatus::NoContour { lines: used };
        }
        if self.kept {
            self.histograms.log_odds(&self.picture.bins, &mut self.log_odds);
            return RegionStatus::Ok;
        }
        self.count_colours();
        match self.histograms.renew(1.0) && self.histograms.overlap() <= self.config.max_overlap {
            true => RegionStatus::Ok,
            false => RegionStatus::OneColour { overlap: self.histograms.overlap() },
        }
    }

    pub(crate) fn used(&self) -> usize {
        self.lines.iter().filter(|l| l.weight > 0.0).count()
    }

    pub(crate) fn place_lines(&mut self, model: &ContourModel, pose: &Pose) {
        project(model.view(pose), pose, &self.picture, false, &mut self.lines);
        self.hiders.apply(&mut self.lines);
    }

    fn look(&mut self, model: &ContourModel, pose: &Pose, scale_px: f32) {
        self.place_lines(model, pose);
        if !self.kept {
            self.count_colours();
            // Where one side has no pixel any more, the colours of before stand.
            self.histograms.renew(self.config.renewal);
            self.histograms.log_odds(&self.picture.bins, &mut self.log_odds);
        }
        self.read(scale_px);
    }

    /// Finds the contour on the lines that are placed.
    fn read(&mut self, scale_px: f32) {
        let reading = Reading {
            scale_px,
            amplitude: self.config.amplitude,
            shortest: self.config.shortest,
            evidence: self.picture.independence,
        };
        measure(&mut self.lines, &self.log_odds, self.picture.size_px, &reading);
    }

    /// One Gauss-Newton step, and the Hessian that it was made with.
    fn step(
        &self,
        pose: &Pose,
        prior: &Prior,
        term: &mut Option<&mut dyn Term>,
        weighing: &Weighing,
    ) -> (Pose, Matrix6<f64>) {
        let image_px = 1.0 / f64::from(self.picture.independence).max(1e-3);
        let (mut hessian, mut gradient) = line_equations(&self.lines, weighing, self.config.common_px * image_px);
        prior.accumulate(pose, &mut hessian, &mut gradient);
        if let Some(term) = term {
            term.accumulate(pose, &mut hessian, &mut gradient);
        }
        // The prior makes it positive definite, unless a number is not finite.
        let step = hessian.cholesky().map(|c| -c.solve(&gradient)).filter(|s| s.iter().all(|v| v.is_finite()));
        (step.map_or(*pose, |s| retract(pose, &s)), hessian)
    }

    pub(crate) fn judge(
        &mut self,
        task: &Task<'_>,
        pose: &Pose,
        information: Matrix6<f64>,
        start: &Pose,
        term: &mut Option<&mut dyn Term>,
    ) -> Region {
        let last = self.config.scales_px.last().copied().unwrap_or(1.0);
        if self.kept {
            self.place_lines(task.model, pose);
            self.count_colours_for(pose);
            self.read(last as f32);
        } else {
            self.look(task.model, pose, last as f32);
        }
        let (used, overlap) = (self.used(), self.histograms.overlap());
        let status = match used < self.config.min_lines {
            true => RegionStatus::NoContour { lines: used },
            false if overlap > self.config.max_overlap => RegionStatus::OneColour { overlap },
            false => RegionStatus::Ok,
        };
        if status != RegionStatus::Ok {
            return self.without_contour(task, start, status, term);
        }
        let here = || self.lines.iter().filter(|l| l.weight > 0.0).map(|l| f64::from(l.here));
        // Relative to lines that know nothing, so that poses with more lines to be read do not pay for them.
        let lines: f64 = here().map(|h| -((1.0 - STRAY) * PLACES * h + STRAY).ln()).sum();
        let beyond = term.as_mut().map_or(0.0, |t| t.cost(pose));
        Region {
            camera_from_object: *pose,
            information,
            cost: lines / self.config.lines_per_error + task.prior.cost(pose) + beyond,
            agreement: (2.0 * here().sum::<f64>() / used as f64).min(1.0),
            overlap,
            lines: used,
            status,
        }
    }

    /// What prior and further term say by themselves.
    pub(crate) fn without_contour(
        &mut self,
        task: &Task<'_>,
        start: &Pose,
        status: RegionStatus,
        term: &mut Option<&mut dyn Term>,
    ) -> Region {
        self.lines.clear();
        let weighing = Weighing { tukey_px: 1.0, sigma_px: 1.0, lines_per_error: 1.0 };
        let (mut pose, mut information) = (*start, Matrix6::zeros());
        if term.is_some() && status != RegionStatus::NotFinite {
            for _ in 0..STEPS_WITHOUT_CONTOUR {
                (pose, information) = self.step(&pose, task.prior, term, &weighing);
            }
        } else {
            task.prior.accumulate(&pose, &mut information, &mut Vector6::zeros());
        }
        let cost = task.prior.cost(&pose) + term.as_mut().map_or(0.0, |t| t.cost(&pose));
        Region { camera_from_object: pose, information, cost, agreement: 0.0, overlap: 1.0, lines: 0, status }
    }

    /// Counts the colours of the lines that are placed, for [`Refiner::learn`]. False when too little of the contour is seen.
    pub(crate) fn count_colours_for(&mut self, pose: &Pose) -> bool {
        let enough = self.used() >= self.config.min_lines;
        if enough {
            self.count_colours();
            self.histograms.counted_at = Some(*pose);
        }
        enough
    }

    pub(crate) fn count_colours(&mut self) {
        let (from, to) = (self.config.colours_from_px, self.config.colours_to_px);
        self.histograms.begin();
        let steps = |reach: f32| (reach.min(to) - from).max(0.0) as usize;
        for line in self.lines.iter().filter(|l| l.weight > 0.0) {
            let bin = |r: f32| self.picture.bin(line.at[0] + r * line.normal[0], line.at[1] + r * line.normal[1]);
            for s in 0..steps(line.inside_px) {
                self.histograms.count_inside(bin(-from - s as f32 - 0.5).unwrap_or(NOWHERE));
            }
            for s in 0..steps(line.outside_px) {
                self.histograms.count_outside(bin(from + s as f32 + 0.5).unwrap_or(NOWHERE));
            }
        }
    }
}

fn is_finite(pose: &Pose) -> bool {
    pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|v| v.is_finite())
}

/// Steps of Gauss-Newton where only prior and further term are there.
const STEPS_WITHOUT_CONTOUR: usize = 10;

/// Hessian and gradient of the lines, each with its variance under Tukey's loss. An offset that all lines share, of standard
/// deviation `common_px`, is eliminated (Schur complement): without it many lines would claim to know the scale, and with it
/// the depth, far better than blur and mesh allow.
fn line_equations(lines: &[Line], weighing: &Weighing, common_px: f64) -> (Matrix6<f64>, Vector6<f64>) {
    let (mut hessian, mut gradient) = (Matrix6::zeros(), Vector6::zeros());
    let (mut cross, mut own, mut pull) = (Vector6::zeros(), 1.0 / (common_px * common_px), 0.0);
    for line in lines.iter().filter(|l| l.weight > 0.0) {
        let r = -f64::from(line.mean_px);
        let s = (1.0 - (r / weighing.tukey_px).powi(2)).max(0.0);
        let variance = f64::from(line.variance_px2) + weighing.sigma_px.powi(2);
        let w = f64::from(line.weight) * s * s / (variance * weighing.lines_per_error);
        let j = Vector6::from_fn(|i, _| f64::from(line.jacobian[i]));
        hessian += w * j * j.transpose();
        gradient += w * r * j;
        cross += w * j;
        own += w;
        pull += w * r;
    }
    hessian -= cross * cross.transpose() / own;
    gradient -= cross * (pull / own);
    (hessian, gradient)
}
