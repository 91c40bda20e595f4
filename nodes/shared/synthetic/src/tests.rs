use super::*;
use nalgebra::{Point2, Point3};

/// Of the two objects alone.
fn own_objects() -> SynthConfig {
    SynthConfig { look: LookConfig { procedural: 0.0, ..LookConfig::default() }, ..SynthConfig::default() }
}

fn generator(config: SynthConfig, seed: u64) -> SampleGenerator {
    let folder = tempfile::tempdir().unwrap();
    let objects = ObjectPool::load(&[crate::write_sample_objects(folder.path()).unwrap()]).unwrap();
    SampleGenerator::new(Arc::new(objects), config, seed).unwrap()
}

#[test]
fn a_sample_depends_on_seed_and_index_not_on_threads() {
    let generator = generator(SynthConfig { pairs_per_scene: 3, ..SynthConfig::default() }, 11);
    let together = generator.batch(5, 6, 64).unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let alone = pool.install(|| generator.batch(5, 6, 64).unwrap());
    assert_eq!(together, alone);
    assert_eq!(generator.sample(7, 64).unwrap(), together[2]);
    assert_eq!(generator.scene(2, 64).unwrap()[..], together[1..4]);
    assert_ne!(together[0].real_like, together[1].real_like);
}

#[test]
fn pairs_of_a_scene_share_the_truth_and_differ_in_all_else() {
    let pairs = generator(SynthConfig::default(), 2).scene(4, 64).unwrap();
    assert_eq!(pairs.len(), SynthConfig::default().pairs_per_scene);
    for (a, b) in pairs.iter().zip(&pairs[1..]) {
        assert_eq!(a.truth_camera_from_object, b.truth_camera_from_object);
        assert!(a.reference_camera_from_object != b.reference_camera_from_object && a.real_like != b.real_like);
    }
}

#[test]
fn without_jitter_the_flow_is_zero_and_the_object_visible() {
    let still = JitterConfig::normal(1.0, 0.0, 0.0, 0.0);
    let look = LookConfig { most_neighbours: 0, ..LookConfig::default() };
    let config = SynthConfig { jitter: vec![still], occluded: 0.0, truncated: 0.0, look, ..SynthConfig::default() };
    for sample in generator(config, 3).batch(0, 12, 64).unwrap() {
        assert!(sample.label.flow_px.iter().flatten().all(|d| d.abs() < 1e-3));
        assert!(sample.label.visible_px() > 200);
        // Nothing hides it in front; at its own border a pixel may fall beside it.
        assert!(sample.label.visible_px() * 10 > sample.label.foreground_px() * 8);
    }
}

/// A cuboid and a pyramid without texture, of which points can be traced exactly.
fn first_hit(object: &Object, camera_from_object: &Pose, ray: nalgebra::Vector3<f64>) -> f64 {
    let point = |i: u32| camera_from_object * Point3::from(object.mesh.vertices_m[i as usize].map(f64::from));
    let hit = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(point);
        // Solve z ray = a + s (b - a) + t (c - a).
        let m = nalgebra::Matrix3::from_columns(&[ray, a - b, a - c]);
        let x = m.try_inverse()? * a.coords;
        let inside = x[1] >= -1e-9 && x[2] >= -1e-9 && x[1] + x[2] <= 1.0 + 1e-9;
        (inside && x[0] > 0.0).then_some(x[0])
    };
    object.mesh.triangles.iter().filter_map(hit).fold(f64::MAX, f64::min)
}

/// Flow and visibility against rays through the triangles: a surface point is seen where no triangle is nearer on its ray.
#[test]
fn flow_and_visibility_are_those_of_rays_through_the_mesh() {
    let look = LookConfig { most_neighbours: 0, ..own_objects().look };
    let config = SynthConfig { occluded: 0.0, truncated: 0.0, look, ..SynthConfig::default() };
    let config = SynthConfig { pairs_per_scene: 4, projected_px: [80.0, 120.0], ..config };
    let generator = generator(config, 5);
    let (mut checked, mut off, mut wrong, mut hidden) = (0, 0, 0, 0);
    for sample in generator.batch(0, 12, 64).unwrap() {
        let object = &generator.object(sample.object).unwrap();
        let (k, label) = (&sample.intrinsics, &sample.label);
        for index in (0..64 * 64).filter(|&i| label.foreground[i]).step_by(7) {
            let at = Point2::new((index % 64) as f64, (index / 64) as f64);
            let depth_m = f64::from(label.depth_m[index]);
            let traced_m = first_hit(object, &sample.reference_camera_from_object, k.unproject(&at, 1.0).coords);
            off += usize::from((traced_m - depth_m).abs() > 1e-3 * object.diameter_m);
            let in_object = sample.reference_camera_from_object.inverse() * k.unproject(&at, depth_m);
            let in_truth = sample.truth_camera_from_object * in_object;
            let seen_at = k.project(&in_truth).unwrap();
            let [dx, dy] = label.flow_px[index].map(f64::from);
            assert!((seen_at - (at + nalgebra::Vector2::new(dx, dy))).norm() < 1e-2);
            let first_m = first_hit(object, &sample.truth_camera_from_object, in_truth.coords / in_truth.z);
            let inside = [seen_at.x, seen_at.y].iter().all(|v| (0.0..=63.0).contains(v));
            let visible = inside && in_truth.z - first_m < 0.01 * object.diameter_m;
            (checked, wrong) = (checked + 1, wrong + usize::from(visible != label.visible[index]));
            hidden += usize::from(!visible);
        }
    }
    assert!(off * 100 < checked, "{off} of {checked} depths differ");
    // On edges the samples decide.
    assert!(checked > 500 && hidden > 30 && wrong * 50 < checked, "{wrong} of {checked} wrong, {hidden} hidden");
}

#[test]
fn normals_and_depth_belong_to_the_foreground() {
    for sample in generator(SynthConfig::default(), 8).batch(0, 6, 64).unwrap() {
        let label = &sample.label;
        for i in 0..64 * 64 {
            let length: f32 = label.normals[i].iter().map(|c| c * c).sum();
            assert_eq!(label.foreground[i], label.depth_m[i] > 0.0);
            assert!((length - f32::from(u8::from(label.foreground[i]))).abs() < 1e-3);
        }
    }
}

#[test]
fn what_an_occluder_hides_is_not_visible() {
    let free = generator(SynthConfig { occluded: 0.0, ..SynthConfig::default() }, 21);
    let hidden = generator(SynthConfig { occluded: 1.0, visible_min: 0.0, ..SynthConfig::default() }, 21);
    let share = |generator: &SampleGenerator| {
        let samples = generator.batch(0, 60, 64).unwrap();
        samples.iter().map(|s| s.label.visible_px()).sum::<usize>()
    };
    let (free, hidden) = (share(&free), share(&hidden));
    assert!(hidden * 20 < free * 19, "{hidden} of {free}");
}

#[test]
fn jitter_has_the_stated_spread() {
    let folder = tempfile::tempdir().unwrap();
    let pool = ObjectPool::load(&[crate::write_sample_objects(folder.path()).unwrap()]).unwrap();
    let object = pool.at(0);
    let config = SynthConfig { projected_px: [60.0, 61.0], truncated: 0.0, ..own_objects() };
    let draw = |jitter: JitterConfig| -> Vec<Placement> {
        let of = |i| {
            let mut rng = stream(6, i);
            let stand = Stand::draw(&mut rng, object, &config, 64);
            Placement::draw(&mut rng, object, &stand, &[jitter], &config, 64)
        };
        (0..600).map(of).collect()
    };
    let dz = |p: &Placement| {
        (p.reference_camera_from_object.translation.z - p.truth_camera_from_object.translation.z) / object.diameter_m
    };
    let wide = draw(JitterConfig::uniform(1.0, 90.0, 0.1, 0.5));
    let most = wide.iter().map(Placement::angle_deg).fold(0.0, f64::max);
    let mean = wide.iter().map(Placement::angle_deg).sum::<f64>() / 600.0;
    assert!(most <= 90.0 + 1e-6 && most > 85.0 && (mean - 45.0).abs() < 4.0, "{most} {mean}");
    assert!(wide.iter().all(|p| dz(p).abs() <= 0.5 + 1e-6) && wide.iter().any(|p| dz(p).abs() > 0.45));
    let rough = draw(JitterConfig::normal(1.0, 9.0, 0.0, 0.14));
    let angle = (rough.iter().map(|p| p.angle_deg().powi(2)).sum::<f64>() / 600.0).sqrt();
    let depth = (rough.iter().map(|p| dz(p).powi(2)).sum::<f64>() / 600.0).sqrt();
    assert!((angle / (9.0 * 3.0_f64.sqrt()) - 1.0).abs() < 0.1 && (depth / 0.14 - 1.0).abs() < 0.15, "{angle} {depth}");
}

#[test]
fn a_pool_takes_folders_with_the_same_ids() {
    let (one, two) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let folders = [one.path(), two.path()].map(|folder| crate::write_sample_objects(folder).unwrap());
    let pool = ObjectPool::load(&folders).unwrap();
    assert_eq!(pool.len(), 4);
    assert_eq!(pool.names().iter().collect::<std::collections::BTreeSet<_>>().len(), 4, "{:?}", pool.names());
    assert!(ObjectPool::load(&[]).is_err() && ObjectPool::load(&[one.path().join("none")]).is_err());
}

#[test]
fn a_bad_range_is_named() {
    let config = SynthConfig { truncated: 1.5, ..SynthConfig::default() };
    let message = config.check().unwrap_err().to_string();
    assert!(message.contains("synth.truncated"), "{message}");
    assert!(serde_json::from_str::<SynthConfig>(r#"{"focal": 3}"#).is_err());
}
