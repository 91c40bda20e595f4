mod anchors;

use super::*;
use nalgebra::{Point2, Translation3, UnitQuaternion, Vector3};
use pseudoflow_geometry::{quaternion_xyzw, rotation_angle_rad};
use pseudoflow_msgs::{PoseSource, PoseStatus};
use std::path::Path;

const MUSTARD: u32 = 2;
const STEP_NS: i64 = 40_000_000;

fn tracker(max_instances: usize) -> Tracker {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/objects/tabletop");
    Tracker::new(TrackConfig::default(), &ObjectSet::load(&folder).unwrap(), max_instances)
}

fn at(x_m: f64, turn_rad: f64) -> Pose {
    Pose::from_parts(
        Translation3::new(x_m, 0.0, 0.8),
        UnitQuaternion::from_scaled_axis(Vector3::new(0.3, 1.0, 0.2) * turn_rad),
    )
}

fn detection(pose: Pose) -> Detection {
    Detection {
        object_id: MUSTARD,
        camera_from_object: pose,
        score: 0.6,
        centre_px: Point2::origin(),
        side_px: 50.0,
        covariance: [0.0; 36],
        others: Vec::new(),
    }
}

/// What pnp makes of a prediction when the object is in truth at `pose`.
fn refined(predicted: &Predicted, pose: Pose, status: PoseStatus) -> ObjectPose {
    ObjectPose {
        object_id: predicted.object_id,
        instance: predicted.instance,
        status: status as u32,
        source: PoseSource::Refined as u32,
        score: 0.8,
        rotation_xyzw: quaternion_xyzw(&pose),
        translation_m: pose.translation.vector.into(),
        covariance: [0.0; 36],
    }
}

fn status(tracker: &Tracker) -> (u32, u32) {
    let found = tracker.statuses().into_iter().find(|s| s.object_id == MUSTARD).unwrap();
    (found.phase, found.reason)
}

/// One frame: search if wanted and `seen`, predict, refine, learn. Returns whether it searched.
fn frame(tracker: &mut Tracker, index: i64, pose: Pose, seen: bool) -> bool {
    let stamp_ns = index * STEP_NS;
    let searched = tracker.wants_search();
    if searched {
        tracker.found(&if seen { vec![detection(pose)] } else { vec![] }, stamp_ns);
    }
    let status = if seen { PoseStatus::Ok } else { PoseStatus::NotSeen };
    let poses: Vec<ObjectPose> = tracker.predict(stamp_ns).iter().map(|p| refined(p, pose, status)).collect();
    tracker.learn(&poses, stamp_ns);
    searched
}

#[test]
fn a_detection_is_confirmed_then_tracked_then_lost_then_found_again_under_its_number() {
    let mut tracker = tracker(1);
    assert_eq!(status(&tracker), (TrackPhase::Searching as u32, TrackReason::NotFound as u32));
    frame(&mut tracker, 0, at(0.0, 0.5), true);
    assert_eq!(status(&tracker), (TrackPhase::Searching as u32, TrackReason::Detected as u32));
    frame(&mut tracker, 1, at(0.0, 0.5), true);
    assert_eq!(status(&tracker), (TrackPhase::Tracking as u32, TrackReason::Confirmed as u32));
    // Two bad frames are forgiven, the third is not.
    frame(&mut tracker, 2, at(0.0, 0.5), false);
    frame(&mut tracker, 3, at(0.0, 0.5), false);
    assert_eq!(status(&tracker), (TrackPhase::Tracking as u32, TrackReason::NotSeen as u32));
    frame(&mut tracker, 4, at(0.0, 0.5), false);
    assert_eq!(status(&tracker), (TrackPhase::Lost as u32, TrackReason::NotSeen as u32));
    assert!(tracker.predict(5 * STEP_NS).is_empty(), "nothing is predicted for what is lost");
    for index in 5..35 {
        assert!(frame(&mut tracker, index, at(0.0, 0.5), false), "all is lost: each image is searched");
    }
    frame(&mut tracker, 35, at(0.3, 1.5), true);
    frame(&mut tracker, 36, at(0.3, 1.5), true);
    assert_eq!(status(&tracker), (TrackPhase::Tracking as u32, TrackReason::Confirmed as u32));
    assert_eq!(tracker.predict(37 * STEP_NS)[0].instance, 0);
}

#[test]
fn predictions_follow_a_constant_velocity() {
    let mut tracker = tracker(1);
    tracker.config.velocity_gain = 1.0;
    let moving = |i: i64| at(0.01 * i as f64, 0.02 * i as f64);
    for i in 0..6 {
        frame(&mut tracker, i, moving(i), true);
    }
    let predicted = &tracker.predict(6 * STEP_NS)[0];
    assert!(predicted.tracked);
    // The turn bends the path in the object's frame a little.
    let away_m = (predicted.camera_from_object.translation.vector - moving(6).translation.vector).norm();
    assert!(away_m < 5e-4, "{away_m}");
    assert!(rotation_angle_rad(&predicted.camera_from_object, &moving(6)) < 1e-6);
    // After a long gap it is where it was.
    let later = &tracker.predict(6 * STEP_NS + 2_000_000_000)[0];
    assert!((later.camera_from_object.translation.vector - moving(5).translation.vector).norm() < 1e-12);
}

#[test]
fn jumps_and_weak_poses_are_bad_frames() {
    let mut tracker = tracker(1);
    for i in 0..3 {
        frame(&mut tracker, i, at(0.0, 0.5), true);
    }
    let predicted = tracker.predict(3 * STEP_NS);
    tracker.learn(&[refined(&predicted[0], at(0.3, 0.5), PoseStatus::Ok)], 3 * STEP_NS);
    assert_eq!(status(&tracker), (TrackPhase::Tracking as u32, TrackReason::Jumped as u32));
    let weak = ObjectPose { score: 0.1, ..refined(&predicted[0], at(0.0, 0.5), PoseStatus::Ok) };
    tracker.learn(&[weak], 4 * STEP_NS);
    assert_eq!(status(&tracker), (TrackPhase::Tracking as u32, TrackReason::NotSeen as u32));
    tracker.learn(&[refined(&predicted[0], at(0.0, 0.5), PoseStatus::NotVisible)], 5 * STEP_NS);
    assert_eq!(status(&tracker), (TrackPhase::Lost as u32, TrackReason::LeftImage as u32));
}

#[test]
fn a_detection_that_is_not_confirmed_gets_a_second_look_from_its_refinement_and_no_third() {
    let mut tracker = tracker(1);
    let others = vec![Hypothesis { camera_from_object: at(0.0, 2.0), score: 0.5 }];
    tracker.found(&[Detection { others, ..detection(at(0.0, 0.5)) }], 0);
    let predicted = tracker.predict(0);
    assert!(!predicted[0].tracked);
    let better = at(0.02, 0.6);
    tracker.learn(&[refined(&predicted[0], better, PoseStatus::NotSeen)], 0);
    let again = tracker.predict(STEP_NS);
    assert!((again[0].camera_from_object.inverse() * better).to_homogeneous().is_identity(1e-9), "{again:?}");
    assert_eq!((again[0].tracked, again[0].others.len()), (false, 0));
    assert_eq!(status(&tracker), (TrackPhase::Searching as u32, TrackReason::NotSeen as u32));
    tracker.learn(&[refined(&again[0], better, PoseStatus::NotSeen)], STEP_NS);
    assert!(tracker.predict(2 * STEP_NS).is_empty());
    assert_eq!(status(&tracker), (TrackPhase::Searching as u32, TrackReason::NotSeen as u32));
}

#[test]
fn one_bad_frame_before_it_is_confirmed_is_forgiven() {
    let mut tracker = tracker(1);
    frame(&mut tracker, 0, at(0.0, 0.5), true);
    let predicted = tracker.predict(STEP_NS);
    tracker.learn(&[refined(&predicted[0], at(0.1, 0.9), PoseStatus::NotSeen)], STEP_NS);
    let next = tracker.predict(2 * STEP_NS).remove(0);
    assert!((next.camera_from_object.translation.vector - at(0.0, 0.5).translation.vector).norm() < 1e-9, "{next:?}");
    for i in 2..4 {
        frame(&mut tracker, i, at(0.0, 0.5), true);
    }
    assert_eq!(status(&tracker), (TrackPhase::Tracking as u32, TrackReason::Confirmed as u32));
}

#[test]
fn searches_are_rare_while_something_is_tracked() {
    let mut tracker = tracker(1);
    // Four of the five objects are never there.
    let searches = (0..42).filter(|i| frame(&mut tracker, *i, at(0.0, 0.5), true)).count();
    assert!((8..=10).contains(&searches), "{searches}");
}

#[test]
fn two_instances_keep_their_numbers_and_one_place_has_one_track() {
    let mut tracker = tracker(2);
    let [left, right] = [at(-0.2, 0.5), at(0.2, 0.5)];
    tracker.found(&[detection(left), detection(right)], 0);
    for i in 0..8 {
        let poses: Vec<ObjectPose> = tracker
            .predict(i * STEP_NS)
            .iter()
            .map(|p| refined(p, if p.instance == 0 { left } else { right }, PoseStatus::Ok))
            .collect();
        assert_eq!(poses.len(), 2);
        tracker.learn(&poses, i * STEP_NS);
    }
    // The second slides onto the first.
    for i in 8..30 {
        let slid = at(0.2 - 0.02 * (i - 7) as f64, 0.5);
        let poses: Vec<ObjectPose> = tracker
            .predict(i * STEP_NS)
            .iter()
            .map(|p| refined(p, if p.instance == 0 { left } else { slid }, PoseStatus::Ok))
            .collect();
        tracker.learn(&poses, i * STEP_NS);
    }
    let kept = tracker.predict(30 * STEP_NS);
    assert_eq!(kept.len(), 1);
    let dropped = tracker.statuses().into_iter().find(|s| s.object_id == MUSTARD && s.instance != kept[0].instance);
    assert_eq!(dropped.unwrap().reason, TrackReason::Duplicate as u32);
}

#[test]
fn a_new_track_carries_its_other_poses_until_one_of_them_was_chosen() {
    let mut tracker = tracker(1);
    let others = vec![Hypothesis { camera_from_object: at(0.0, 2.0), score: 0.5 }];
    tracker.found(&[Detection { others: others.clone(), ..detection(at(0.0, 0.5)) }], 0);
    let predicted = tracker.predict(0).remove(0);
    assert_eq!((predicted.tracked, &predicted.others), (false, &others));
    tracker.learn(&[refined(&predicted, at(0.0, 2.0), PoseStatus::Ok)], 0);
    let next = tracker.predict(STEP_NS).remove(0);
    assert_eq!((next.tracked, next.others), (true, vec![]));
    assert!(rotation_angle_rad(&next.camera_from_object, &at(0.0, 2.0)) < 1e-9, "it goes on from the chosen one");
}

#[test]
fn a_doubtful_track_gets_another_chance_where_it_is_detected() {
    let mut tracker = tracker(1);
    for i in 0..3 {
        frame(&mut tracker, i, at(0.0, 0.5), true);
    }
    let predicted = tracker.predict(3 * STEP_NS);
    tracker.learn(&[refined(&predicted[0], at(0.0, 0.5), PoseStatus::NotSeen)], 3 * STEP_NS);
    // Further off than a jump may be, and turned further.
    let there = at(0.3, 2.5);
    tracker.found(&[detection(there)], 4 * STEP_NS);
    let predicted = tracker.predict(4 * STEP_NS);
    assert_eq!((predicted[0].instance, predicted[0].camera_from_object), (0, there));
    let [expected] = predicted[0].others[..] else { panic!("{predicted:?}") };
    assert!((expected.camera_from_object.translation.vector - at(0.0, 0.5).translation.vector).norm() < 1e-9);
    tracker.learn(&[refined(&predicted[0], there, PoseStatus::Ok)], 4 * STEP_NS);
    assert_eq!(status(&tracker), (TrackPhase::Tracking as u32, TrackReason::Confirmed as u32));
    let next = &tracker.predict(5 * STEP_NS)[0];
    assert!(next.tracked && next.others.is_empty(), "{next:?}");
    assert!((next.camera_from_object.translation.vector - there.translation.vector).norm() < 1e-9);
}

#[test]
fn an_object_is_expected_where_its_track_goes_and_not_elsewhere() {
    let mut tracker = tracker(1);
    for i in 0..3 {
        frame(&mut tracker, i, at(0.0, 0.5), true);
    }
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/objects/tabletop");
    let objects = ObjectSet::load(&folder).unwrap();
    let camera = Intrinsics { fx: 600.0, fy: 600.0, cx: 320.0, cy: 240.0 };
    let seen = |id: u32, pose: &Pose| extent(objects.get(id).unwrap(), pose, &camera).unwrap();
    let expects =
        |id: u32, pose: &Pose| tracker.expects(objects.get(id).unwrap(), &seen(id, pose), &camera, 3 * STEP_NS);
    assert!(expects(MUSTARD, &at(0.01, 0.5)));
    assert!(!expects(MUSTARD, &at(0.3, 0.5)), "elsewhere");
    assert!(!expects(1, &at(0.0, 0.5)), "another object");
}
