//! From groups of votes to poses.

use crate::InitializerError;
use crate::votes::{Vote, sureness};
use nalgebra::{Point2, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use pseudoflow_geometry::{Intrinsics, Pose};
use pseudoflow_imaging::{Object, ObjectSet};
use pseudoflow_network::CORNERS;
use pseudoflow_solver::{Correspondences, MinimalSolver, PnpConfig, Solver};
use rand::Rng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How poses are made of votes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DetectConfig {
    /// Cells less sure than this have no vote, 0..1.
    pub min_vote: f64,
    /// Instances with a lower score are left out, 0..1.
    pub min_score: f64,
    /// Fewer votes than this make no instance.
    pub min_votes: usize,
    /// A corner's vote is an inlier up to this reprojection error, in sides of the object's projection.
    pub threshold_sides: f64,
    /// At most this many instances of each object in an image; the surest are kept.
    pub max_instances: usize,
}

impl Default for DetectConfig {
    fn default() -> Self {
        Self { min_vote: 0.25, min_score: 0.2, min_votes: 2, threshold_sides: 0.08, max_instances: 1 }
    }
}

impl DetectConfig {
    /// Checks the ranges.
    ///
    /// # Errors
    /// Names the first setting out of range.
    pub fn check(&self) -> Result<(), InitializerError> {
        let share = |v: f64| (0.0..=1.0).contains(&v);
        let rules = [
            ("min_vote", self.min_vote, share(self.min_vote), "0 to 1"),
            ("min_score", self.min_score, share(self.min_score), "0 to 1"),
            ("min_votes", self.min_votes as f64, (1..=1000).contains(&self.min_votes), "1 to 1000"),
            (
                "threshold_sides",
                self.threshold_sides,
                self.threshold_sides > 0.0 && self.threshold_sides <= 1.0,
                "a number over 0, at most 1",
            ),
            ("max_instances", self.max_instances as f64, (1..=100).contains(&self.max_instances), "1 to 100"),
        ];
        match rules.into_iter().find(|(_, _, holds, _)| !holds) {
            Some((field, got, _, wanted)) => Err(InitializerError::Setting { field, got, wanted }),
            None => Ok(()),
        }
    }
}

/// Where an object is seen, hidden parts and those outside of the image included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectangle {
    /// Its middle, pixels.
    pub middle_px: Point2<f64>,
    /// Width and height, pixels.
    pub size_px: Vector2<f64>,
}

impl Rectangle {
    /// The larger side, pixels.
    #[must_use]
    pub fn side_px(&self) -> f64 {
        self.size_px.max()
    }

    /// Whether something whose middle is seen there may be what this rectangle is around.
    #[must_use]
    pub fn holds(&self, middle_px: &Point2<f64>) -> bool {
        (middle_px - self.middle_px).norm() < SAME_PLACE * self.side_px()
    }
}

/// Another pose that would explain what was seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hypothesis {
    /// The pose, metres.
    pub camera_from_object: Pose,
    /// How sure, 0..1; at most that of the detection.
    pub score: f64,
}

/// An object that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Detection {
    /// The object.
    pub object_id: u32,
    /// Its pose, metres.
    pub camera_from_object: Pose,
    /// How sure the votes are, times the share of them that the pose explains, 0..1.
    pub score: f64,
    /// Middle of its projection, pixels of the input.
    pub centre_px: Point2<f64>,
    /// Larger side of its projection, pixels of the input.
    pub side_px: f64,
    /// As in `PnpResult::covariance`.
    pub covariance: [f64; 36],
    /// Other poses of this instance: pnp keeps the one that flow and picture agree with best.
    pub others: Vec<Hypothesis>,
}

/// Most samples of RANSAC.
const ITERATIONS: usize = 200;

/// The pose of one group of votes (RANSAC-PnP over the pooled corners), if there is one.
///
/// # Errors
/// When the solver refuses its settings.
pub fn solve(
    votes: &[Vote],
    object: &Object,
    intrinsics: &Intrinsics,
    config: &DetectConfig,
    rng: &mut impl Rng,
) -> Result<Option<Detection>, InitializerError> {
    let seen = votes[0].rectangle();
    let (points, pixels) = pool(votes, object);
    let settings = PnpConfig {
        threshold_px: (config.threshold_sides * seen.side_px()).max(1.0),
        max_iterations: ITERATIONS,
        minimal: MinimalSolver::P3p,
        min_inliers: CORNERS,
        min_inlier_ratio: 0.2,
        max_rotation_std_rad: 1.5,
        points_per_independent_error: (votes.len() as f64 / 4.0).max(1.0),
        ..PnpConfig::default()
    };
    let z_m = intrinsics.fx * object.diameter_m / seen.side_px();
    let guess = intrinsics.unproject(&seen.middle_px, z_m);
    let guess = Pose::from_parts(Translation3::from(guess.coords), UnitQuaternion::identity());
    let found =
        Solver::new(settings)?.solve(&Correspondences::new(&points, &pixels)?, intrinsics, &guess, rng.random());
    if !found.status.is_ok() {
        return Ok(None);
    }
    let Some(explained) = extent(object, &found.camera_from_object, intrinsics) else { return Ok(None) };
    // A pose that explains the corners by a mirrored or far-off box.
    let larger = explained.side_px() / seen.side_px();
    if !(0.5..=2.0).contains(&larger) {
        return Ok(None);
    }
    Ok(Some(Detection {
        object_id: object.id,
        camera_from_object: found.camera_from_object,
        score: sureness(votes) * found.inlier_ratio,
        centre_px: explained.middle_px,
        side_px: explained.side_px(),
        covariance: found.covariance,
        others: Vec::new(),
    }))
}

/// The points that the votes name and where they see them: the surface point of each, and the corners of so many of the
/// surest that both kinds weigh alike.
fn pool(votes: &[Vote], object: &Object) -> (Vec<[f32; 3]>, Vec<[f32; 2]>) {
    let to_f32 = |p: Point3<f64>| [p.x as f32, p.y as f32, p.z as f32];
    let (corners, centre) = (object.box_corners_m().map(to_f32), object.box_centre_m());
    let on_surface = |vote: &Vote| {
        let away = Vector3::from(vote.surface).map(f64::from) * object.diameter_m;
        (to_f32(centre + away), vote.centre_px)
    };
    let with_corners = &votes[..votes.len().div_ceil(CORNERS)];
    let boxes = with_corners.iter().flat_map(|vote| corners.into_iter().zip(vote.corners_px));
    votes.iter().map(on_surface).chain(boxes).unzip()
}

/// The rectangle around an object's projection; `None` when a part of it is behind the camera.
pub(crate) fn extent(object: &Object, pose: &Pose, intrinsics: &Intrinsics) -> Option<Rectangle> {
    let seen: Vec<Point2<f64>> =
        object.hull_m.iter().map(|p| intrinsics.project(&(pose * p))).collect::<Option<Vec<_>>>()?;
    let range = |k: usize| seen.iter().fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(p[k]), h.max(p[k])));
    let (x, y) = (range(0), range(1));
    Some(Rectangle {
        middle_px: Point2::new((x.0 + x.1) / 2.0, (y.0 + y.1) / 2.0),
        size_px: Vector2::new(x.1 - x.0, y.1 - y.0),
    })
}

/// The objects in an image: a pose for each group of votes, the surest instance of what lies at the same place.
///
/// # Errors
/// As [`solve`]; a class that the set does not have.
pub fn detect(
    groups: &[Vec<Vote>],
    object_ids: &[u32],
    objects: &ObjectSet,
    intrinsics: &Intrinsics,
    config: &DetectConfig,
    rng: &mut impl Rng,
) -> Result<Vec<Detection>, InitializerError> {
    let mut found = Vec::new();
    for votes in groups.iter().filter(|votes| votes.len() >= config.min_votes) {
        let object = objects.get(object_ids[votes[0].class])?;
        found.extend(solve(votes, object, intrinsics, config, rng)?);
    }
    found.retain(|d| d.score >= config.min_score);
    Ok(suppress(found, config.max_instances))
}

/// Two instances at the same place up to this distance of their middles, in sides.
const SAME_PLACE: f64 = 0.4;

/// Keeps the surest instance of each place, and at most `max_instances` of an object.
#[must_use]
pub fn suppress(mut found: Vec<Detection>, max_instances: usize) -> Vec<Detection> {
    found.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut kept: Vec<Detection> = Vec::new();
    for detection in found {
        let same_place = |other: &Detection| {
            let sides = [detection.side_px, other.side_px];
            let alike = sides[0] < 1.8 * sides[1] && sides[1] < 1.8 * sides[0];
            let near = (detection.centre_px - other.centre_px).norm() < SAME_PLACE * sides[0].min(sides[1]);
            // A small thing before a large one is another thing, unless it is the same object.
            near && (alike || detection.object_id == other.object_id)
        };
        let of_object = kept.iter().filter(|other| other.object_id == detection.object_id).count();
        if of_object < max_instances && !kept.iter().any(same_place) {
            kept.push(detection);
        }
    }
    kept
}

#[cfg(test)]
mod tests;
