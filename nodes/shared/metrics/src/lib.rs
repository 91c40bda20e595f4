//! Ground truth and what is measured with it: the pose errors and conventions of the BOP benchmark.
//!
//! - **Ground truth** ([`SceneTruth`]): the only type of the workspace that holds true poses. Only `player`,
//!   `evaluator` and `cli` may depend on this crate; nothing on the way from an image to a label or a pose does.
//! - **Errors of a pose** over [`ModelPoints`]: [`add_m`], [`adi_m`], [`mssd_m`], [`mspd_px`], [`projection_px`],
//!   [`rotation_error_rad`], [`translation_error_m`], [`within_5cm_5deg`]; over depth images: [`vsd`].
//! - **From errors to scores**: [`match_greedy`], thresholds, [`recall`], [`auc_to_10cm`].
//! - **What an estimate claims about itself**: [`pose_error`], [`mahalanobis2`], [`spearman`].
//! - **Files**: `scene_gt.json`, `scene_gt_info.json`, target lists, BOP19 result files.
//!
//! Metres and radians inside; BOP files hold millimetres. The referee is bop_toolkit: `tests/` compares with its
//! answers.

mod affine;
mod distance;
mod matching;
mod matrix_pose;
mod points;
mod recall;
mod results;
mod simd;
mod truth;
mod uncertainty;
mod vsd;

pub use distance::{
    add_m, adi_m, mspd_px, mspd_scale, mssd_m, nearest_symmetric, projection_px, rotation_error_rad,
    translation_error_m, within_5cm_5deg,
};
pub use matching::match_greedy;
pub use matrix_pose::MatrixPose;
pub use points::{ModelPoints, PointsError};
pub use recall::{
    AUC_LIMIT_M, MAX_SYM_DISC_STEP, VISIB_GT_MIN, add_threshold_m, auc_to_10cm, mspd_thresholds, mssd_thresholds,
    recall, vsd_taus, vsd_thresholds,
};
pub use results::{
    Estimate, KnownIds, Problem, ResultsError, ResultsWriter, file_name, parse_results, read_results, write_results,
};
pub use truth::{SceneTruth, Target, TruthError, TruthInstance, read_targets};
pub use uncertainty::{CHI2_95_OF_3, CHI2_95_OF_6, Mahalanobis2, mahalanobis2, pose_error, spearman};
pub use vsd::{VSD_DELTA_M, VsdDepths, vsd};
