use crate::normal::{Z_MIN_M, accumulate};
use crate::points::PointSet;
use nalgebra::{Matrix6, Vector6};
use pseudoflow_contour::Term;
use pseudoflow_geometry::{Intrinsics, Pose};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What flow is worth. Pixels are those of a crop of 256 px. Chosen on train splits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FlowConfig {
    /// Correspondences used, at most.
    pub max_points: usize,
    /// Side of the square over which neighbouring flow vectors share one error.
    pub correlation_px: f64,
    /// Smallest standard deviation of a coordinate.
    pub least_px: f64,
    /// Largest.
    pub most_px: f64,
    /// Width of Tukey's loss, standard deviations.
    pub tukey_width: f64,
}

impl Default for FlowConfig {
    fn default() -> Self {
        Self { max_points: 800, correlation_px: 110.0, least_px: 1.0, most_px: 12.0, tukey_width: 4.0 }
    }
}

/// Flow as a term of the joint cost: reprojection errors under Tukey's loss, whose scale is that of the residuals at the pose
/// itself, so that flow which agrees with no pose says little. As many errors count as are independent.
pub(crate) struct FlowTerm<'a> {
    points: &'a PointSet,
    camera: Intrinsics,
    config: &'a FlowConfig,
    /// Crop pixels for one of a crop of 256.
    scale: f64,
    /// Independent errors for each correspondence.
    share: f64,
    errors: &'a mut Vec<f64>,
}

impl<'a> FlowTerm<'a> {
    /// `all` is how many pixels of a crop of `size_px` the points were taken from.
    pub(crate) fn new(
        points: &'a PointSet,
        camera: &Intrinsics,
        config: &'a FlowConfig,
        (all, size_px): (usize, usize),
        errors: &'a mut Vec<f64>,
    ) -> Self {
        let scale = size_px as f64 / 256.0;
        let independent = all as f64 / (config.correlation_px * scale).powi(2);
        let share = independent / points.len().max(1) as f64;
        Self { points, camera: *camera, config, scale, share, errors }
    }

    /// Robust standard deviation of a coordinate of the residuals at a pose, within its limits.
    fn sigma_px(&mut self, pose: &Pose) -> f64 {
        let (least, most) = (self.config.least_px * self.scale, self.config.most_px * self.scale);
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
        let middle = self.errors.len() / 2;
        if middle == 0 {
            return most;
        }
        let (_, median, _) = self.errors.select_nth_unstable_by(middle, f64::total_cmp);
        // The median length of a 2D Gaussian error is 1.1774 standard deviations of one coordinate.
        (median.sqrt() / 1.1774).clamp(least, most)
    }

    /// The cost at a pose with a given scale of the residuals.
    fn cost_at(&self, pose: &Pose, sigma_px: f64) -> f64 {
        let at = accumulate(self.points, &self.camera, pose, self.config.tukey_width * sigma_px);
        let padding = (self.points.x.len() - self.points.len()) as f64;
        let loss = (at.cost - padding) * self.config.tukey_width.powi(2) / 6.0;
        // Two coordinates, each with the logarithm of its scale.
        self.share * (loss + 2.0 * self.points.len() as f64 * sigma_px.ln())
    }
}

impl Term for FlowTerm<'_> {
    fn accumulate(&mut self, pose: &Pose, hessian: &mut Matrix6<f64>, gradient: &mut Vector6<f64>) {
        let sigma_px = self.sigma_px(pose);
        let at = accumulate(self.points, &self.camera, pose, self.config.tukey_width * sigma_px);
        let weight = self.share / (sigma_px * sigma_px);
        *hessian += weight * at.hessian;
        *gradient += weight * at.gradient;
    }

    fn cost(&mut self, pose: &Pose) -> f64 {
        let sigma_px = self.sigma_px(pose);
        self.cost_at(pose, sigma_px)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::normal::retract;
    use crate::testing::{CAMERA, Scene, point_set};

    #[test]
    fn the_gradient_is_that_of_the_cost() {
        let scene = Scene::solid(403, 3).noisy(3.0).with_outliers(0.3);
        let points = point_set(&scene.points, &scene.pixels);
        let config = FlowConfig::default();
        let mut errors = Vec::new();
        let mut term = FlowTerm::new(&points, &CAMERA, &config, (4000, 256), &mut errors);
        let pose = retract(&scene.pose, &Vector6::new(0.002, 0.001, 0.01, 0.01, -0.02, 0.01));
        let (mut hessian, mut gradient) = (Matrix6::zeros(), Vector6::zeros());
        term.accumulate(&pose, &mut hessian, &mut gradient);
        let sigma = term.sigma_px(&pose);
        for k in 0..6 {
            let mut tangent = Vector6::zeros();
            tangent[k] = 1e-6;
            let cost = |t: &Vector6<f64>| term.cost_at(&retract(&pose, t), sigma);
            let slope = (cost(&tangent) - cost(&-tangent)) / 2e-6;
            assert!((slope - gradient[k]).abs() < 1e-3 * (1.0 + gradient[k].abs()), "{k}: {slope} {}", gradient[k]);
        }
    }

    #[test]
    fn flow_that_agrees_with_no_pose_weighs_less() {
        let weight = |noise: f64| {
            let scene = Scene::solid(400, 3).noisy(noise);
            let points = point_set(&scene.points, &scene.pixels);
            let (config, mut errors) = (FlowConfig::default(), Vec::new());
            let mut term = FlowTerm::new(&points, &CAMERA, &config, (4000, 256), &mut errors);
            let mut hessian = Matrix6::zeros();
            term.accumulate(&scene.pose, &mut hessian, &mut Vector6::zeros());
            hessian[(0, 0)]
        };
        let ratio = weight(1.5) / weight(6.0);
        assert!((ratio / 16.0 - 1.0).abs() < 0.2, "{ratio}");
    }
}
