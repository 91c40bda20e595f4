use super::verdict::Yardstick;
use super::*;
use nalgebra::{Point3, Vector3};
use pseudoflow_geometry::{Pose, quaternion_xyzw};
use pseudoflow_metrics::ModelPoints;
use std::collections::BTreeMap;

fn model() -> Yardstick {
    let points = [Point3::new(0.05, 0.0, 0.0), Point3::new(-0.05, 0.0, 0.0), Point3::new(0.0, 0.03, 0.02)];
    Yardstick { points: ModelPoints::new(&points).unwrap(), diameter_m: 0.1, symmetric: false }
}

fn arrival(index: u64, age_ms: f64, off_m: Option<f64>) -> Arrival {
    let pose = |off: f64| ArrivedPose {
        object_id: 3,
        instance: 0,
        published: true,
        predicted: false,
        score: 0.9,
        rotation_xyzw: quaternion_xyzw(&Pose::identity()),
        translation_m: [off, 0.0, 1.0],
    };
    let poses = off_m.map(pose).into_iter().collect();
    Arrival { index, stamp_ns: 0, age_ms, scene_id: 1, image_id: index as u32, poses, tracks: BTreeMap::new() }
}

/// Ten frames at 10 Hz: frame 0 answered without a pose, 1 right but late, 2 dropped, 3 within a tenth, 4 wrong; 5 to 7
/// hidden, 8 missing, 9 right.
fn report() -> LiveReport {
    let mut expectation = Expectation::default();
    for frame in 0..10 {
        let visible = if (5..8).contains(&frame) { 0.0 } else { 1.0 };
        expectation.insert(frame, 3, Pose::new(Vector3::z(), Vector3::zeros()).into(), visible);
    }
    let run = LiveRun {
        hz: 10.0,
        frames: (0..10).map(|i| (1, i)).collect(),
        arrivals: vec![
            arrival(0, 10.0, None),
            arrival(1, 150.0, Some(0.001)),
            arrival(3, 20.0, Some(0.007)),
            arrival(4, 20.0, Some(0.05)),
            arrival(8, 20.0, None),
            arrival(9, 40.0, Some(0.0)),
        ],
        nodes: vec![("pnp".into(), NodeCost { cpu_ms_per_frame: 30.0, ..NodeCost::default() })],
        ..LiveRun::default()
    };
    let (names, models) = (BTreeMap::from([(3, "thing".to_owned())]), BTreeMap::from([(3, model())]));
    LiveReport::of(&run, &names, &models, Some(&expectation)).unwrap()
}

#[test]
fn what_is_missing_is_wrong_and_what_is_hidden_does_not_count() {
    let report = report();
    let Recall { n, all, answered, .. } = report.recall_10.unwrap();
    assert_eq!((n, all, answered), (7, 3.0 / 7.0, Some(0.5)));
    assert!((report.recall_5.unwrap().all - 2.0 / 7.0).abs() < 1e-12);
    assert_eq!(report.objects["thing"].timeline, "mgdyr---mg");
}

#[test]
fn times_count_from_when_a_frame_was_due() {
    let report = report();
    let thing = &report.objects["thing"];
    // Frame 1 is due at 0.1 s.
    assert!((report.steady_from_s.unwrap() - 0.25).abs() < 1e-9);
    assert!((thing.first_pose_s.right_s.unwrap() - 0.25).abs() < 1e-9);
    // Visible from frame 8, right with frame 9 after 40 ms.
    let again = thing.reacquired_s[0];
    assert_eq!((again.hidden_from, again.visible_from), (5, 8));
    assert!((again.seconds.unwrap() - 0.14).abs() < 1e-9);
    // Steady: frames 3, 4, 8 and 9 are visible; 8 has no pose.
    assert!((report.on_time.unwrap() - 0.75).abs() < 1e-12);
    assert!((report.published_per_s["thing"] - 3.0 / 0.75).abs() < 1e-9);
    assert_eq!(report.latency_ms.unwrap().max, 40.0);
    assert!((report.cores_used - 0.3).abs() < 1e-12);
}

#[test]
fn a_report_is_written_as_json_page_and_table() {
    let dir = tempfile::tempdir().unwrap();
    let report = report();
    report.write_json(&dir.path().join("report.json")).unwrap();
    report.write_html(&dir.path().join("report.html")).unwrap();
    let json: serde_json::Value =
        serde_json::from_slice(&std::fs::read(dir.path().join("report.json")).unwrap()).unwrap();
    assert_eq!(json["add_s_recall_0.1d"]["n"], 7);
    assert_eq!(json["nodes"][0][0], "pnp");
    let page = std::fs::read_to_string(dir.path().join("report.html")).unwrap();
    assert!(page.contains("<rect") && page.contains("thing"));
}

#[test]
fn nothing_that_came_is_no_error() {
    let run = LiveRun { hz: 30.0, frames: vec![(1, 0); 5], ..LiveRun::default() };
    let names = BTreeMap::from([(3, "thing".to_owned())]);
    let report = LiveReport::of(&run, &names, &BTreeMap::from([(3, model())]), None).unwrap();
    assert!(report.recall_10.is_none() && report.latency_ms.is_none() && report.on_time.is_none());
    assert_eq!(report.objects["thing"].timeline, "-----");
}
