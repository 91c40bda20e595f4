//! Measures the tracker on a BOP scene with truth, which only this program sees.
//!
//! `cargo run --release --workspace --example track_sequence -- SCENE MODELS [--start truth|rough] [--looks WEIGHTS] [--csv FILE]`
//!
//! `--looks` runs renderer, flow and pnp on what the tracker asks for; their answer comes `--delay` frames later. Files named
//! `*.yaml` after `--pnp` are settings of the pnp node, `--config` takes the tracker's as JSON. `--look-score` is the tracker node's
//! `look_score`. `--search N` gives what is missing its rough pose in every N-th frame, `--delay` frames later. `--turn x|y|z` begins half
//! a turn off, about that axis of each object's box.

#![allow(clippy::print_stdout)] // a measuring program talks to people

use nalgebra::Point3;
use pseudoflow_contour::{ModelSettings, load_or_make};
use pseudoflow_flow::{FlowConfig, FlowNode};
use pseudoflow_geometry::Pose;
use pseudoflow_imaging::{BopScene, ObjectSet};
use pseudoflow_metrics::{MatrixPose, ModelPoints, SceneTruth, add_m, adi_m};
use pseudoflow_msgs::{AlignedBytes, CameraFrame, CameraFrameHeader, FrameKey, ObjectPose, ObjectPoses};
use pseudoflow_pnp::{PnpNode, PnpNodeConfig};
use pseudoflow_renderer::{RendererConfig, RendererNode};
use pseudoflow_runtime::{Context, InMemory, Node};
use pseudoflow_tracker::TrackerNodeConfig;
use pseudoflow_tracking::{
    Correction, CorrectionKind, Estimate, Frame, KnownObject, Look, Tracker, TrackingConfig, half_turn,
};
use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::time::Instant;

struct Arguments {
    scene: PathBuf,
    models: PathBuf,
    truth: PathBuf,
    options: BTreeMap<String, String>,
}

fn arguments() -> Arguments {
    let mut plain = Vec::new();
    let mut options = BTreeMap::new();
    let mut rest = std::env::args().skip(1);
    while let Some(argument) = rest.next() {
        match argument.strip_prefix("--") {
            Some(name) => drop(options.insert(name.to_owned(), rest.next().unwrap_or_default())),
            None => plain.push(PathBuf::from(argument)),
        }
    }
    let truth = options.get("truth").map_or_else(|| plain[0].clone(), PathBuf::from);
    Arguments { scene: plain[0].clone(), models: plain[1].clone(), truth, options }
}

/// CPU time of all threads so far.
fn cpu_ms() -> f64 {
    let threads = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let of = |thread: std::fs::DirEntry| {
        let text = std::fs::read_to_string(thread.path().join("schedstat")).unwrap_or_default();
        text.split(' ').next().and_then(|v| v.parse::<f64>().ok()).unwrap_or(0.0) * 1e-6
    };
    threads.map(of).sum()
}

struct Scored {
    id: u32,
    image: u32,
    visible: f64,
    error_d: f64,
    estimate: Option<Estimate>,
}

fn main() {
    env_logger::init();
    let arguments = arguments();
    let option = |name: &str, default: &str| arguments.options.get(name).cloned().unwrap_or(default.to_owned());
    let set = ObjectSet::load(&arguments.models).unwrap();
    let scene = BopScene::open(&arguments.scene).unwrap();
    let truth = SceneTruth::read(&arguments.truth).unwrap();
    let present: Vec<u32> = truth.images.values().flatten().map(|t| t.object_id).collect();
    let objects: Vec<KnownObject> = set
        .iter()
        .filter(|o| present.contains(&o.id))
        .map(|o| KnownObject {
            id: o.id,
            mesh: o.mesh.clone(),
            contour: load_or_make(&o.mesh, &ModelSettings::default(), Path::new("/tmp/pseudoflow-contours")).unwrap(),
            diameter_m: o.diameter_m,
        })
        .collect();
    let points: BTreeMap<u32, (ModelPoints, bool, f64)> = set
        .iter()
        .map(|o| {
            let points: Vec<Point3<f64>> = o.mesh.points().iter().step_by(8).copied().collect();
            (o.id, (ModelPoints::new(&points).unwrap(), !o.symmetries.is_trivial(), o.diameter_m))
        })
        .collect();
    let config: TrackingConfig = match arguments.options.get("config") {
        Some(json) => serde_json::from_str(json).unwrap(),
        None => TrackingConfig::default(),
    };
    let mut tracker = Tracker::new(objects, config).unwrap();
    let (start, looks, hz) =
        (option("start", "truth"), option("looks", "none"), option("hz", "30").parse::<f64>().unwrap());
    let reset = option("reset", "no") == "yes";
    let mut scored: Vec<Scored> = Vec::new();
    let (mut spent_ms, mut lasted_ms, mut look_ms, mut looks_made, mut frames) = (0.0, 0.0, 0.0, 0, 0);
    let mut network = (looks != "none").then(|| Network::open(&arguments, Path::new(&looks)));
    let delay: usize = option("delay", "3").parse().unwrap();
    let search: usize = option("search", "0").parse().unwrap();
    let verbose = option("verbose", "no") == "yes";
    let mut late: VecDeque<(usize, Vec<Correction>)> = VecDeque::new();
    let mut waiting: Vec<Correction> = Vec::new();
    let true_pose = |t: &MatrixPose| t.pose();
    for (index, frame) in scene.frames.iter().enumerate() {
        let truths = truth.images.get(&frame.image_id).cloned().unwrap_or_default();
        let image = frame.load_image().unwrap();
        let found = |id: u32, pose: Pose, kind| Correction {
            object_id: id,
            frame: index as u64,
            camera_from_object: pose,
            kind,
        };
        let mut corrections: Vec<Correction> = std::mem::take(&mut waiting);
        if index == 0 {
            let from = corrections.len();
            match start.as_str() {
                "truth" => corrections.extend(
                    truths.iter().map(|t| found(t.object_id, true_pose(&t.camera_from_object), CorrectionKind::Found)),
                ),
                _ => corrections.extend(
                    frame.initial_poses.iter().map(|p| found(p.object_id, p.camera_from_object, CorrectionKind::Found)),
                ),
            }
            if let Some(axis) = arguments.options.get("turn") {
                let axis = ["x", "y", "z"].iter().position(|name| name == axis).expect("--turn x, y or z");
                let turn = |id: u32| half_turn(&set.get(id).unwrap().mesh, axis);
                corrections[from..].iter_mut().for_each(|c| c.camera_from_object *= turn(c.object_id));
            }
        }
        let stamp_ns = (f64::from(frame.image_id) / hz * 1e9) as i64 + 1_000_000_000;
        let (before, began) = (cpu_ms(), Instant::now());
        let seen = Frame { index: index as u64, stamp_ns, rgb: &image, intrinsics: frame.intrinsics };
        let estimates = tracker.step(&seen, &corrections).estimates;
        let wanted = tracker.ask();
        spent_ms += cpu_ms() - before;
        lasted_ms += began.elapsed().as_secs_f64() * 1e3;
        frames += 1;
        if search > 0 && index > 0 && index % search == 0 {
            let missing = tracker.missing();
            let poses = frame.initial_poses.iter().filter(|p| missing.contains(&p.object_id));
            let found = poses.map(|p| found(p.object_id, p.camera_from_object, CorrectionKind::Found)).collect();
            late.push_back((index + delay, found));
        }
        if let Some(network) = network.as_mut().filter(|_| !wanted.is_empty()) {
            let before = cpu_ms();
            looks_made += wanted.len();
            let looked = network.look(&seen, &wanted);
            look_ms += cpu_ms() - before;
            for c in &looked {
                if let Some(t) = truths.iter().find(|t| t.object_id == c.object_id) {
                    let (points, _, d) = &points[&c.object_id];
                    let e = |p: &Pose| add_m(points, &matrix(p), &t.camera_from_object) / d;
                    let from =
                        wanted.iter().find(|w| w.object_id == c.object_id).map_or(0.0, |w| e(&w.camera_from_object));
                    if verbose {
                        println!(
                            "look {} object {} {:?}: {from:.3} -> {:.3}",
                            frame.image_id,
                            c.object_id,
                            c.kind,
                            e(&c.camera_from_object)
                        );
                    }
                }
            }
            late.push_back((index + delay, looked));
        }
        while late.front().is_some_and(|(due, _)| *due <= index + 1) {
            waiting.extend(late.pop_front().unwrap().1);
        }
        for t in &truths {
            let estimate = estimates.iter().find(|e| e.object_id == t.object_id).cloned();
            let (points, symmetric, diameter_m) = &points[&t.object_id];
            let adi = *symmetric || option("adi", "").split(',').any(|id| id == t.object_id.to_string());
            let error = estimate.as_ref().map_or(f64::INFINITY, |e| {
                let at = matrix(&e.camera_from_object);
                if adi { adi_m(points, &at, &t.camera_from_object) } else { add_m(points, &at, &t.camera_from_object) }
            });
            let error_d = error / diameter_m;
            if reset && error_d >= 0.1 {
                waiting.push(found(
                    t.object_id,
                    true_pose(&t.camera_from_object),
                    CorrectionKind::Look { accepted: true, score: 1.0 },
                ));
            }
            scored.push(Scored {
                id: t.object_id,
                image: frame.image_id,
                visible: t.visible_fraction.unwrap_or(1.0),
                error_d,
                estimate,
            });
        }
    }
    report(&scored, spent_ms, lasted_ms, frames);
    println!(
        "{looks_made} looks, {:.1} CPU-ms each, {:.1} a frame",
        look_ms / looks_made.max(1) as f64,
        look_ms / frames as f64
    );
    if let Some(path) = arguments.options.get("csv") {
        write(&scored, Path::new(path));
    }
}

/// Renderer, flow and pnp in this process.
struct Network {
    renderer: RendererNode,
    flow: FlowNode,
    pnp: PnpNode,
    context: Context,
    /// Score from which a look says that its pose is right.
    least_score: f64,
}

impl Network {
    fn open(arguments: &Arguments, weights: &Path) -> Self {
        let number = |name: &str, default: u32| arguments.options.get(name).map_or(default, |v| v.parse().unwrap());
        let context =
            Context { name: "look".into(), seed: 1, out_dir: std::env::temp_dir(), restarts: 0, replay: true };
        let size_px = number("size", 128);
        let flow: FlowConfig = serde_yaml::from_str(&format!(
            "{{model: {}, size_px: {size_px}, iterations: {}, engine: {{threads: 1}}}}",
            weights.display(),
            number("iterations", 4)
        ))
        .unwrap();
        let pnp = arguments
            .options
            .get("pnp")
            .map_or_else(PnpNodeConfig::default, |text| serde_yaml::from_str(text).unwrap());
        Self {
            renderer: RendererNode::create(RendererConfig::new(arguments.models.clone(), size_px), &context).unwrap(),
            flow: FlowNode::create(flow, &context).unwrap(),
            pnp: PnpNode::create(pnp, &context).unwrap(),
            context,
            least_score: arguments
                .options
                .get("look-score")
                .map_or_else(|| TrackerNodeConfig::new(arguments.models.clone()).look_score, |v| v.parse().unwrap()),
        }
    }

    fn look(&mut self, frame: &Frame<'_>, wanted: &[Look]) -> Vec<Correction> {
        let key = FrameKey { index: frame.index, stamp_ns: frame.stamp_ns };
        let mut messages = InMemory::new(key);
        let (width, height) = frame.rgb.dimensions();
        let k = frame.intrinsics;
        let header = CameraFrameHeader {
            width,
            height,
            scene_id: 1,
            image_id: frame.index as u32,
            intrinsics: [k.fx, k.fy, k.cx, k.cy],
            frame_id: CameraFrameHeader::frame_id_bytes("camera").unwrap(),
        };
        let mut bytes = AlignedBytes::zeroed(CameraFrame::byte_len(width, height));
        CameraFrame::write(&mut bytes, header).rgb.copy_from_slice(frame.rgb);
        messages.messages.push(("frame".into(), bytes));
        let poses: Vec<ObjectPose> = wanted.iter().map(pseudoflow_tracker::request).collect();
        let mut bytes = AlignedBytes::zeroed(ObjectPoses::byte_len(poses.len()));
        ObjectPoses::write(&mut bytes, 1, frame.index as u32, &poses);
        messages.messages.push(("initial_poses".into(), bytes));
        step(&mut self.renderer, &mut messages, &self.context);
        step(&mut self.flow, &mut messages, &self.context);
        let looks = self.pnp.looks(&messages, &self.context).unwrap();
        looks.iter().filter_map(|l| pseudoflow_tracker::looked(frame.index, &l.pose, self.least_score)).collect()
    }
}

fn step<N: Node>(node: &mut N, messages: &mut InMemory, context: &Context) {
    let mut out = InMemory::new(messages.key.unwrap());
    node.process(messages, &mut out, context).unwrap();
    messages.messages.append(&mut out.messages);
}

fn matrix(pose: &Pose) -> MatrixPose {
    let rotation = pseudoflow_geometry::rotation_row_major(pose);
    MatrixPose::from_row_major(&rotation, &pose.translation.vector.into()).unwrap()
}

fn report(scored: &[Scored], spent_ms: f64, lasted_ms: f64, frames: usize) {
    let share = |keep: &dyn Fn(&Scored) -> bool, limit: f64| {
        let kept: Vec<&Scored> = scored.iter().filter(|s| s.visible >= 0.1 && keep(s)).collect();
        (kept.iter().filter(|s| s.error_d < limit).count() as f64 / kept.len().max(1) as f64, kept.len())
    };
    let line = |name: &str, keep: &dyn Fn(&Scored) -> bool| {
        let ((tenth, n), (twentieth, _)) = (share(keep, 0.1), share(keep, 0.05));
        let measured = |s: &Scored| keep(s) && s.estimate.as_ref().is_some_and(|e| e.measured);
        let (right, m) = share(&measured, 0.1);
        println!("{name:>12}: 0.1d {tenth:.3}  0.05d {twentieth:.3}  of {n}; measured {m}, right of these {right:.3}");
    };
    line("all", &|_| true);
    line("60 % visible", &|s| s.visible >= 0.6);
    let mut ids: Vec<u32> = scored.iter().map(|s| s.id).collect();
    ids.sort_unstable();
    ids.dedup();
    for id in ids {
        line(&format!("object {id}"), &|s| s.id == id);
    }
    let poses = scored.iter().filter(|s| s.estimate.is_some()).count().max(1);
    let (spent_ms, each_ms) = (spent_ms / frames as f64, spent_ms / poses as f64);
    println!("CPU {spent_ms:.2} ms a frame, {each_ms:.2} an object, {:.2} by the clock", lasted_ms / frames as f64);
}

fn write(scored: &[Scored], path: &Path) {
    let mut out = String::from(
        "image,object,visible,error_d,measured,confidence,agreement,lines,overlap,texture,textured,good,likeness,contrast\n",
    );
    for s in scored {
        let Some(e) = &s.estimate else { continue };
        let v = &e.evidence;
        out += &format!(
            "{},{},{:.3},{:.4},{},{:.3},{:.3},{:.3},{:.3},{:.3},{:.3},{},{:.3},{:.3}\n",
            s.image,
            s.id,
            s.visible,
            s.error_d,
            u8::from(e.measured),
            e.confidence,
            v.agreement,
            v.lines,
            v.overlap,
            v.texture,
            v.textured,
            e.good_frames,
            v.likeness,
            v.contrast
        );
    }
    std::fs::write(path, out).unwrap();
}
