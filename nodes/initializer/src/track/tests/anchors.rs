//! A camera that moves past things on a table.

use super::*;

const BOX: u32 = 1;
const DRILL: u32 = 3;

/// Objects of the scene that the detector knows, in a room's frame.
const SCENE: [(u32, [f64; 3]); 3] =
    [(BOX, [-0.15, 0.0, 0.9]), (MUSTARD, [0.05, 0.02, 0.8]), (DRILL, [0.2, 0.05, 0.85])];

/// The camera turns and moves sideways; pose of an object at a frame.
fn seen_from(index: i64, at_m: [f64; 3]) -> Pose {
    let moved = 0.012 * index as f64;
    let camera_from_room = Pose::from_parts(
        Translation3::new(-moved, 0.0, 0.3 * moved),
        UnitQuaternion::from_scaled_axis(Vector3::new(0.0, moved, 0.1 * moved)),
    );
    camera_from_room * Pose::from_parts(Translation3::from(Vector3::from(at_m)), UnitQuaternion::identity())
}

/// One frame of the scene, without any detection after the first; `hidden` objects are not seen. Returns where the mustard
/// bottle was expected.
fn scene_frame(tracker: &mut Tracker, index: i64, hidden: &[u32]) -> Option<Predicted> {
    let stamp_ns = index * STEP_NS;
    if tracker.wants_search() {
        let all = SCENE.map(|(object_id, at_m)| Detection { object_id, ..detection(seen_from(index, at_m)) });
        tracker.found(if index == 0 { &all } else { &[] }, stamp_ns);
    }
    let predicted = tracker.predict(stamp_ns);
    let of = |p: &Predicted| {
        let (_, at_m) = SCENE.into_iter().find(|(id, _)| *id == p.object_id).unwrap();
        let status = if hidden.contains(&p.object_id) { PoseStatus::NotSeen } else { PoseStatus::Ok };
        refined(p, seen_from(index, at_m), status)
    };
    tracker.learn(&predicted.iter().map(of).collect::<Vec<_>>(), stamp_ns);
    predicted.into_iter().find(|p| p.object_id == MUSTARD)
}

fn away_m(predicted: &Predicted, index: i64) -> f64 {
    (predicted.camera_from_object.translation.vector - seen_from(index, SCENE[1].1).translation.vector).norm()
}

#[test]
fn a_hidden_object_moves_with_the_others_and_a_lost_one_is_found_where_it_was_left() {
    let mut tracker = tracker(1);
    (0..4).for_each(|i| drop(scene_frame(&mut tracker, i, &[])));
    // Hidden: the frames in which it may be.
    for i in 4..7 {
        let expected = scene_frame(&mut tracker, i, &[MUSTARD]).expect("still tracked");
        assert!(away_m(&expected, i) < 2e-3, "frame {i}: {} m off", away_m(&expected, i));
    }
    assert_eq!(status(&tracker).0, TrackPhase::Lost as u32);
    // Lost: at every search it is looked for where the others say, and dropped again while it is hidden.
    let looks: Vec<Predicted> = (7..20).filter_map(|i| scene_frame(&mut tracker, i, &[MUSTARD])).collect();
    assert!((2..10).contains(&looks.len()), "{} looks", looks.len());
    let back = (20..40).find_map(|i| Some((i, scene_frame(&mut tracker, i, &[])?))).expect("found again");
    assert!(away_m(&back.1, back.0) < 2e-3 && !back.1.tracked, "{back:?}");
    assert!(back.0 <= 26, "frame {}", back.0);
    scene_frame(&mut tracker, back.0 + 1, &[]);
    assert_eq!(status(&tracker), (TrackPhase::Tracking as u32, TrackReason::Confirmed as u32));
}

#[test]
fn one_object_alone_says_nothing_about_another() {
    let mut tracker = tracker(1);
    (0..4).for_each(|i| drop(scene_frame(&mut tracker, i, &[])));
    (4..9).for_each(|i| drop(scene_frame(&mut tracker, i, &[MUSTARD, DRILL])));
    assert!((9..30).all(|i| scene_frame(&mut tracker, i, &[DRILL]).is_none()), "the box may have been moved");
}

#[test]
fn what_is_hidden_has_not_gone_to_where_something_like_it_is_detected() {
    let mut tracker = tracker(1);
    (0..4).for_each(|i| drop(scene_frame(&mut tracker, i, &[])));
    scene_frame(&mut tracker, 4, &[MUSTARD]);
    let elsewhere = Pose::from_parts(Translation3::new(-0.3, 0.1, 0.9), UnitQuaternion::identity());
    tracker.found(&[detection(elsewhere)], 5 * STEP_NS);
    let expected = tracker.predict(5 * STEP_NS).into_iter().find(|p| p.object_id == MUSTARD).unwrap();
    assert!(away_m(&expected, 5) < 2e-3 && expected.others.is_empty(), "{expected:?}");
    // Once it is lost, both places are tried.
    (5..7).for_each(|i| drop(scene_frame(&mut tracker, i, &[MUSTARD])));
    assert_eq!(status(&tracker).0, TrackPhase::Lost as u32);
    tracker.found(&[detection(elsewhere)], 7 * STEP_NS);
    let both = tracker.predict(7 * STEP_NS).into_iter().find(|p| p.object_id == MUSTARD).unwrap();
    assert_eq!((both.camera_from_object, both.others.len()), (elsewhere, 1));
    let left = Predicted { camera_from_object: both.others[0].camera_from_object, ..both };
    assert!(away_m(&left, 7) < 2e-3, "{left:?}");
}

#[test]
fn a_place_that_another_instance_has_taken_is_not_searched_again() {
    let mut tracker = tracker(2);
    let left = |i: i64| [0.0, 0.2 - 0.02 * i.min(10) as f64, 0.8];
    let at_m = |p: &Predicted, i: i64| match (p.object_id, p.instance) {
        (MUSTARD, 0) => [0.0, 0.0, 0.8],
        (MUSTARD, _) => left(i),
        (id, _) => SCENE.into_iter().find(|(known, _)| *known == id).unwrap().1,
    };
    let seen = |object_id: u32, at_m: [f64; 3]| Detection { object_id, ..detection(seen_from(0, at_m)) };
    let all = [(BOX, SCENE[0].1), (DRILL, SCENE[2].1), (MUSTARD, [0.0, 0.0, 0.8]), (MUSTARD, left(0))];
    tracker.found(&all.map(|(id, at_m)| seen(id, at_m)), 0);
    let mut bottles = 0;
    for i in 0..40 {
        if tracker.wants_search() {
            tracker.found(&[], i * STEP_NS);
        }
        let predicted = tracker.predict(i * STEP_NS);
        bottles = predicted.iter().filter(|p| p.object_id == MUSTARD).count();
        assert!(i < 15 || bottles == 1, "{bottles} bottles in frame {i}");
        let poses: Vec<ObjectPose> =
            predicted.iter().map(|p| refined(p, seen_from(i, at_m(p, i)), PoseStatus::Ok)).collect();
        tracker.learn(&poses, i * STEP_NS);
    }
    assert_eq!(bottles, 1);
}
