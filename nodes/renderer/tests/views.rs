//! Where the views of an instance lie.

use pseudoflow_geometry::{Intrinsics, Pose, pose_from_quaternion};
use pseudoflow_imaging::ObjectSet;
use pseudoflow_msgs::{ObjectPose, PoseStatus};
use pseudoflow_renderer::{Plan, ViewSettings, plan};
use pseudoflow_runtime::Context;
use std::path::Path;

const CAMERA: Intrinsics = Intrinsics { fx: 600.0, fy: 600.0, cx: 320.0, cy: 240.0 };
const SETTINGS: ViewSettings = ViewSettings { size_px: 64, views: 5, margin: 1.1 };

fn at(object_id: u32, x_m: f64, z_m: f64) -> ObjectPose {
    ObjectPose {
        object_id,
        status: PoseStatus::Ok as u32,
        rotation_xyzw: [0.0, 0.0, 0.0, 1.0],
        translation_m: [x_m, 0.0, z_m],
        ..bytemuck::Zeroable::zeroed()
    }
}

fn planned(initial: &[ObjectPose], around: &[ObjectPose]) -> Plan {
    let objects =
        ObjectSet::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/objects/tabletop")).unwrap();
    let context = Context { name: "renderer".into(), seed: 1, out_dir: "/".into(), restarts: 0, replay: true };
    plan(initial, around, &objects, &CAMERA, (640, 480), &SETTINGS, &mut context.rng(0, "views")).unwrap()
}

fn mean_x_m(poses: &[Pose]) -> f64 {
    poses.iter().map(|pose| pose.translation.x).sum::<f64>() / poses.len() as f64
}

#[test]
fn better_poses_move_the_further_views_and_nothing_else() {
    let initial = [at(5, 0.0, 0.8), at(7, 0.1, 0.8)];
    // Of object 7 nothing better is known.
    let (plain, moved) = (planned(&initial, &[]), planned(&initial, &[at(5, 0.05, 0.8)]));
    for (plain, moved) in plain.instances.iter().zip(&moved.instances) {
        assert_eq!(plain.crop, moved.crop);
        assert_eq!(plain.poses[0], moved.poses[0]);
        let first = &moved.initial;
        assert_eq!(moved.poses[0], pose_from_quaternion(&first.rotation_xyzw, &first.translation_m).unwrap());
    }
    // The jitter is the same, only its centre moves.
    let shift = mean_x_m(&moved.instances[0].poses[1..]) - mean_x_m(&plain.instances[0].poses[1..]);
    assert!((shift - 0.05).abs() < 1e-9, "{shift}");
    assert_eq!(plain.instances[1].poses, moved.instances[1].poses);
}
