#![allow(warnings)]
use nalgebra::*;
use pseudoflow_geometry::{Pose, pose_from_quaternion, rotation_angle_rad};
use pseudoflow_inference::{Backend, EngineConfig};
use pseudoflow_initializer::*;
use pseudoflow_msgs::*;
use pseudoflow_runtime::{Context, InMemory, Node};
use std::path::PathBuf;
fn main() {
    env_logger_off();
    let a: Vec<String> = std::env::args().collect();
    let (scene, models, init, flow, step) = (
        PathBuf::from(&a[1]),
        PathBuf::from(&a[2]),
        PathBuf::from(&a[3]),
        PathBuf::from(&a[4]),
        a[5].parse::<usize>().unwrap(),
    );
    let config = InitializerConfig {
        compare: Some(CompareConfig::new(flow)),
        engine: EngineConfig::default(),
        ..InitializerConfig::new(init, models)
    };
    let context = Context { name: "initializer".into(), seed: 1, out_dir: PathBuf::new(), restarts: 0, replay: true };
    let mut node = InitializerNode::create(config, &context).unwrap();
    let read =
        |n: &str| -> serde_json::Value { serde_json::from_slice(&std::fs::read(scene.join(n)).unwrap()).unwrap() };
    let (gt, cam) = (read("scene_gt.json"), read("scene_camera.json"));
    let mut ids: Vec<u32> = gt.as_object().unwrap().keys().map(|k| k.parse().unwrap()).collect();
    ids.sort();
    for id in ids.iter().step_by(step) {
        let file = ["png", "jpg"].iter().map(|e| scene.join(format!("rgb/{id:06}.{e}"))).find(|p| p.is_file()).unwrap();
        let image = image::open(file).unwrap().to_rgb8();
        let k: Vec<f64> =
            cam[&id.to_string()]["cam_K"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        let header = CameraFrameHeader {
            width: image.width(),
            height: image.height(),
            scene_id: 1,
            image_id: *id,
            intrinsics: [k[0], k[4], k[2], k[5]],
            frame_id: CameraFrameHeader::frame_id_bytes("camera").unwrap(),
        };
        let mut bytes = AlignedBytes::zeroed(CameraFrame::byte_len(image.width(), image.height()));
        CameraFrame::write(&mut bytes, header).rgb.copy_from_slice(image.as_raw());
        let mut inputs = InMemory::new(FrameKey { index: *id as u64, stamp_ns: *id as i64 });
        inputs.messages.push(("frame".into(), bytes));
        let mut outputs = InMemory::default();
        node.process(&inputs, &mut outputs, &context).unwrap();
        let b = &outputs.messages.iter().find(|(n, _)| n == "initial_poses").unwrap().1;
        let poses = ObjectPoses::view(b).unwrap();
        for g in gt[&id.to_string()].as_array().unwrap() {
            let o = g["obj_id"].as_u64().unwrap() as u32;
            let f = |n: &str| -> Vec<f64> { g[n].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect() };
            let r = Rotation3::from_matrix(&Matrix3::from_row_slice(&f("cam_R_m2c")));
            let t = f("cam_t_m2c");
            let truth = Pose::from_parts(
                Translation3::new(t[0] / 1e3, t[1] / 1e3, t[2] / 1e3),
                UnitQuaternion::from_rotation_matrix(&r),
            );
            let mut line = format!("{id} {o}:");
            for p in poses.poses.iter().filter(|p| p.object_id == o) {
                let e = pose_from_quaternion(&p.rotation_xyzw, &p.translation_m).unwrap();
                let px = |v: &Pose| {
                    Vector2::new(k[0] * v.translation.x / v.translation.z, k[4] * v.translation.y / v.translation.z)
                };
                let ax = (truth.rotation.inverse() * e.rotation).scaled_axis().map(|v| v.to_degrees().round());
                line += &format!(
                    " [{:.0}deg z{:+.2} px{:.0} s{:.2}|{} {} {}]",
                    rotation_angle_rad(&e, &truth).to_degrees(),
                    e.translation.z / truth.translation.z - 1.0,
                    (px(&e) - px(&truth)).norm(),
                    p.score,
                    ax.x,
                    ax.y,
                    ax.z
                );
            }
            println!("{line}");
        }
    }
}
fn env_logger_off() {}
