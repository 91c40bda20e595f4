//! Votes of the views for each surface point, and what they agree on.

use crate::{ConsistencyError, rigid};
use nalgebra::{Point3, Vector3};
use pseudoflow_geometry::{Intrinsics, Pose};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// One rendered view with the flow that the teacher predicts from it to the real crop.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// Width and height, pixels.
    pub size_px: usize,
    /// The rendered pose.
    pub camera_from_object: Pose,
    /// K' of the crop, the same for all views of an instance.
    pub intrinsics: Intrinsics,
    /// Depth along z, metres, 0 off the object: `S x S`.
    pub depth_m: &'a [f32],
    /// Not 0 on the object: `S x S`.
    pub mask: &'a [u8],
    /// dx, dy in crop pixels: `S x S x 2`.
    pub flow_px: &'a [f32],
}

/// What a label is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Label {
    /// The teacher's own flow in the view (paper, eq. 5).
    #[default]
    TeacherFlow,
    /// From the pixel to the mean of all votes.
    MeanVote,
    /// From the pixel to where the one motion of the object that explains most votes of all views takes it; sigma is then the
    /// spread of the votes around that. Not in the paper: flows of a rigid object have six degrees of freedom, not two a pixel.
    Rigid,
}

/// When votes become a label.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rule {
    /// Largest sigma of a label, pixels of the views.
    pub tau_px: f64,
    /// Fewest views that must see a point.
    pub min_views: usize,
    /// What a label is.
    pub label: Label,
    /// Accepts every flow that stays in the crop, whatever the views say.
    pub accept_all: bool,
}

/// Labels of one view.
#[derive(Debug, Clone, PartialEq)]
pub struct Labels {
    /// `S x S`; NaN off the object and where too few views see the point.
    pub sigma_px: Vec<f32>,
    /// `S x S`: 255 where there is a label.
    pub valid: Vec<u8>,
    /// `S x S x 2`; NaN where not valid.
    pub label_px: Vec<f32>,
}

/// How well the depth at a projection must match, in pixels of the surface's distance and in diameters; and how much the
/// four texels of a sample may differ: a slope of 80 degrees, not a jump from one surface to another.
const MATCH_PX: f64 = 0.5;
const MATCH_DIAMETERS: f64 = 0.002;
const SLOPE_PX: f64 = 6.0;

impl View<'_> {
    fn check(&self, view: usize) -> Result<(), ConsistencyError> {
        let area = self.size_px * self.size_px;
        let planes = [
            ("depth_m", self.depth_m.len(), area),
            ("mask", self.mask.len(), area),
            ("flow_px", self.flow_px.len(), 2 * area),
        ];
        match planes.into_iter().find(|(_, found, needed)| found != needed) {
            Some((plane, found, needed)) => {
                Err(ConsistencyError::Plane { view, plane, found, size_px: self.size_px, needed })
            }
            None => Ok(()),
        }
    }

    fn here(&self, pixel: usize) -> [f64; 2] {
        [(pixel % self.size_px) as f64, (pixel / self.size_px) as f64]
    }

    /// Where the view's own flow takes a pixel.
    fn target(&self, pixel: usize) -> [f64; 2] {
        let [x, y] = self.here(pixel);
        [x + f64::from(self.flow_px[2 * pixel]), y + f64::from(self.flow_px[2 * pixel + 1])]
    }

    fn is_on_object(&self, pixel: usize) -> bool {
        self.mask[pixel] != 0 && self.depth_m[pixel] > 0.0
    }

    /// The surface point of a pixel, in this view's camera.
    fn point(&self, pixel: usize) -> Vector3<f64> {
        let [x, y] = self.here(pixel);
        let (k, z) = (&self.intrinsics, f64::from(self.depth_m[pixel]));
        Vector3::new((x - k.cx) / k.fx * z, (y - k.cy) / k.fy * z, z)
    }

    /// The vote for a point of this view's camera: where it lies in the real crop. `None` when this view does not see it:
    /// behind the camera, outside, off the object, or hidden by another surface.
    fn vote(&self, point: &Vector3<f64>, diameter_m: f64) -> Option<[f64; 2]> {
        let seen = self.intrinsics.project(&Point3::from(*point))?;
        let (x, y, last) = (seen.x, seen.y, (self.size_px - 1) as f64);
        if !(0.0..=last).contains(&x) || !(0.0..=last).contains(&y) {
            return None;
        }
        let (x0, y0) = ((x.floor() as usize).min(self.size_px - 2), (y.floor() as usize).min(self.size_px - 2));
        let (ax, ay) = (x - x0 as f64, y - y0 as f64);
        let texels =
            [(0, 0, (1.0 - ax) * (1.0 - ay)), (1, 0, ax * (1.0 - ay)), (0, 1, (1.0 - ax) * ay), (1, 1, ax * ay)];
        let (mut depth, mut flow) = (0.0, [0.0; 2]);
        let (mut near, mut far) = (f64::INFINITY, 0.0_f64);
        for (dx, dy, weight) in texels {
            // A texel without weight says nothing, so that whole pixels at the border can vote.
            if weight < 1e-9 {
                continue;
            }
            let at = (y0 + dy) * self.size_px + x0 + dx;
            if !self.is_on_object(at) {
                return None;
            }
            let texel_m = f64::from(self.depth_m[at]);
            (near, far) = (near.min(texel_m), far.max(texel_m));
            depth += weight * texel_m;
            flow[0] += weight * f64::from(self.flow_px[2 * at]);
            flow[1] += weight * f64::from(self.flow_px[2 * at + 1]);
        }
        let pitch_m = point.z / self.intrinsics.fx;
        let same_surface = far - near <= SLOPE_PX * pitch_m;
        let visible = (depth - point.z).abs() <= MATCH_PX * pitch_m + MATCH_DIAMETERS * diameter_m;
        let vote = [x + flow[0], y + flow[1]];
        (same_surface && visible && vote.iter().all(|v| v.is_finite())).then_some(vote)
    }
}

/// Mean of votes and their spread about it (paper, eqs. 3 and 4):
/// `sigma = sqrt(1/n sum |vote - mean|^2)`.
fn spread(votes: &[[f64; 2]]) -> ([f64; 2], f64) {
    let n = votes.len() as f64;
    let mean = [0, 1].map(|axis| votes.iter().map(|vote| vote[axis]).sum::<f64>() / n);
    let square = |vote: &[f64; 2]| (vote[0] - mean[0]).powi(2) + (vote[1] - mean[1]).powi(2);
    (mean, (votes.iter().map(square).sum::<f64>() / n).sqrt())
}

/// Labels all views of one instance. With fewer views than `min_views` all of them must see a point.
///
/// # Errors
/// When a plane has the wrong size.
pub fn label(views: &[View<'_>], diameter_m: f64, rule: &Rule) -> Result<Vec<Labels>, ConsistencyError> {
    views.iter().enumerate().try_for_each(|(i, view)| view.check(i))?;
    let votes: Vec<_> = (0..views.len()).map(|view| votes_for(views, view, diameter_m, rule)).collect();
    let motion = if rule.label == Label::Rigid { rigid::motion(views, &votes)? } else { None };
    Ok(views.iter().zip(&votes).map(|(view, votes)| labels_of(view, votes, rule, motion.as_ref())).collect())
}

/// What the views say about a surface point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Agreement {
    /// The point, metres, in the object's frame.
    pub point_in_object: Point3<f64>,
    /// Mean of the votes, crop pixels.
    pub mean_px: [f64; 2],
    /// Their spread, pixels.
    pub sigma_px: f64,
    /// Whether enough views see the point.
    pub agreed: bool,
}

/// What the views say about every pixel of one of them; `None` off the object.
fn votes_for(views: &[View<'_>], own: usize, diameter_m: f64, rule: &Rule) -> Vec<Option<Agreement>> {
    let (view, size_px) = (&views[own], views[own].size_px);
    let object_from_own = view.camera_from_object.inverse();
    let other_from_own: Vec<Pose> = views.iter().map(|other| other.camera_from_object * object_from_own).collect();
    let min_views = rule.min_views.min(views.len());
    let row = |y: usize| {
        let mut votes = Vec::with_capacity(views.len());
        let mut pixel = |x: usize| {
            let pixel = y * size_px + x;
            let point = view.is_on_object(pixel).then(|| view.point(pixel))?;
            votes.clear();
            for (k, (other, motion)) in views.iter().zip(&other_from_own).enumerate() {
                votes.extend(match k == own {
                    true => Some(view.target(pixel)).filter(|vote| vote.iter().all(|v| v.is_finite())),
                    false => other.vote(&(motion * Point3::from(point)).coords, diameter_m),
                });
            }
            let (mean_px, sigma_px) = spread(&votes);
            let agreed = votes.len() >= min_views && !votes.is_empty();
            Some(Agreement { point_in_object: object_from_own * Point3::from(point), mean_px, sigma_px, agreed })
        };
        (0..size_px).map(&mut pixel).collect::<Vec<_>>()
    };
    (0..size_px).into_par_iter().flat_map_iter(row).collect()
}

/// The labels of a view. `motion` is what the votes of all views come from, as far as it was asked for and found.
fn labels_of(view: &View<'_>, votes: &[Option<Agreement>], rule: &Rule, motion: Option<&Pose>) -> Labels {
    let limit = view.size_px as f64 - 0.5;
    let label = |(pixel, votes): (usize, &Option<Agreement>)| {
        let Some(votes) = votes else { return (f32::NAN, None) };
        let around_mean = |target| Some((target, votes.sigma_px));
        let target = match rule.label {
            Label::TeacherFlow => around_mean(view.target(pixel)),
            Label::MeanVote => around_mean(votes.mean_px),
            Label::Rigid => motion.and_then(|pose| rigid::target(view, votes, pose)),
        };
        let sigma_px = target.map_or(votes.sigma_px, |(_, sigma_px)| sigma_px);
        let good = rule.accept_all || (votes.agreed && sigma_px < rule.tau_px);
        let here = view.here(pixel);
        let label = target
            .filter(|(target, _)| good && target.iter().all(|v| (-0.5..limit).contains(v)))
            .map(|(target, _)| [(target[0] - here[0]) as f32, (target[1] - here[1]) as f32]);
        (if votes.agreed { sigma_px as f32 } else { f32::NAN }, label)
    };
    let pixels: Vec<(f32, Option<[f32; 2]>)> = votes.par_iter().enumerate().map(label).collect();
    Labels {
        sigma_px: pixels.iter().map(|(sigma, _)| *sigma).collect(),
        valid: pixels.iter().map(|(_, label)| if label.is_some() { 255 } else { 0 }).collect(),
        label_px: pixels.iter().flat_map(|(_, label)| label.unwrap_or([f32::NAN; 2])).collect(),
    }
}
