//! A spotted box before a busy wall, rendered: its truth is known.

use crate::history::Sighting;
use crate::measure::{Measurer, Subject};
use crate::testing::spotted;
use crate::texture::{Maker, Pyramid};
use crate::track::Track;
use crate::{Correction, CorrectionKind, Frame, FrameProblem, KnownObject, Phase, Step, Tracker, TrackingConfig};
use nalgebra::{Vector3, Vector6};
use pseudoflow_contour::{ContourModel, Image, ModelSettings, retract};
use pseudoflow_geometry::{Intrinsics, Pose, rotation_angle_rad};
use pseudoflow_imaging::raster::{Background, Headlight, Item, Rendering, Scene, Scratch, render_scene};
use pseudoflow_imaging::shapes::cuboid;
use pseudoflow_imaging::{Mesh, RgbImage};
use std::sync::{Arc, OnceLock};

pub(crate) const K: Intrinsics = Intrinsics { fx: 500.0, fy: 500.0, cx: 159.5, cy: 119.5 };
const DIAMETER_M: f64 = 0.15;

pub(crate) fn object() -> &'static KnownObject {
    static OBJECT: OnceLock<KnownObject> = OnceLock::new();
    OBJECT.get_or_init(|| {
        let mesh = spotted(&cuboid([0.11, 0.08, 0.06], [9; 3]).unwrap());
        let contour = ContourModel::new(&mesh, &ModelSettings { divisions: 2, ..ModelSettings::default() }).unwrap();
        KnownObject { id: 4, mesh: Arc::new(mesh), contour, diameter_m: DIAMETER_M }
    })
}

/// Where the box is in a frame: it moves and turns as a hand would move it.
pub(crate) fn truth(frame: u64) -> Pose {
    let t = frame as f64 / 30.0;
    Pose::new(Vector3::new(0.03 * (2.0 * t).sin(), 0.02 * t, 0.5 + 0.03 * t), Vector3::new(0.5 + 0.3 * t, 0.4 * t, 0.2))
}

/// The frame; `hidden` puts a grey card before all but the left third of the image.
pub(crate) fn picture(frame: u64, hidden: bool) -> RgbImage {
    let wall = RgbImage::from_fn(320, 240, |x, y| {
        let v = (40 + (x / 9 * 37 + y / 7 * 53) % 60) as u8;
        [v, v / 2 + 60, 150 - v].into()
    });
    let scene = Scene {
        items: &[Item { mesh: &object().mesh, camera_from_object: truth(frame) }],
        intrinsics: K,
        width: 320,
        height: 240,
        background: Background::Image(&wall),
    };
    let mut out = Rendering::new(320, 240);
    render_scene(&scene, &Headlight::default(), &mut Scratch::default(), &mut out);
    if hidden {
        out.rgb.enumerate_pixels_mut().filter(|(x, ..)| *x > 60).for_each(|(_, _, p)| *p = [200, 190, 90].into());
    }
    out.rgb
}

pub(crate) fn step(tracker: &mut Tracker, index: u64, rgb: &RgbImage, corrections: &[Correction]) -> Step {
    let stamp_ns = 1_000_000_000 + index as i64 * 33_333_333;
    tracker.step(&Frame { index, stamp_ns, rgb, intrinsics: K }, corrections)
}

/// What a search finds in a frame: a rough pose.
pub(crate) fn found(frame: u64) -> Correction {
    let off = Vector6::new(0.003, -0.002, 0.008, 0.04, -0.05, 0.03);
    let camera_from_object = retract(&truth(frame), &off);
    Correction { object_id: 4, frame, camera_from_object, kind: CorrectionKind::Found }
}

pub(crate) fn started(frames: u64) -> Tracker {
    let mut tracker = Tracker::new(vec![object().clone()], TrackingConfig::default()).unwrap();
    for i in 0..frames {
        step(&mut tracker, i, &picture(i, false), &if i == 0 { vec![found(0)] } else { Vec::new() });
    }
    tracker
}

#[test]
fn a_moved_object_is_followed_from_a_rough_pose() {
    let mut tracker = started(20);
    assert!(tracker.missing().is_empty());
    let seen = step(&mut tracker, 20, &picture(20, false), &[]);
    let pose = seen.estimates[0].camera_from_object;
    assert!((pose.translation.vector - truth(20).translation.vector).norm() < 0.05 * DIAMETER_M, "{pose}");
    assert!(rotation_angle_rad(&pose, &truth(20)) < 0.04, "{}", rotation_angle_rad(&pose, &truth(20)));
    assert!(seen.estimates[0].measured && seen.estimates[0].confidence > 0.5, "{:?}", seen.estimates[0]);
}

/// All three half turns of a box have its silhouette; its contour alone stays with the wrong one.
#[test]
fn what_was_found_back_to_front_is_turned_round() {
    for turn in [Vector3::x(), Vector3::y(), Vector3::z()] {
        let mut tracker = Tracker::new(vec![object().clone()], TrackingConfig::default()).unwrap();
        let wrong =
            Correction { camera_from_object: truth(0) * Pose::rotation(turn * std::f64::consts::PI), ..found(0) };
        for i in 0..30 {
            step(&mut tracker, i, &picture(i, false), &if i == 0 { vec![wrong] } else { Vec::new() });
        }
        let angle = rotation_angle_rad(&tracker.tracks[0].pose, &truth(29));
        assert!(angle < 0.06 && tracker.tracks[0].measured, "half a turn about {turn}: {angle} rad off");
    }
}

#[test]
fn what_is_hidden_is_held_and_lost_after_a_while() {
    let mut tracker = started(12);
    let mut spread = 0.0;
    for i in 12..20 {
        let hidden = step(&mut tracker, i, &picture(i, true), &[]);
        let e = &hidden.estimates[0];
        assert!(!e.measured && e.phase == Phase::Tracking, "frame {i}: {e:?}");
        assert!(e.covariance[0] > spread, "frame {i}: it becomes less sure");
        spread = e.covariance[0];
    }
    let back = step(&mut tracker, 20, &picture(20, false), &[]);
    assert!(back.estimates[0].measured, "{:?}", back.estimates[0]);
    for i in 21..40 {
        step(&mut tracker, i, &picture(i, true), &[]);
    }
    assert_eq!(tracker.missing(), [4]);
}

#[test]
fn what_was_found_earlier_is_carried_to_the_present() {
    let tracker = started(15);
    let before = tracker.tracks[0].pose;
    let carried = tracker.carried(0, &Sighting { frame: 9, pose: truth(9) }, &[before], &K);
    assert!((carried.translation.vector - truth(14).translation.vector).norm() < 0.03 * DIAMETER_M);
}

#[test]
fn what_is_not_seen_is_carried_as_the_scene_moved() {
    let mut tracker = started(15);
    // A second object, believed to be where it was, that has not been seen since.
    let lost = Track { known: true, measured: false, phase: Phase::Lost, ..tracker.tracks[0].clone() };
    tracker.tracks.push(lost);
    let (now, still) = (tracker.tracks[0].pose, tracker.tracks[0].history.at(9).unwrap().pose);
    let beside = Pose::translation(0.1, 0.0, 0.0);
    let carried = tracker.carried(1, &Sighting { frame: 9, pose: still * beside }, &[now, still], &K);
    assert!((carried.inverse() * (now * beside)).translation.vector.norm() < 1e-6, "{carried}");
}

#[test]
fn the_same_frames_and_corrections_give_the_same_bits() {
    let run = || {
        let mut tracker = started(8);
        let seen = step(&mut tracker, 8, &picture(8, false), &[found(5)]);
        (seen.estimates[0].clone(), tracker.ask())
    };
    assert_eq!(run(), run());
}

#[test]
fn frames_that_show_nothing_change_nothing() {
    let mut tracker = started(10);
    let black = step(&mut tracker, 10, &RgbImage::new(320, 240), &[]);
    assert_eq!(black.problem, Some(FrameProblem::Dark));
    assert!(!black.estimates[0].measured);
    let late = step(&mut tracker, 7, &picture(7, false), &[]);
    assert_eq!((late.problem, late.estimates.len()), (Some(FrameProblem::OutOfOrder), 0));
    let next = step(&mut tracker, 11, &picture(11, false), &[]);
    assert!(next.problem.is_none() && next.estimates[0].measured);
}

#[test]
fn a_jump_in_time_and_another_camera_are_survived() {
    let mut tracker = started(10);
    let picture = picture(10, false);
    let far = Frame { index: 10, stamp_ns: 900_000_000_000, rgb: &picture, intrinsics: K };
    assert!(tracker.step(&far, &[]).estimates[0].measured, "after a long pause");
    let back = Frame { index: 11, stamp_ns: 2_000_000_000, ..far };
    let seen = tracker.step(&back, &[]);
    assert!(seen.problem.is_none() && seen.estimates[0].measured, "time began anew");
    let crop = pseudoflow_geometry::Crop { x0: -0.5, y0: -40.5, side: 320.0, size_px: 160 };
    let half = pseudoflow_imaging::resample(&picture, &crop);
    let intrinsics = crop.intrinsics(&K);
    let other = Frame { index: 12, stamp_ns: 2_033_000_000, rgb: &half, intrinsics };
    let seen = tracker.step(&other, &[]);
    let pose = seen.estimates[0].camera_from_object;
    assert!((pose.translation.vector - truth(10).translation.vector).norm() < 0.1 * DIAMETER_M, "{pose}");
    assert!(tracker.tracks[0].keyframes.len() <= 1, "textures of the other camera are gone");
}

/// What a look says of a frame's true pose.
fn look(frame: u64, accepted: bool, score: f64) -> Correction {
    let camera_from_object = truth(frame);
    Correction { object_id: 4, frame, camera_from_object, kind: CorrectionKind::Look { accepted, score } }
}

/// A tracker whose looks are answered follows a box that was found in its first frame; the box is spotted in the picture.
fn waiting_for_looks(mesh: Mesh, frames: u64) -> Tracker {
    let known = KnownObject { mesh: Arc::new(mesh), ..object().clone() };
    let mut tracker = Tracker::new(vec![known], TrackingConfig::default()).unwrap();
    tracker.expect_looks();
    for i in 0..frames {
        step(&mut tracker, i, &picture(i, false), &if i == 0 { vec![found(0)] } else { Vec::new() });
    }
    tracker
}

#[test]
fn where_looks_are_answered_what_one_confirms_becomes_a_track() {
    let plain = cuboid([0.11, 0.08, 0.06], [9; 3]).unwrap();
    let mut tracker = waiting_for_looks(plain, 12);
    assert_eq!(tracker.tracks[0].phase, Phase::Searching, "its contour alone is not believed");
    let seen = step(&mut tracker, 12, &picture(12, false), &[look(11, true, 0.9)]);
    assert_eq!(seen.estimates[0].phase, Phase::Tracking);
}

#[test]
fn what_looks_as_its_mesh_does_waits_for_no_look() {
    assert_eq!(waiting_for_looks(Mesh::clone(&object().mesh), 12).tracks[0].phase, Phase::Tracking);
}

#[test]
fn looks_that_speak_against_a_track_end_it_unless_it_is_sure_itself() {
    let after_two = |confidence: f64| {
        let mut tracker = started(12);
        for i in 12..14 {
            assert!(tracker.missing().is_empty(), "one may be wrong");
            tracker.tracks[0].confidence = confidence;
            step(&mut tracker, i, &picture(i, false), &[look(i - 1, false, 0.1)]);
        }
        tracker.missing()
    };
    assert_eq!(after_two(0.6), [4], "nothing is known of it any more");
    assert!(after_two(0.95).is_empty());
}

#[test]
fn looks_at_what_is_hidden_say_nothing() {
    let mut tracker = started(12);
    for i in 12..16 {
        let seen = step(&mut tracker, i, &picture(i, true), &[look(i - 1, false, 0.1)]);
        // The first of them is of a frame that showed it.
        assert_eq!(seen.estimates[0].phase, Phase::Tracking, "frame {i}");
    }
}

#[test]
fn all_poses_that_something_was_found_at_are_looked_at_but_no_two_alike() {
    let mut tracker = Tracker::new(vec![object().clone()], TrackingConfig::default()).unwrap();
    tracker.expect_looks();
    let turned = |by: f64| {
        let off = Vector6::new(0.0, 0.0, 0.0, 0.0, by, 0.0);
        Correction { camera_from_object: retract(&truth(0), &off), ..found(0) }
    };
    step(&mut tracker, 0, &picture(0, false), &[turned(0.0), turned(0.1), turned(1.2), turned(-1.2)]);
    let asked = (1..4).find_map(|i| {
        let looks = tracker.ask();
        step(&mut tracker, i, &picture(i, false), &[]);
        (!looks.is_empty()).then_some(looks)
    });
    assert_eq!(asked.map(|looks| looks.len()), Some(3), "where the contour has led it, and as it was found elsewhere");
}

#[test]
fn a_look_that_moves_it_far_makes_a_track_when_it_is_very_sure_or_a_second_agrees() {
    let phases = |score: f64| {
        let mut tracker = Tracker::new(vec![object().clone()], TrackingConfig::default()).unwrap();
        tracker.expect_looks();
        let off = Vector6::new(0.0, 0.0, 0.0, 0.0, 1.5, 0.0);
        let rough = Correction { camera_from_object: retract(&truth(0), &off), ..found(0) };
        for i in 0..8 {
            step(&mut tracker, i, &picture(i, false), &if i == 0 { vec![rough] } else { Vec::new() });
            tracker.tracks[0].pose = retract(&truth(i), &off);
        }
        let first = step(&mut tracker, 8, &picture(8, false), &[look(7, true, score)]).estimates[0].phase;
        for i in 9..14 {
            step(&mut tracker, i, &picture(i, false), &[]);
        }
        let second = step(&mut tracker, 14, &picture(14, false), &[look(13, true, score)]).estimates[0].phase;
        (first, tracker.tracks[0].verified, second)
    };
    assert_eq!(phases(0.8), (Phase::Searching, true, Phase::Tracking));
    assert!(phases(0.95).1);
}

#[test]
fn a_tracker_needs_an_object() {
    assert!(Tracker::new(Vec::new(), TrackingConfig::default()).is_err());
}

#[test]
fn the_mesh_itself_puts_a_wrong_turn_right_that_was_learnt() {
    let rgb = picture(0, false);
    let pyramid = Pyramid::new(&rgb);
    let object = object();
    let anchored = |start: &Pose| {
        let item = Item { mesh: &object.mesh, camera_from_object: *start };
        let keyframe = Maker::default().rendered(&pyramid, &[item], &K).unwrap();
        let image = Image { rgb: &rgb, intrinsics: K };
        let subject = Subject { image, object, hiders: &[], pyramid: &pyramid, gap_s: 0.5 };
        Measurer::new(&TrackingConfig::default()).unwrap().anchored(&subject, start, &keyframe)
    };
    let turned = truth(0) * Pose::rotation(Vector3::new(0.12, 0.08, 0.0));
    let righted = anchored(&turned).expect("more of the mesh agrees elsewhere");
    let error_deg = |pose: &Pose| rotation_angle_rad(pose, &truth(0)).to_degrees();
    assert!(error_deg(&righted) < 0.3 * error_deg(&turned), "{} of {}", error_deg(&righted), error_deg(&turned));
    assert!(anchored(&truth(0)).is_none(), "nothing to be put right");
}
