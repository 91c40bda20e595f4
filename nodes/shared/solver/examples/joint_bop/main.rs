//! Joint refinement on a BOP folder with rough poses and truth, flow from files: `joint_bop DATA_DIR SPLIT FLOW_DIR [every=N] [key=value ... -- ...]`.
//! Without flow files it writes crops and renderings there for a network to be run on. For research only.
#![allow(clippy::print_stdout)]

use pseudoflow_contour::{ContourModel, Hider, Image, ModelSettings, load_or_make};
use pseudoflow_geometry::{Crop, Intrinsics, Pose};
use pseudoflow_imaging::raster::{Rasteriser, SoftwareRasteriser, View};
use pseudoflow_imaging::resample;
use pseudoflow_imaging::{BopScene, ObjectSet, RgbImage, list_scenes};
use pseudoflow_metrics::{MatrixPose, ModelPoints, SceneTruth, add_m, adi_m};
use pseudoflow_solver::{FlowEvidence, FlowField, JointConfig, JointSolver, JointTask, PixelBuffer, PnpConfig};
use std::collections::BTreeMap;
use std::path::Path;
use std::rc::Rc;
use std::time::Instant;

/// One instance with its truth.
pub(crate) struct Case {
    pub(crate) image: Rc<RgbImage>,
    pub(crate) intrinsics: Intrinsics,
    pub(crate) object_id: u32,
    pub(crate) rough: Pose,
    pub(crate) truth: MatrixPose,
    pub(crate) visible: f64,
}

pub(crate) type Failure = Box<dyn std::error::Error>;

fn bop_cases(dir: &Path, split: &str, every: usize) -> Result<Vec<Case>, Failure> {
    let mut cases = Vec::new();
    for scene_dir in list_scenes(&dir.join(split))? {
        let truth_dir = match split {
            "train" => dir.join("train_truth").join(scene_dir.file_name().ok_or("scene")?),
            _ => scene_dir.clone(),
        };
        let truth = SceneTruth::read(&truth_dir)?;
        for frame in BopScene::open(&scene_dir)?.frames.iter().step_by(every) {
            let Some(true_poses) = truth.images.get(&frame.image_id) else { continue };
            let image = Rc::new(frame.load_image()?);
            let mut near: Vec<_> = frame.initial_poses.iter().collect();
            near.sort_by(|a, b| a.camera_from_object.translation.z.total_cmp(&b.camera_from_object.translation.z));
            for rough in near {
                let Some(t) = true_poses.iter().find(|t| t.object_id == rough.object_id) else { continue };
                if t.visible_fraction.is_some_and(|v| v < 0.1) {
                    continue;
                }
                cases.push(Case {
                    image: Rc::clone(&image),
                    intrinsics: frame.intrinsics,
                    object_id: rough.object_id,
                    rough: rough.camera_from_object,
                    truth: t.camera_from_object,
                    visible: t.visible_fraction.unwrap_or(1.0),
                });
            }
        }
    }
    Ok(cases)
}

const SIZE: u32 = 256;

struct Row {
    object: u32,
    before: [f64; 4],
    after: [f64; 4],
    from_truth: [f64; 4],
    oracle_z: bool,
    score: f64,
    visible: f64,
}

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().collect();
    let (dir, split) = (Path::new(&args[1]), &args[2]);
    let (mut every, mut divisions, mut size_px, mut distance, mut per_object) = (1_usize, 3, 160, 5.0, false);
    let mut truth_start = true;
    let mut occlusion = true;
    let mut mode = "joint".to_owned();
    let (mut count, mut seed, mut blur, mut occluded) = (200, 1, 0.8, false);
    let mut variants = Vec::new();
    let mut common = serde_json::to_value(JointConfig::default())?;
    for variant in args[4..].split(|a| a == "--") {
        let mut json = common.clone();
        for pair in variant {
            let (key, value) = pair.split_once('=').ok_or("key=value")?;
            match key {
                "every" => every = value.parse()?,
                "divisions" => divisions = value.parse()?,
                "size_px" => size_px = value.parse()?,
                "distance" => distance = value.parse()?,
                "per_object" => per_object = value.parse()?,
                "count" => count = value.parse()?,
                "seed" => seed = value.parse()?,
                "blur" => blur = value.parse()?,
                "occluded" => occluded = value.parse()?,
                "mode" => mode = value.to_owned(),
                "occlusion" => occlusion = value.parse()?,
                "truth_start" => truth_start = value.parse()?,
                _ => {
                    let place = key.split('.').fold(&mut json, |at, part| &mut at[part]);
                    *place = serde_json::from_str(value)?;
                }
            }
        }
        match variants.is_empty()
            && args.iter().any(|a| a == "--")
            && common == serde_json::to_value(JointConfig::default())?
        {
            true => common = json.clone(),
            false => {}
        }
        variants.push((variant.join(" "), json));
    }
    let set = ObjectSet::load(&dir.join("models"))?;
    let settings = ModelSettings { divisions, size_px, distance, ..ModelSettings::default() };
    let start = Instant::now();
    let models: BTreeMap<u32, (ContourModel, ModelPoints)> = set
        .iter()
        .map(|o| {
            Ok((
                o.id,
                (
                    load_or_make(&o.mesh, &settings, Path::new("/tmp/contour_models"))?,
                    ModelPoints::new(&o.mesh.points())?,
                ),
            ))
        })
        .collect::<Result<_, Failure>>()?;
    let built = start.elapsed().as_secs_f64();
    let cases = match split.as_str() {
        _ => bop_cases(dir, split, every)?,
    };
    let mut rasteriser = SoftwareRasteriser::new();
    for o in set.iter() {
        rasteriser.add_object(o.id, &o.mesh)?;
    }
    let folder = Path::new(&args[3]);
    let mut prepared = Vec::new();
    for (i, case) in cases.iter().enumerate() {
        let object = set.get(case.object_id)?;
        let crop = Crop::around(&object.hull_m, &case.rough, &case.intrinsics, 1.1, SIZE).ok_or("crop")?;
        let k = crop.intrinsics(&case.intrinsics);
        let view =
            View { object_id: object.id, camera_from_object: case.rough, intrinsics: k, width: SIZE, height: SIZE };
        let rendering = rasteriser.render(&[view])?.remove(0);
        let path = folder.join(format!("{i:04}.flow"));
        let flow: Vec<f32> = match std::fs::read(&path) {
            Ok(bytes) => bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect(),
            Err(_) => {
                let mut bytes = rendering.rgb.as_raw().clone();
                bytes.extend(resample(&case.image, &crop).as_raw());
                std::fs::write(folder.join(format!("{i:04}.pair")), bytes)?;
                continue;
            }
        };
        prepared.push((k, rendering, flow));
    }
    if prepared.len() < cases.len() {
        println!("wrote pairs");
        return Ok(());
    }
    for (name, json) in variants {
        let config: JointConfig = serde_json::from_value(json)?;
        let mut solver = JointSolver::new(config, PnpConfig::default())?;
        let mut buffer = PixelBuffer::new();
        let mut flow_only = 0;
        let mut distances: Vec<f64> = Vec::new();
        println!("{name}");
        let (mut rows, mut spent, mut failed) = (Vec::new(), 0.0, 0);
        let mut refined: Vec<Option<Pose>> = vec![None; cases.len()];
        for (number, (case, (k, rendering, flow))) in cases.iter().zip(&prepared).enumerate() {
            let (object, (model, points)) = (set.get(case.object_id)?, &models[&case.object_id]);
            let truth: MatrixPose = case.truth;
            let true_pose = truth.pose();
            let image = Image { rgb: &case.image, intrinsics: case.intrinsics };
            let errors = |pose: &Pose| {
                let est: MatrixPose = (*pose).into();
                let e = match object.symmetries.is_trivial() {
                    true => add_m(points, &est, &truth),
                    false => adi_m(points, &est, &truth),
                };
                let dz = (pose * object.box_centre_m()).z - (true_pose * object.box_centre_m()).z;
                [
                    e / object.diameter_m,
                    pose.rotation.angle_to(&true_pose.rotation).to_degrees(),
                    dz / object.diameter_m,
                    f64::from(u8::from(e < 0.1 * object.diameter_m)),
                ]
            };
            let hiders: Vec<Hider<'_>> = cases
                .iter()
                .enumerate()
                .filter(|(i, c)| Rc::ptr_eq(&c.image, &case.image) && *i != number)
                .map(|(i, c)| Hider {
                    model: &models[&c.object_id].0,
                    camera_from_object: refined[i].unwrap_or(c.rough),
                })
                .collect();
            let hiders = if occlusion { hiders } else { Vec::new() };
            let begin = cpu_s();
            let field = FlowField {
                size_px: SIZE as usize,
                depth_m: &rendering.depth_m,
                mask: &rendering.mask,
                flow_px: flow,
                certainty: None,
                intrinsics: *k,
                camera_from_object: case.rough,
            };
            let correspondences = buffer.fill(&field, usize::MAX)?;
            let flow =
                (mode != "region").then_some(FlowEvidence { correspondences, intrinsics: *k, size_px: SIZE as usize });
            let (model, diameter_m, hiders) = (model, object.diameter_m, &hiders[..]);
            let mut task = JointTask { image, model, diameter_m, rough: case.rough, hiders, flow };
            let joint = solver.solve(&task, 1);
            let pnp = joint.pnp.as_ref().map_or(case.rough, |p| p.camera_from_object);
            flow_only += usize::from(errors(&pnp)[3] > 0.0);
            if object.symmetries.is_trivial() {
                let c = nalgebra::Matrix6::from_row_slice(&joint.covariance);
                let turn = (true_pose.rotation * joint.camera_from_object.rotation.inverse()).scaled_axis();
                let shift = true_pose.translation.vector - joint.camera_from_object.translation.vector;
                let e = nalgebra::Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
                let d2 = e.dot(&(c.try_inverse().unwrap_or_default() * e));
                distances.push(d2);
            }
            let mut found = Some(joint.region);
            if mode == "flow" {
                found = found.map(|f| pseudoflow_contour::Region { camera_from_object: pnp, ..f });
            }
            spent += cpu_s() - begin;
            failed += usize::from(found.is_some_and(|f| !f.status.is_ok()));
            let score = found.map_or(0.0, |f| f.agreement);
            let found = found.map_or(case.rough, |f| f.camera_from_object);
            refined[number] = Some(found);
            let stay = match truth_start {
                true => {
                    task.rough = true_pose;
                    solver.solve(&task, 1).camera_from_object
                }
                false => true_pose,
            };
            let mut with_z = found;
            with_z.translation.vector *= (true_pose * object.box_centre_m()).z / (found * object.box_centre_m()).z;
            rows.push(Row {
                object: case.object_id,
                before: errors(&case.rough),
                after: errors(&found),
                from_truth: errors(&stay),
                oracle_z: errors(&with_z)[3] > 0.0,
                score,
                visible: case.visible,
            });
        }
        let ids: Vec<u32> = if per_object { set.ids() } else { vec![] };
        for id in ids {
            report(&format!("object {id}"), &rows.iter().filter(|r| r.object == id).collect::<Vec<_>>());
        }
        report(
            &format!("{} {split}", dir.file_name().unwrap_or_default().to_string_lossy()),
            &rows.iter().collect::<Vec<_>>(),
        );
        let auc = auc(&rows);
        println!(
            "  flow alone {flow_only}, inside 95 %: {:.3}, median d2 {:.1}; {:.2} ms each, {failed} failed, models in {built:.1} s, score AUC {auc:.3}, visible {:.2}",
            distances.iter().filter(|d| **d < 12.59).count() as f64 / distances.len().max(1) as f64,
            {
                distances.sort_by(f64::total_cmp);
                distances.get(distances.len() / 2).copied().unwrap_or(f64::NAN)
            },
            1e3 * spent / rows.len() as f64,
            rows.iter().map(|r| r.visible).sum::<f64>() / rows.len() as f64
        );
    }
    Ok(())
}

/// CPU time of this thread, seconds (Linux).
fn cpu_s() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|v| v.parse::<f64>().ok()).unwrap_or(0.0) * 1e-9
}

fn auc(rows: &[Row]) -> f64 {
    let (mut good, mut all) = (0.0, 0.0);
    for a in rows.iter().filter(|r| r.after[3] > 0.0) {
        for b in rows.iter().filter(|r| r.after[3] == 0.0) {
            all += 1.0;
            good += if a.score > b.score { 1.0 } else { 0.0 };
        }
    }
    good / all
}

fn report(name: &str, rows: &[&Row]) {
    let n = rows.len().max(1) as f64;
    let share = |f: &dyn Fn(&Row) -> bool| rows.iter().filter(|r| f(r)).count() as f64 / n;
    let median = |f: &dyn Fn(&Row) -> f64| {
        let mut v: Vec<f64> = rows.iter().map(|r| f(r)).collect();
        v.sort_by(f64::total_cmp);
        v.get(v.len() / 2).copied().unwrap_or(f64::NAN)
    };
    let right: Vec<_> = rows.iter().filter(|r| r.before[3] > 0.0).collect();
    let broken = right.iter().filter(|r| r.after[3] == 0.0).count() as f64 / right.len().max(1) as f64;
    println!(
        "{name:18} n {n:4} ADD {:.3} -> {:.3} (broken {:.3}, true z {:.3}) rot {:.1} -> {:.1} |dz| {:.3} -> {:.3} dz {:+.3} | truth: {:.3} rot {:.1} |dz| {:.3} dz {:+.3}",
        share(&|r| r.before[3] > 0.0),
        share(&|r| r.after[3] > 0.0),
        broken,
        share(&|r| r.oracle_z),
        median(&|r| r.before[1]),
        median(&|r| r.after[1]),
        median(&|r| r.before[2].abs()),
        median(&|r| r.after[2].abs()),
        median(&|r| r.after[2]),
        share(&|r| r.from_truth[3] > 0.0),
        median(&|r| r.from_truth[1]),
        median(&|r| r.from_truth[2].abs()),
        median(&|r| r.from_truth[2]),
    );
}
