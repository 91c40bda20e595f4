//! What became of a frame: whether a track's pose can be believed, and what follows from it.

use super::{Track, TrackConfig, distance_m};
use nalgebra::Vector6;
use pseudoflow_geometry::{Pose, pose_from_quaternion, rotation_angle_rad};
use pseudoflow_msgs::{ObjectPose, PoseStatus, TrackPhase, TrackReason};

/// The pose, if it can be believed; else why not.
pub(super) fn plausible(
    track: &Track,
    pose: &ObjectPose,
    expected: &Pose,
    diameter_m: f64,
    config: &TrackConfig,
) -> Result<Pose, TrackReason> {
    match pose.status() {
        Some(PoseStatus::Ok | PoseStatus::Rejected) => {}
        Some(PoseStatus::NotVisible) => return Err(TrackReason::LeftImage),
        Some(PoseStatus::NotSeen) => return Err(TrackReason::NotSeen),
        _ => return Err(TrackReason::NotSolved),
    }
    if pose.score < config.min_confidence {
        return Err(TrackReason::NotSeen);
    }
    let there = pose_from_quaternion(&pose.rotation_xyzw, &pose.translation_m).map_err(|_| TrackReason::NotSolved)?;
    let jump = distance_m(&there, expected) / diameter_m;
    let turn_deg = rotation_angle_rad(&there, expected).to_degrees();
    // A detection is rough: only what is tracked has an expected place.
    let jumped = !track.fresh && (jump > config.max_jump_diameters || turn_deg > config.max_turn_deg);
    if jumped { Err(TrackReason::Jumped) } else { Ok(there) }
}

pub(super) fn good(track: &mut Track, there: Pose, score: f64, stamp_ns: i64, config: &TrackConfig) {
    track.move_to(there, stamp_ns, config.velocity_gain);
    (track.good, track.bad, track.score) = (track.good + 1, 0, score);
    if track.phase == TrackPhase::Tracking || track.good >= config.confirm_after {
        (track.phase, track.reason) = (TrackPhase::Tracking, TrackReason::Confirmed);
    }
}

pub(super) fn bad(track: &mut Track, reason: TrackReason, pose: &ObjectPose, stamp_ns: i64, config: &TrackConfig) {
    let (tracking, gone) = (track.phase == TrackPhase::Tracking, reason == TrackReason::LeftImage);
    let once_more = !tracking && track.bad == 0 && reason == TrackReason::NotSeen;
    (track.good, track.bad, track.score) = (0, track.bad + 1, pose.score);
    track.velocity = Vector6::zeros();
    track.reason = reason;
    if once_more {
        // What is not tracked yet and not quite believed gets a second look; a detection from where its refinement ended.
        let there = pose_from_quaternion(&pose.rotation_xyzw, &pose.translation_m);
        if let (true, Ok(there)) = (track.fresh, there) {
            track.start_from(there, Vec::new(), stamp_ns);
        }
    } else if !tracking {
        track.stop(track.phase, reason);
    } else if gone || track.bad >= config.lose_after {
        track.stop(TrackPhase::Lost, reason);
    }
}
