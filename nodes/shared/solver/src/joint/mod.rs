//! One Gauss-Newton of flow correspondences, contour lines and the rough pose.
//!
//! The cost is a negative log posterior: contour lines with their variances and a shared offset
//! (`pseudoflow-contour`), flow with the scale of its own residuals and as many errors as are independent, and the rough
//! pose as a prior with tails. It is minimised from the rough pose and from the pose of flow alone; the lower cost stays.
//! Either kind of evidence may be missing.

mod flow_term;

pub use flow_term::FlowConfig;

use crate::points::PointSet;
use crate::{Correspondences, JointError, PnpConfig, PnpResult, Solver};
use flow_term::FlowTerm;
use pseudoflow_contour::{ContourModel, Hider, Image, Prior, Refiner, Region, RegionConfig, RegionStatus, Task, Term};
use pseudoflow_geometry::{Intrinsics, Pose};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of the joint solver.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct JointConfig {
    /// The contour.
    pub region: RegionConfig,
    /// The flow.
    pub flow: FlowConfig,
    /// The covariance is that of the normal equations times this, measured on rendered pictures: so that 95 % of true poses
    /// lie in its 95 % ellipsoid.
    pub covariance_scale: f64,
}

impl Default for JointConfig {
    fn default() -> Self {
        Self { region: RegionConfig::default(), flow: FlowConfig::default(), covariance_scale: 1.0 }
    }
}

/// What there is to solve.
#[derive(Debug, Clone, Copy)]
pub struct JointTask<'a> {
    /// The camera's image.
    pub image: Image<'a>,
    /// The object's contour.
    pub model: &'a ContourModel,
    /// Its diameter, metres.
    pub diameter_m: f64,
    /// Its rough pose.
    pub rough: Pose,
    /// The other objects of the frame.
    pub hiders: &'a [Hider<'a>],
    /// Flow, where a network gave any.
    pub flow: Option<FlowEvidence<'a>>,
}

/// Flow from a rendering at the rough pose to the crop.
#[derive(Debug, Clone, Copy)]
pub struct FlowEvidence<'a> {
    /// One correspondence for each pixel of the rendering's foreground.
    pub correspondences: Correspondences<'a>,
    /// K' of the crop.
    pub intrinsics: Intrinsics,
    /// Side of the crop, pixels.
    pub size_px: usize,
}

/// What the joint solver found.
#[derive(Debug, Clone, PartialEq)]
pub struct JointResult {
    /// The pose; the rough one when neither contour nor flow says anything.
    pub camera_from_object: Pose,
    /// As [`PnpResult::covariance`].
    pub covariance: [f64; 36],
    /// Negative log posterior up to a constant; lower is better, for one instance.
    pub cost: f64,
    /// The contour.
    pub region: Region,
    /// The pose of flow alone, where there is flow.
    pub pnp: Option<PnpResult>,
    /// Share of the flow's correspondences within the solver's threshold of the joint pose; `None` without flow.
    pub inlier_ratio: Option<f64>,
    /// Whether anything was known beside the rough pose.
    pub known: bool,
}

/// Finds poses from flow, contour and rough pose. Holds its working memory.
#[derive(Debug, Clone)]
pub struct JointSolver {
    config: JointConfig,
    refiner: Refiner,
    pnp: Solver,
    points: PointSet,
    errors: Vec<f64>,
}

impl JointSolver {
    /// A solver; `pnp` has the thresholds of the crop's size.
    ///
    /// # Errors
    /// [`JointError`] when a setting is out of range.
    pub fn new(config: JointConfig, pnp: PnpConfig) -> Result<Self, JointError> {
        Ok(Self {
            refiner: Refiner::new(config.region.clone())?,
            config,
            pnp: Solver::new(pnp)?,
            points: PointSet::default(),
            errors: Vec::new(),
        })
    }

    /// The pose of least cost. `seed` is that of RANSAC.
    pub fn solve(&mut self, task: &JointTask<'_>, seed: u64) -> JointResult {
        let prior = self.refiner.prior(&task.rough, task.model, task.diameter_m);
        let contour = Task { image: task.image, model: task.model, prior: &prior, hiders: task.hiders };
        let Some(flow) = &task.flow else {
            let region = self.refiner.refine(&contour, &[task.rough], None);
            return self.result(region, None, None);
        };
        let pnp = self.pnp.solve(&flow.correspondences, &flow.intrinsics, &task.rough, seed);
        let region = self.refine_with_flow(&contour, &task.rough, &prior, flow, &pnp);
        let inliers = self.inlier_ratio(&region.camera_from_object, flow);
        self.result(region, Some(pnp), Some(inliers))
    }

    fn refine_with_flow(
        &mut self,
        contour: &Task<'_>,
        rough: &Pose,
        prior: &Prior,
        flow: &FlowEvidence<'_>,
        pnp: &PnpResult,
    ) -> Region {
        let all = self.points.fill(&flow.correspondences, self.config.flow.max_points);
        let size = (all, flow.size_px);
        let mut term = FlowTerm::new(&self.points, &flow.intrinsics, &self.config.flow, size, &mut self.errors);
        let starts = [*rough, pnp.camera_from_object];
        // Flow may know a way that is too far for the contour, and may be lost altogether.
        let near = pnp.status.is_ok() && prior.distance2(&pnp.camera_from_object) < FARTHEST2;
        self.refiner.refine(contour, &starts[..if near { 2 } else { 1 }], Some(&mut term as &mut dyn Term))
    }

    fn inlier_ratio(&self, pose: &Pose, flow: &FlowEvidence<'_>) -> f64 {
        let threshold_px = self.pnp.config().threshold_px;
        let near = crate::score::score(&self.points, &flow.intrinsics, pose, threshold_px);
        near.inliers / self.points.len().max(1) as f64
    }

    fn result(&self, region: Region, pnp: Option<PnpResult>, inlier_ratio: Option<f64>) -> JointResult {
        let known = region.status.is_ok() || pnp.as_ref().is_some_and(|p| p.status.is_ok());
        let inverse = region.information.cholesky().map(|c| c.inverse() * self.config.covariance_scale);
        let unknown = nalgebra::Matrix6::identity() * crate::UNKNOWN_VARIANCE;
        let covariance = inverse.filter(|_| known).unwrap_or(unknown);
        JointResult {
            camera_from_object: region.camera_from_object,
            covariance: std::array::from_fn(|i| covariance[(i / 6, i % 6)]),
            cost: region.cost,
            region,
            pnp,
            inlier_ratio,
            known: known && region.status != RegionStatus::NotFinite,
        }
    }
}

/// Poses further from the rough one (squared Mahalanobis distance, six numbers) are not started from.
const FARTHEST2: f64 = 100.0;
