//! Measures the tracker on a BOP scene with truth, which only this program sees.
//!
//! `cargo run --release --workspace --example track_sequence -- SCENE MODELS [--start truth|rough] [--looks rough] [--csv FILE]`

#![allow(clippy::print_stdout)] // a measuring program talks to people

use nalgebra::Point3;
use pseudoflow_contour::{ModelSettings, load_or_make};
use pseudoflow_geometry::Pose;
use pseudoflow_imaging::{BopScene, ObjectSet};
use pseudoflow_metrics::{MatrixPose, ModelPoints, SceneTruth, add_m, adi_m};
use pseudoflow_tracking::{Correction, CorrectionKind, Estimate, Frame, KnownObject, Tracker, TrackingConfig};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

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

fn cpu_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|v| v.parse::<f64>().ok()).unwrap_or(0.0) * 1e-6
}

struct Scored {
    id: u32,
    image: u32,
    visible: f64,
    error_d: f64,
    estimate: Option<Estimate>,
}

fn main() {
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
    let (mut spent_ms, mut frames) = (0.0, 0);
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
            match start.as_str() {
                "truth" => corrections.extend(
                    truths.iter().map(|t| found(t.object_id, true_pose(&t.camera_from_object), CorrectionKind::Found)),
                ),
                _ => corrections.extend(
                    frame.initial_poses.iter().map(|p| found(p.object_id, p.camera_from_object, CorrectionKind::Found)),
                ),
            }
        }
        let stamp_ns = (f64::from(frame.image_id) / hz * 1e9) as i64 + 1_000_000_000;
        let before = cpu_ms();
        let seen = Frame { index: index as u64, stamp_ns, rgb: &image, intrinsics: frame.intrinsics };
        let estimates = tracker.step(&seen, &corrections).estimates;
        let wanted = tracker.ask();
        spent_ms += cpu_ms() - before;
        frames += 1;
        if looks == "rough" {
            for look in wanted {
                let rough = frame.initial_poses.iter().find(|p| p.object_id == look.object_id);
                waiting.extend(
                    rough.map(|p| found(p.object_id, p.camera_from_object, CorrectionKind::Look { accepted: true })),
                );
            }
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
                    CorrectionKind::Look { accepted: true },
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
    report(&scored, spent_ms, frames);
    if let Some(path) = arguments.options.get("csv") {
        write(&scored, Path::new(path));
    }
}

fn matrix(pose: &Pose) -> MatrixPose {
    let rotation = pseudoflow_geometry::rotation_row_major(pose);
    MatrixPose::from_row_major(&rotation, &pose.translation.vector.into()).unwrap()
}

fn report(scored: &[Scored], spent_ms: f64, frames: usize) {
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
    println!("CPU {:.2} ms a frame, {:.2} an object", spent_ms / frames as f64, spent_ms / poses as f64);
}

fn write(scored: &[Scored], path: &Path) {
    let mut out = String::from(
        "image,object,visible,error_d,measured,confidence,agreement,lines,overlap,texture,textured,good\n",
    );
    for s in scored {
        let Some(e) = &s.estimate else { continue };
        let v = &e.evidence;
        out += &format!(
            "{},{},{:.3},{:.4},{},{:.3},{:.3},{:.3},{:.3},{:.3},{:.3},{}\n",
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
            e.good_frames
        );
    }
    std::fs::write(path, out).unwrap();
}
