use super::*;
use nalgebra::{Point2, Point3};
use pseudoflow_geometry::Intrinsics;
use std::path::{Path, PathBuf};

/// A models/ folder with one cuboid and one coloured pyramid, written to `folder`.
pub(crate) fn write_objects(folder: &Path) -> PathBuf {
    let info = r#"{"1": {"diameter": 150.0, "min_x": -50, "min_y": -50, "min_z": -25, "size_x": 100, "size_y": 100, "size_z": 50},
        "4": {"diameter": 100.0, "min_x": -40, "min_y": -30, "min_z": 0, "size_x": 80, "size_y": 60, "size_z": 60}}"#;
    std::fs::write(folder.join("models_info.json"), info).unwrap();
    let corner = |i: i32| format!("{} {} {}", 50 * (2 * (i & 1) - 1), 50 * ((i & 2) - 1), 25 * ((i & 4) / 2 - 1));
    let cube: Vec<String> =
        (0..8).map(|i| format!("{} {} {} {}", corner(i), 30 * i + 20, 200 - 20 * i, 90 + 11 * i)).collect();
    let cube_faces = ["0 2 3 1", "4 5 7 6", "0 1 5 4", "2 6 7 3", "0 4 6 2", "1 3 7 5"];
    write_ply(&folder.join("obj_000001.ply"), &cube, &cube_faces.map(|f| format!("4 {f}")));
    let pyramid =
        ["-40 -30 0 250 30 30", "40 -30 0 30 250 30", "40 30 0 30 30 250", "-40 30 0 250 250 30", "0 0 60 240 240 240"];
    let faces = ["4 0 3 2 1", "3 0 1 4", "3 1 2 4", "3 2 3 4", "3 3 0 4"];
    write_ply(&folder.join("obj_000004.ply"), &pyramid.map(String::from), &faces.map(String::from));
    folder.to_owned()
}

fn write_ply(path: &Path, vertices: &[String], faces: &[String]) {
    let header = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\n\
         property uchar green\nproperty uchar blue\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n",
        vertices.len(),
        faces.len()
    );
    std::fs::write(path, header + &vertices.join("\n") + "\n" + &faces.join("\n") + "\n").unwrap();
}

fn generator(config: SynthConfig, seed: u64) -> SampleGenerator {
    let folder = tempfile::tempdir().unwrap();
    let objects = ObjectSet::load(&write_objects(folder.path())).unwrap();
    SampleGenerator::new(Arc::new(objects), config, seed).unwrap()
}

#[test]
fn a_sample_depends_on_seed_and_index_not_on_threads() {
    let generator = generator(SynthConfig::default(), 11);
    let together = generator.batch(5, 6, 64).unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let alone = pool.install(|| generator.batch(5, 6, 64).unwrap());
    assert_eq!(together, alone);
    assert_eq!(generator.sample(7, 64).unwrap(), together[2]);
    assert_ne!(together[0].real_like, together[1].real_like);
}

#[test]
fn without_jitter_the_flow_is_zero_and_the_object_visible() {
    let still = JitterConfig { weight: 1.0, angle_deg: 0.0, xy_diameters: 0.0, z_diameters: 0.0 };
    let config = SynthConfig { jitter: vec![still], occluded: 0.0, truncated: 0.0, ..SynthConfig::default() };
    for sample in generator(config, 3).batch(0, 6, 64).unwrap() {
        assert!(sample.label.flow_px.iter().flatten().all(|d| d.abs() < 1e-3));
        assert!(sample.label.visible_px() > 200);
    }
}

/// The label says: the surface point under a reference pixel is seen at pixel + flow. Here both are followed to the
/// object's frame by another way: the point at pixel + flow is found by intersecting its ray with the reference
/// point's depth in the true pose.
#[test]
fn pixel_plus_flow_shows_the_same_point_of_the_object() {
    let generator = generator(SynthConfig::default(), 5);
    let mut checked = 0;
    for sample in generator.batch(0, 8, 96).unwrap() {
        let object = generator.objects.get(sample.object_id).unwrap();
        let k = Intrinsics { fx: 600.0, fy: 600.0, cx: 320.0, cy: 240.0 };
        // Any camera will do: the relation between K' and the poses is what is tested.
        let mut rng = stream(1, sample.object_id.into());
        let placement = Placement {
            intrinsics: k,
            truth_camera_from_object: Pose::translation(0.0, 0.0, 0.8) * sample.truth_camera_from_object.rotation,
            reference_camera_from_object: Pose::translation(0.004, 0.003, 0.83)
                * pseudoflow_geometry::Jitter { angle_rad: 0.1, max_angle_rad: 0.3, xy_m: 0.0, z_m: 0.0 }
                    .sample(&Pose::from_parts(Default::default(), sample.truth_camera_from_object.rotation), &mut rng),
            crop: Crop { x0: 250.0, y0: 170.0, side: 140.0, size_px: 96 },
        };
        let window = Window::of_crop(&placement.crop, &k, [640, 480]);
        let reference = render_reference(object, &placement);
        let config = SynthConfig { occluded: 0.0, ..SynthConfig::default() };
        let scene = SyntheticScene::draw(&mut rng, &generator.objects, object, &placement, &config).unwrap();
        let label =
            SyntheticFlow::of(&reference, &scene.render(&window).visible, &placement, &window, object.diameter_m);
        let k_crop = placement.crop.intrinsics(&k);
        for index in (0..96 * 96).filter(|&i| label.visible[i]).step_by(37) {
            let at = Point2::new((index % 96) as f64, (index / 96) as f64);
            let in_reference = k_crop.unproject(&at, f64::from(reference.depth_m[index]));
            let in_object: Point3<f64> = placement.reference_camera_from_object.inverse() * in_reference;
            let in_truth = placement.truth_camera_from_object * in_object;
            let [dx, dy] = label.flow_px[index].map(f64::from);
            // Through the whole image instead of the crop's K'.
            let expected = placement.crop.crop_from_image(&k.project(&in_truth).unwrap());
            assert!((expected - (at + nalgebra::Vector2::new(dx, dy))).norm() < 1e-3);
            checked += 1;
        }
    }
    assert!(checked > 100, "{checked}");
}

#[test]
fn what_an_occluder_hides_is_not_visible() {
    let free = generator(SynthConfig { occluded: 0.0, ..SynthConfig::default() }, 21);
    let hidden = generator(SynthConfig { occluded: 1.0, visible_min: 0.0, ..SynthConfig::default() }, 21);
    let share = |generator: &SampleGenerator| {
        let samples = generator.batch(0, 24, 64).unwrap();
        samples.iter().map(|s| s.label.visible_px()).sum::<usize>()
    };
    let (free, hidden) = (share(&free), share(&hidden));
    assert!(hidden * 20 < free * 19, "{hidden} of {free}");
}

#[test]
fn a_bad_range_is_named() {
    let config = SynthConfig { truncated: 1.5, ..SynthConfig::default() };
    let message = config.check().unwrap_err().to_string();
    assert!(message.contains("synth.truncated"), "{message}");
    assert!(serde_json::from_str::<SynthConfig>(r#"{"focal": 3}"#).is_err());
}
