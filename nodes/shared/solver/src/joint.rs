//! One Gauss-Newton of flow correspondences, contour lines and the rough pose.

use crate::normal::{Z_MIN_M, accumulate};
use crate::points::PointSet;
use crate::{Correspondences, PnpConfig, PnpError, PnpResult, Solver};
use nalgebra::{Matrix6, Vector6};
use pseudoflow_contour::{ContourModel, Hider, Image, Nothing, Refiner, Region, RegionConfig, Term};
use pseudoflow_geometry::{Intrinsics, Pose};

/// What flow is worth.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FlowConfig {
    pub max_points: usize,
    /// Pixels (of a crop of 256) over which neighbouring flow vectors share one error.
    pub correlation_px: f64,
    pub least_px: f64,
    pub most_px: f64,
    /// Width of Tukey's loss, standard deviations.
    pub width: f64,
}

impl Default for FlowConfig {
    fn default() -> Self {
        Self { max_points: 1000, correlation_px: 40.0, least_px: 1.0, most_px: 12.0, width: 4.0 }
    }
}

/// Settings of the joint solver.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct JointConfig {
    pub region: RegionConfig,
    pub flow: FlowConfig,
}

/// Flow at a pose.
struct FlowTerm<'a> {
    points: &'a PointSet,
    camera: Intrinsics,
    config: &'a FlowConfig,
    /// Crop pixels for one of a crop of 256.
    scale: f64,
    /// Independent errors per correspondence.
    share: f64,
    errors: &'a mut Vec<f64>,
    sigma_px: f64,
}

impl FlowTerm<'_> {
    /// Robust standard deviation of a coordinate of the residuals at a pose.
    fn sigma_px(&mut self, pose: &Pose) -> f64 {
        self.errors.clear();
        for i in 0..self.points.len() {
            let p = pose.rotation * self.points.point(i) + pose.translation.vector;
            if p.z > Z_MIN_M {
                let [u, v] = self.points.pixel(i);
                let du = self.camera.fx * p.x / p.z + self.camera.cx - u;
                let dv = self.camera.fy * p.y / p.z + self.camera.cy - v;
                self.errors.push(du * du + dv * dv);
            }
        }
        let n = self.errors.len();
        if n == 0 {
            return self.config.most_px * self.scale;
        }
        let (_, median, _) = self.errors.select_nth_unstable_by(n / 2, f64::total_cmp);
        (median.sqrt() / 1.1774).clamp(self.config.least_px * self.scale, self.config.most_px * self.scale)
    }
}

impl Term for FlowTerm<'_> {
    fn accumulate(&mut self, pose: &Pose, hessian: &mut Matrix6<f64>, gradient: &mut Vector6<f64>) {
        self.sigma_px = self.sigma_px(pose);
        let at = accumulate(self.points, &self.camera, pose, self.config.width * self.sigma_px);
        let weight = self.share / (self.sigma_px * self.sigma_px);
        *hessian += weight * at.hessian;
        *gradient += weight * at.gradient;
    }

    fn cost(&mut self, pose: &Pose) -> f64 {
        let sigma = self.sigma_px(pose);
        let at = accumulate(self.points, &self.camera, pose, self.config.width * sigma);
        let padding = (self.points.x.len() - self.points.len()) as f64;
        // Tukey's loss over sigma^2, and the logarithm of the spread itself.
        let n = self.points.len() as f64;
        self.share * ((at.cost - padding) * self.config.width.powi(2) / 6.0 + 2.0 * n * sigma.ln())
    }
}

/// What the joint solver found.
#[derive(Debug, Clone, PartialEq)]
pub struct JointResult {
    pub region: Option<Region>,
    pub pnp: Option<PnpResult>,
    pub from_pnp: bool,
}

/// Joint solver; holds its memory.
#[derive(Debug, Clone)]
pub struct JointSolver {
    config: JointConfig,
    refiner: Refiner,
    pnp: Solver,
    points: PointSet,
    errors: Vec<f64>,
}

impl JointSolver {
    /// # Errors
    /// When a setting is out of range.
    pub fn new(config: JointConfig, pnp: PnpConfig) -> Result<Self, PnpError> {
        Ok(Self {
            refiner: Refiner::new(config.region.clone()),
            config,
            pnp: Solver::new(pnp)?,
            points: PointSet::default(),
            errors: Vec::new(),
        })
    }

    pub fn solve(
        &mut self,
        image: &Image<'_>,
        model: &ContourModel,
        rough: &Pose,
        diameter_m: f64,
        hiders: &[Hider<'_>],
        flow: Option<(&Correspondences<'_>, &Intrinsics, usize)>,
        seed: u64,
    ) -> JointResult {
        let prior = self.refiner.prior(rough, model, diameter_m);
        let Some((correspondences, camera, size_px)) = flow else {
            let region = self.refiner.refine_with(image, model, rough, &prior, hiders, &mut Nothing);
            return JointResult { region, pnp: None, from_pnp: false };
        };
        let pnp = self.pnp.solve(correspondences, camera, rough, seed);
        let all = self.points.fill(correspondences, self.config.flow.max_points);
        let scale = size_px as f64 / 256.0;
        let independent = all as f64 / (self.config.flow.correlation_px * scale).powi(2);
        let mut term = FlowTerm {
            points: &self.points,
            camera: *camera,
            config: &self.config.flow,
            scale,
            share: independent / self.points.len().max(1) as f64,
            errors: &mut self.errors,
            sigma_px: 0.0,
        };
        let of_rough = self.refiner.refine_with(image, model, rough, &prior, hiders, &mut term);
        let of_pnp = match pnp.status.is_ok() {
            true => self.refiner.refine_with(image, model, &pnp.camera_from_object, &prior, hiders, &mut term),
            false => None,
        };
        let cost = |r: &Option<Region>| r.as_ref().map_or(f64::INFINITY, |r| r.cost);
        let from_pnp = cost(&of_pnp) < cost(&of_rough);
        JointResult { region: if from_pnp { of_pnp } else { of_rough }, pnp: Some(pnp), from_pnp }
    }
}
