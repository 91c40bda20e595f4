//! Coarse to fine: correspondences on lines, then a Gauss-Newton step of lines and prior together.

use crate::hiders::{Hider, Hiders};
use crate::histogram::Histograms;
use crate::lines::{Line, Reading, SmoothStep, measure, measure_edges, project};
use crate::model::ContourModel;
use crate::picture::{Image, Picture};
use crate::prior::{Prior, retract};
use nalgebra::{Matrix6, Vector6};
use pseudoflow_geometry::Pose;

/// Settings of the region stage.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RegionConfig {
    pub object_px: f64,
    pub margin: f64,
    pub scales_px: Vec<f64>,
    pub iterations: usize,
    pub amplitude: f32,
    pub slope: f32,
    pub shortest: f32,
    pub colours_from_px: f32,
    pub colours_to_px: f32,
    pub renewal: f32,
    /// Lines that share one error.
    pub lines_per_error: f64,
    pub tukey_px: f64,
    pub sigma_px: f64,
    pub prior_rotation_deg: f64,
    pub prior_xy: f64,
    pub prior_z: f64,
    pub prior_freedom: f64,
    pub evidence: f32,
    pub shift_px: f32,
    pub edges: usize,
    pub edge_noise: f32,
    pub edge_lines_per_error: f64,
    pub edge_tukey: f64,
    pub edge_sigma: f64,
    pub common_px: f64,
}

impl Default for RegionConfig {
    fn default() -> Self {
        Self {
            object_px: 127.0,
            margin: 1.5,
            scales_px: vec![8.0, 5.0, 3.0, 2.0, 1.0],
            iterations: 2,
            amplitude: 0.36,
            slope: 0.0,
            shortest: 3.0,
            colours_from_px: 0.5,
            colours_to_px: 20.0,
            renewal: 0.8,
            lines_per_error: 8.0,
            tukey_px: 4.0,
            sigma_px: 0.5,
            prior_rotation_deg: 9.5,
            prior_xy: 0.035,
            prior_z: 0.14,
            prior_freedom: 8.0,
            evidence: 1.0,
            shift_px: 0.0,
            edges: 3,
            edge_noise: 8.0,
            edge_lines_per_error: 8.0,
            edge_tukey: 2.0,
            edge_sigma: 0.5,
            common_px: 0.3,
        }
    }
}

/// A further term of the cost, with the tangent of [`retract`].
pub trait Term {
    /// Adds its Gauss-Newton Hessian and gradient at a pose.
    fn accumulate(&mut self, pose: &Pose, hessian: &mut Matrix6<f64>, gradient: &mut Vector6<f64>);
    /// Its share of the negative log posterior.
    fn cost(&mut self, pose: &Pose) -> f64;
}

/// No further term.
pub struct Nothing;

impl Term for Nothing {
    fn accumulate(&mut self, _: &Pose, _: &mut Matrix6<f64>, _: &mut Vector6<f64>) {}
    fn cost(&mut self, _: &Pose) -> f64 {
        0.0
    }
}

/// Refines poses; holds its working memory.
#[derive(Debug, Clone)]
pub struct Refiner {
    config: RegionConfig,
    picture: Picture,
    histograms: Histograms,
    log_odds: Vec<f32>,
    lines: Vec<Line>,
    hiders: Hiders,
}

/// What came out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Region {
    pub camera_from_object: Pose,
    pub score: f64,
    pub cost: f64,
    pub overlap: f32,
}

impl Refiner {
    #[must_use]
    pub fn new(config: RegionConfig) -> Self {
        Self {
            config,
            picture: Picture::default(),
            histograms: Histograms::new(),
            log_odds: Vec::new(),
            lines: Vec::new(),
            hiders: Hiders::default(),
        }
    }

    pub fn prior(&self, pose: &Pose, model: &ContourModel, diameter_m: f64) -> Prior {
        let c = &self.config;
        let of = |sigma: f64| 1.0 / (sigma * sigma);
        let (xy, z, r) =
            (of(c.prior_xy * diameter_m), of(c.prior_z * diameter_m), of(c.prior_rotation_deg.to_radians()));
        Prior {
            camera_from_object: *pose,
            information: [xy, xy, z, r, r, r],
            freedom: c.prior_freedom,
            middle_m: model.centre_m().coords,
        }
    }

    pub fn refine(
        &mut self,
        image: &Image<'_>,
        model: &ContourModel,
        rough: &Pose,
        diameter_m: f64,
        hiders: &[Hider<'_>],
    ) -> Option<Region> {
        let prior = self.prior(rough, model, diameter_m);
        self.refine_with(image, model, rough, &prior, hiders, &mut Nothing)
    }

    pub fn refine_with(
        &mut self,
        image: &Image<'_>,
        model: &ContourModel,
        rough: &Pose,
        prior: &Prior,
        hiders: &[Hider<'_>],
        term: &mut dyn Term,
    ) -> Option<Region> {
        let c = self.config.clone();
        self.picture.fill(image, rough, &model.centre_m(), model.radius_m(), c.object_px, c.margin)?;
        self.hiders.fill(hiders, model, rough, &self.picture);
        self.histograms.clear();
        let mut pose = *rough;
        for (i, scale) in c.scales_px.iter().enumerate() {
            let iterations = if i == 0 { 1 } else { c.iterations };
            for _ in 0..iterations {
                pose = self.step(model, &pose, prior, term, *scale as f32)?;
            }
        }
        for _ in 0..c.edges {
            project(model.view(&pose), &pose, &self.picture, false, &mut self.lines);
            self.hiders.apply(&mut self.lines);
            measure_edges(&mut self.lines, &self.picture, c.edge_noise);
            let h = 1.0 / f64::from(self.picture.independence);
            pose = self.solve(&pose, prior, term, c.edge_tukey * h, c.edge_sigma * h, c.edge_lines_per_error)?;
        }
        let last = *c.scales_px.last()? as f32;
        self.look(model, &pose, last)?;
        let score = self.lines.iter().filter(|l| l.weight > 0.0).map(|l| f64::from(l.here)).sum::<f64>()
            / self.lines.len().max(1) as f64;
        let lines: f64 = self
            .lines
            .iter()
            .filter(|l| l.weight > 0.0)
            .map(|l| -(0.9 * f64::from(l.here) + 0.1 / 12.0).ln() - (12.0_f64).ln())
            .sum();
        let cost = lines / c.lines_per_error + prior.cost(&pose) + term.cost(&pose);
        Some(Region { cost, camera_from_object: pose, score, overlap: self.histograms.overlap() })
    }

    fn look(&mut self, model: &ContourModel, pose: &Pose, scale_px: f32) -> Option<()> {
        project(model.view(pose), pose, &self.picture, false, &mut self.lines);
        self.hiders.apply(&mut self.lines);
        self.count_colours();
        if !self.histograms.renew(self.config.renewal) {
            return None;
        }
        self.histograms.log_odds(&self.picture.bins, &mut self.log_odds);
        let reading = Reading {
            scale_px,
            step: SmoothStep::new(self.config.amplitude, self.config.slope),
            shortest: self.config.shortest,
            evidence: self.config.evidence * self.picture.independence,
        };
        measure(&mut self.lines, &self.log_odds, self.picture.size_px, &reading);
        Some(())
    }

    fn step(
        &mut self,
        model: &ContourModel,
        pose: &Pose,
        prior: &Prior,
        term: &mut dyn Term,
        scale_px: f32,
    ) -> Option<Pose> {
        self.look(model, pose, scale_px)?;
        let c = &self.config;
        self.solve(pose, prior, term, c.tukey_px * f64::from(scale_px), c.sigma_px, c.lines_per_error)
    }

    fn solve(
        &self,
        pose: &Pose,
        prior: &Prior,
        term: &mut dyn Term,
        tukey_px: f64,
        sigma_px: f64,
        lines_per_error: f64,
    ) -> Option<Pose> {
        let mut hessian = Matrix6::zeros();
        let mut gradient = Vector6::zeros();
        let c = &self.config;
        let (mut cross, mut own, mut pull) = (Vector6::zeros(), 0.0, 0.0);
        for line in self.lines.iter().filter(|l| l.weight > 0.0) {
            let variance = (f64::from(line.variance_px2) + sigma_px * sigma_px) * lines_per_error;
            let mut w = f64::from(line.weight) / variance;
            let r = -f64::from(line.mean_px + c.shift_px);
            if tukey_px > 0.0 {
                let width = tukey_px;
                let s = (1.0 - (r / width).powi(2)).max(0.0);
                w *= s * s;
            }
            let j = Vector6::from_fn(|i, _| f64::from(line.jacobian[i]));
            hessian += w * j * j.transpose();
            gradient += w * r * j;
            cross += w * j;
            own += w;
            pull += w * r;
        }
        // An offset that all lines share, known to `common_px`: eliminated (Schur).
        if c.common_px > 0.0 {
            let sigma = c.common_px / f64::from(self.picture.independence);
            let own = own + 1.0 / (sigma * sigma);
            hessian -= cross * cross.transpose() / own;
            gradient -= cross * (pull / own);
        }
        prior.accumulate(pose, &mut hessian, &mut gradient);
        term.accumulate(pose, &mut hessian, &mut gradient);
        let step = -hessian.cholesky()?.solve(&gradient);
        step.iter().all(|v| v.is_finite()).then(|| retract(pose, &step))
    }

    fn count_colours(&mut self) {
        let (from, to) = (self.config.colours_from_px, self.config.colours_to_px);
        self.histograms.begin();
        let size = self.picture.size_px as i32;
        for line in self.lines.iter().filter(|l| l.weight > 0.0) {
            let steps = |reach: f32| ((reach.min(to) - from).max(0.0)) as usize;
            let bin = |r: f32| {
                let x = (line.at[0] + r * line.normal[0]).round() as i32;
                let y = (line.at[1] + r * line.normal[1]).round() as i32;
                let within = x >= 0 && y >= 0 && x < size && y < size;
                if within { self.picture.bins[(y * size + x) as usize] } else { crate::histogram::NOWHERE }
            };
            for s in 0..steps(line.inside_px) {
                self.histograms.count_inside(bin(-from - s as f32 - 0.5), 1.0);
            }
            for s in 0..steps(line.outside_px) {
                self.histograms.count_outside(bin(from + s as f32 + 0.5), 1.0);
            }
        }
    }
}
