//! The region stage on rendered pictures whose truth is known.

use nalgebra::{Vector3, Vector6};
use pseudoflow_contour::{
    ContourModel, Image, ModelSettings, PriorConfig, Refiner, Region, RegionConfig, RegionStatus, Task, retract,
};
use pseudoflow_geometry::{Intrinsics, Pose};
use pseudoflow_imaging::raster::{Background, Headlight, Item, Rendering, Scene, Scratch, render_scene};
use pseudoflow_imaging::shapes::{cuboid, sphere};
use pseudoflow_imaging::{Mesh, MeshParts, RgbImage};
use rand::{Rng, SeedableRng, rngs::StdRng};
use std::path::Path;
use std::sync::OnceLock;

const K: Intrinsics = Intrinsics { fx: 500.0, fy: 500.0, cx: 159.5, cy: 119.5 };
const SIZE: (u32, u32) = (320, 240);
const DIAMETER_M: f64 = 0.15;

/// A plain thing without symmetry: a block with a smaller one and a ball on it.
fn thing() -> Mesh {
    let block = cuboid([0.1, 0.06, 0.05], [190, 150, 60]).unwrap();
    let arm = cuboid([0.025, 0.03, 0.09], [190, 150, 60]).unwrap();
    let ball = sphere(0.024, 16, [190, 150, 60]).unwrap();
    joined(&[(&block, [0.0, 0.0, 0.0]), (&arm, [0.034, 0.01, 0.03]), (&ball, [-0.03, -0.036, 0.01])], 1.0)
}

fn joined(parts: &[(&Mesh, [f32; 3])], scale: f32) -> Mesh {
    let mut all = MeshParts::default();
    for (mesh, shift) in parts {
        let first = all.vertices_m.len() as u32;
        all.vertices_m.extend(mesh.vertices_m.iter().map(|v| [0, 1, 2].map(|k| scale * (v[k] + shift[k]))));
        all.colours.extend_from_slice(&mesh.colours);
        all.triangles.extend(mesh.triangles.iter().map(|t| t.map(|i| first + i)));
    }
    Mesh::new(all, Path::new("(thing)")).unwrap()
}

fn model() -> &'static ContourModel {
    static MODEL: OnceLock<ContourModel> = OnceLock::new();
    MODEL.get_or_init(|| ContourModel::new(&thing(), &ModelSettings::default()).unwrap())
}

/// Patches of many colours.
fn busy(seed: u64) -> RgbImage {
    let mut rng = StdRng::seed_from_u64(seed);
    let mut image = RgbImage::from_raw(SIZE.0, SIZE.1, [120, 125, 130].repeat((SIZE.0 * SIZE.1) as usize)).unwrap();
    for _ in 0..160 {
        let colour: [u8; 3] = [rng.random_range(0..150), rng.random(), rng.random()];
        let (x0, y0) = (rng.random_range(0..SIZE.0), rng.random_range(0..SIZE.1));
        let (w, h) = (rng.random_range(5..60), rng.random_range(5..60));
        for y in y0..(y0 + h).min(SIZE.1) {
            for x in x0..(x0 + w).min(SIZE.0) {
                image.get_pixel_mut(x, y).0 = colour;
            }
        }
    }
    image
}

/// The thing before a background, each pixel the mean of 3 x 3 samples, with noise.
fn photograph(pose: &Pose, background: &RgbImage, seed: u64) -> RgbImage {
    const S: u32 = 3;
    let s = f64::from(S);
    let intrinsics = Intrinsics { fx: s * K.fx, fy: s * K.fy, cx: s * K.cx + 1.0, cy: s * K.cy + 1.0 };
    let large = RgbImage::from_fn(S * SIZE.0, S * SIZE.1, |x, y| *background.get_pixel(x / S, y / S));
    let mesh = thing();
    let scene = Scene {
        items: &[Item { mesh: &mesh, camera_from_object: *pose }],
        intrinsics,
        width: S * SIZE.0,
        height: S * SIZE.1,
        background: Background::Image(&large),
    };
    let mut out = Rendering::new(scene.width, scene.height);
    render_scene(&scene, &Headlight::default(), &mut Scratch::default(), &mut out);
    let mut rng = StdRng::seed_from_u64(seed);
    let mut image = RgbImage::new(SIZE.0, SIZE.1);
    for (x, y, pixel) in image.enumerate_pixels_mut() {
        for c in 0..3 {
            let samples = (0..S * S).map(|i| u32::from(out.rgb.get_pixel(S * x + i % S, S * y + i / S)[c]));
            let mean = samples.sum::<u32>() as f64 / f64::from(S * S);
            pixel[c] = (mean + rng.random_range(-6.0..6.0)).clamp(0.0, 255.0) as u8;
        }
    }
    image
}

fn truth() -> Pose {
    Pose::new(Vector3::new(0.01, -0.005, 0.75), Vector3::new(0.7, -0.5, 0.3))
}

fn refine(image: &RgbImage, rough: &Pose) -> Region {
    refine_by(RegionConfig::default(), image, rough)
}

fn refine_by(config: RegionConfig, image: &RgbImage, rough: &Pose) -> Region {
    let mut refiner = Refiner::new(config).unwrap();
    let prior = refiner.prior(rough, model(), DIAMETER_M);
    let task = Task { image: Image { rgb: image, intrinsics: K }, model: model(), prior: &prior, hiders: &[] };
    refiner.refine(&task, &[*rough], None)
}

/// Turn (degrees), shift across (diameters), shift along the axis (share of the distance).
fn errors(found: &Pose) -> [f64; 3] {
    let shift = found.translation.vector - truth().translation.vector;
    let turn = found.rotation.angle_to(&truth().rotation).to_degrees();
    [turn, shift.x.hypot(shift.y) / DIAMETER_M, shift.z.abs() / truth().translation.z]
}

/// 15 degrees about some axis, 5 % of the diameter in x and y, 10 % in z.
fn rough(i: usize) -> Pose {
    let axis = [Vector3::new(1.0, 0.3, -0.2), Vector3::new(-0.4, 1.0, 0.5), Vector3::new(0.2, -0.6, -1.0)][i % 3];
    let turn = axis.normalize() * 15_f64.to_radians();
    let sign = [1.0, -1.0, -1.0, 1.0][i % 4];
    let shift = Vector3::new(0.05 * sign, -0.05, 0.1 * sign) * DIAMETER_M;
    retract(&truth(), &Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z))
}

#[test]
fn a_plain_thing_before_a_busy_background_is_found() {
    // One degree is the aim; 0.5 to 1.9 are reached (translation: 0.3 % across, 0.5 % along).
    // What the contour finds by itself: with the usual prior a start 15 degrees off holds the pose back by a degree or two.
    let prior = PriorConfig { rotation_deg: 40.0, xy: 0.2, z: 0.5, ..PriorConfig::default() };
    for i in 0..6 {
        let config = RegionConfig { prior: prior.clone(), ..RegionConfig::default() };
        let found = refine_by(config, &photograph(&truth(), &busy(i as u64), 9), &rough(i));
        let [turn, across, along] = errors(&found.camera_from_object);
        assert!(found.status.is_ok(), "{i}: {}", found.status);
        assert!(turn < 2.0 && across < 0.01 && along < 0.01, "{i}: {turn} {across} {along}");
    }
}

#[test]
fn from_the_truth_it_stays() {
    for i in 0..3 {
        let found = refine(&photograph(&truth(), &busy(20 + i), i), &truth());
        let [turn, across, along] = errors(&found.camera_from_object);
        assert!(turn < 1.2 && across < 0.005 && along < 0.004, "{i}: {turn} {across} {along}");
    }
}

#[test]
fn a_background_of_the_thing_s_own_colour_on_one_side_is_survived() {
    let mut background = busy(3);
    for (x, _, pixel) in background.enumerate_pixels_mut() {
        if x < 135 {
            pixel.0 = [150, 118, 47];
        }
    }
    let found = refine(&photograph(&truth(), &background, 4), &truth());
    let [turn, across, along] = errors(&found.camera_from_object);
    assert!(turn < 3.0 && across < 0.02 && along < 0.01, "{turn} {across} {along}");
}

#[test]
fn what_cannot_be_seen_has_a_status_and_keeps_the_rough_pose() {
    let image = photograph(&truth(), &busy(1), 1);
    let kept = |found: &Region, rough: &Pose| assert_eq!(found.camera_from_object, *rough, "{}", found.status);

    let plain = RgbImage::from_raw(SIZE.0, SIZE.1, vec![90; (SIZE.0 * SIZE.1 * 3) as usize]).unwrap();
    let found = refine(&plain, &rough(0));
    assert!(matches!(found.status, RegionStatus::OneColour { .. }), "{}", found.status);
    kept(&found, &rough(0));

    let mut near = truth();
    near.translation.vector = Vector3::new(0.0, 0.0, 0.11);
    let found = refine(&image, &near);
    assert!(matches!(found.status, RegionStatus::NoContour { .. }), "{}", found.status);
    kept(&found, &near);

    for z in [-0.7, 0.01] {
        let mut behind = truth();
        behind.translation.z = z;
        assert_eq!(refine(&image, &behind).status, RegionStatus::NotInView);
    }
    let mut aside = truth();
    aside.translation.x = 2.0;
    assert_eq!(refine(&image, &aside).status, RegionStatus::NotInView);

    let mut broken = truth();
    broken.translation.y = f64::NAN;
    assert_eq!(refine(&image, &broken).status, RegionStatus::NotFinite);
}

#[test]
fn a_mesh_in_millimetres_is_not_in_view() {
    let huge = joined(&[(&thing(), [0.0; 3])], 1000.0);
    let model = ContourModel::new(&huge, &ModelSettings { divisions: 1, ..ModelSettings::default() }).unwrap();
    let image = photograph(&truth(), &busy(1), 1);
    let mut refiner = Refiner::new(RegionConfig::default()).unwrap();
    let prior = refiner.prior(&truth(), &model, 1000.0 * DIAMETER_M);
    let task = Task { image: Image { rgb: &image, intrinsics: K }, model: &model, prior: &prior, hiders: &[] };
    assert_eq!(refiner.refine(&task, &[truth()], None).status, RegionStatus::NotInView);
}

#[test]
fn inner_surfaces_holes_and_turned_faces_leave_the_contour() {
    let settings = ModelSettings { divisions: 1, ..ModelSettings::default() };
    let ball = sphere(0.05, 24, [9; 3]).unwrap();
    let inner = sphere(0.03, 12, [9; 3]).unwrap();
    let mut damaged = joined(&[(&ball, [0.0; 3]), (&inner, [0.0; 3])], 1.0);
    damaged.triangles.iter_mut().step_by(3).for_each(|t| t.swap(0, 1));
    damaged.triangles.remove(40);
    damaged.closed = false;
    let (good, bad) = (ContourModel::new(&ball, &settings).unwrap(), ContourModel::new(&damaged, &settings).unwrap());
    for turn in 0..8 {
        let pose = Pose::new(Vector3::new(0.0, 0.0, 0.5), Vector3::new(0.3, 0.8, -0.2) * f64::from(turn));
        let radius = |m: &ContourModel| {
            let points = m.view(&pose);
            let norm = |p: [f32; 3]| p.iter().map(|v| v * v).sum::<f32>().sqrt();
            points.iter().map(|p| norm(p.position_m)).sum::<f32>() / points.len() as f32
        };
        assert!((radius(&good) / radius(&bad) - 1.0).abs() < 0.01, "{} {}", radius(&good), radius(&bad));
    }
}
