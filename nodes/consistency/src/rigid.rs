//! The one motion behind all votes: a rigid object has six degrees of freedom, however many pixels vote.

use crate::ConsistencyError;
use crate::votes::{Agreement, View};
use pseudoflow_geometry::Pose;
use pseudoflow_solver::{Correspondences, PnpConfig, Solver};

/// Share of the votes that the motion must explain, within the solver's threshold.
const MIN_INLIER_RATIO: f64 = 0.3;

/// The pose that explains most of what the views of an object say; `None` when none explains enough.
pub(crate) fn motion(views: &[View<'_>], votes: &[Vec<Option<Agreement>>]) -> Result<Option<Pose>, ConsistencyError> {
    let Some(first) = views.first() else { return Ok(None) };
    let said = || votes.iter().flatten().flatten().filter(|votes| votes.agreed);
    let points: Vec<[f32; 3]> = said().map(|votes| votes.point_in_object.coords.map(|v| v as f32).into()).collect();
    let pixels: Vec<[f32; 2]> = said().map(|votes| votes.mean_px.map(|v| v as f32)).collect();
    let config = PnpConfig { min_inlier_ratio: MIN_INLIER_RATIO, ..PnpConfig::default() }.scaled_to(first.size_px);
    let found = Solver::new(config)?.solve(
        &Correspondences::new(&points, &pixels)?,
        &first.intrinsics,
        &first.camera_from_object,
        0,
    );
    Ok(found.status.is_ok().then_some(found.camera_from_object))
}

/// Where the motion takes a point, and the root mean square distance of the votes from there.
pub(crate) fn target(view: &View<'_>, votes: &Agreement, motion: &Pose) -> Option<([f64; 2], f64)> {
    let seen = view.intrinsics.project(&(motion * votes.point_in_object))?;
    let off_px = (seen.x - votes.mean_px[0]).hypot(seen.y - votes.mean_px[1]);
    Some(([seen.x, seen.y], votes.sigma_px.hypot(off_px)))
}
