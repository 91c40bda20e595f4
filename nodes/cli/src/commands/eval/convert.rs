//! Between the evaluator's images and poses and those of the nodes.

use crate::pipeline::Frame;
use anyhow::Result;
use pseudoflow_evaluator::{EstimateDetails, EvalImage, GateStep};
use pseudoflow_geometry::{pose_from_quaternion, quaternion_xyzw};
use pseudoflow_imaging::RgbImage;
use pseudoflow_metrics::Estimate;
use pseudoflow_msgs::{CameraFrameHeader, ObjectPose, PoseSource, PoseStatus};
use pseudoflow_pnp::{Look, Refinement};
use std::collections::BTreeMap;

/// A dataset's image as the nodes take it.
pub(super) fn frame<'a>(image: &EvalImage, rgb: &'a RgbImage) -> Frame<'a> {
    let k = &image.frame.intrinsics;
    let header = CameraFrameHeader {
        width: rgb.width(),
        height: rgb.height(),
        scene_id: image.scene_id,
        image_id: image.frame.image_id,
        intrinsics: [k.fx, k.fy, k.cx, k.cy],
        frame_id: [0; pseudoflow_msgs::FRAME_ID_BYTES],
    };
    let index = u64::from(image.scene_id) << 32 | u64::from(image.frame.image_id);
    Frame { header, rgb: rgb.as_raw(), index }
}

/// A node's pose as the evaluator takes it.
pub(super) fn estimate(image: &EvalImage, pose: &ObjectPose) -> Result<Estimate> {
    Ok(Estimate {
        scene_id: image.scene_id,
        image_id: image.frame.image_id,
        object_id: pose.object_id,
        score: pose.score,
        camera_from_object: pose_from_quaternion(&pose.rotation_xyzw, &pose.translation_m)?.into(),
        image_time_s: None,
    })
}

/// What a pose says about itself, and the gate's decisions that led to it.
pub(super) fn details(pose: &ObjectPose, passes: &[Vec<Look>]) -> EstimateDetails {
    let of_it = passes.iter().flatten().filter(|look| look.pose.identity() == pose.identity());
    let steps = of_it.filter_map(|look| look.refinement.as_ref());
    EstimateDetails {
        confidence: Some(pose.score),
        covariance: (pose.source == PoseSource::Refined as u32).then_some(pose.covariance),
        gate: steps.map(gate_step).collect(),
    }
}

fn gate_step(refinement: &Refinement) -> GateStep {
    let known = serde_json::to_value(refinement.features.known()).and_then(serde_json::from_value);
    let mut evidence: BTreeMap<String, f64> = known.unwrap_or_default();
    evidence.insert("better".into(), refinement.verdict.better);
    GateStep { before: refinement.before, after: refinement.after, accepted: refinement.accepted, evidence }
}

/// An initial pose as the nodes take it.
pub(super) fn given(estimate: &Estimate, instance: u32) -> ObjectPose {
    let pose = estimate.camera_from_object.pose();
    ObjectPose {
        object_id: estimate.object_id,
        instance,
        status: PoseStatus::Ok as u32,
        source: PoseSource::Given as u32,
        score: estimate.score,
        rotation_xyzw: quaternion_xyzw(&pose),
        translation_m: pose.translation.vector.into(),
        covariance: [0.0; 36],
    }
}
