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
//!
//! Begin with [`ModelPoints`] and [`add_m`]; whole datasets are scored by `pseudoflow-evaluator`.
//!
//! ```
//! use nalgebra::Point3;
//! use pseudoflow_geometry::Pose;
//! use pseudoflow_metrics::{ModelPoints, add_m, adi_m, add_threshold_m};
//!
//! let corners = [-0.05, 0.05].map(|x| Point3::new(x, 0.0, 0.0)); // a stick of 10 cm
//! let stick = ModelPoints::new(&corners)?;
//! let truth = Pose::translation(0.0, 0.0, 0.8);
//! let shifted = Pose::translation(0.003, 0.0, 0.8);
//! let error_m = add_m(&stick, &shifted.into(), &truth.into());
//! assert!((error_m - 0.003).abs() < 1e-5 && error_m < add_threshold_m(0.1));
//!
//! // Turned end to end it looks the same: ADI does not mind.
//! let turned = truth * Pose::rotation(nalgebra::Vector3::z() * std::f64::consts::PI);
//! assert!(add_m(&stick, &turned.into(), &truth.into()) > 0.09);
//! assert!(adi_m(&stick, &turned.into(), &truth.into()) < 1e-5);
//! # Ok::<(), pseudoflow_metrics::PointsError>(())
//! ```

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
