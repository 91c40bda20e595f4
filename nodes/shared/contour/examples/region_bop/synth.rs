//! Rendered pictures with known truth: objects of a set before photographs, blurred and noisy.

use crate::{Case, Failure};
use nalgebra::{UnitQuaternion, Vector3};
use pseudoflow_geometry::{Intrinsics, Jitter, Pose, standard_normal};
use pseudoflow_imaging::raster::{Background, Item, Rendering, Scene, Scratch, Studio, render_scene};
use pseudoflow_imaging::{Object, ObjectSet, RgbImage};
use rand::{Rng, SeedableRng, rngs::StdRng};
use std::path::PathBuf;

const SIZE: (u32, u32) = (640, 480);

pub(crate) fn cases(set: &ObjectSet, count: usize, seed: u64, blur: f64, occluded: bool) -> Result<Vec<Case>, Failure> {
    let mut rng = StdRng::seed_from_u64(seed);
    let mut backgrounds: Vec<PathBuf> = std::fs::read_dir("/work/shared/data/pool/backgrounds")?
        .filter_map(|e| e.ok().map(|e| e.path()))
        .filter(|p| p.extension().is_some_and(|e| e == "jpg"))
        .collect();
    backgrounds.sort();
    let objects: Vec<&Object> = set.iter().collect();
    (0..count).map(|_| case(&objects, &backgrounds, blur, occluded, &mut rng)).collect()
}

fn case(
    objects: &[&Object],
    backgrounds: &[PathBuf],
    blur: f64,
    occluded: bool,
    rng: &mut StdRng,
) -> Result<Case, Failure> {
    let object = objects[rng.random_range(0..objects.len())];
    let k = Intrinsics { fx: 572.4, fy: 573.6, cx: 325.3, cy: 242.0 };
    let d = object.diameter_m;
    let z = rng.random_range(3.5..9.0) * d;
    let turn = |rng: &mut StdRng| {
        let q: [f64; 4] = std::array::from_fn(|_| standard_normal(rng));
        UnitQuaternion::new_normalize(nalgebra::Quaternion::from(q))
    };
    let at =
        |rng: &mut StdRng, z: f64| Vector3::new(rng.random_range(-0.25..0.25) * z, rng.random_range(-0.2..0.2) * z, z);
    let place = |object: &Object, centre: Vector3<f64>, r: UnitQuaternion<f64>| {
        Pose::from_parts((centre - r * object.box_centre_m().coords).into(), r)
    };
    let centre = at(rng, z);
    let truth = place(object, centre, turn(rng));
    let mut items = vec![Item { mesh: &*object.mesh, camera_from_object: truth }];
    for _ in 0..rng.random_range(1..4) {
        let other = objects[rng.random_range(0..objects.len())];
        let (behind, spread) = (rng.random_range(1.1..1.5), 1.2 * d);
        let shift = Vector3::new(rng.random_range(-spread..spread), rng.random_range(-spread..spread), 0.0);
        items.push(Item { mesh: &*other.mesh, camera_from_object: place(other, (centre + shift) * behind, turn(rng)) });
    }
    if occluded {
        let other = objects[rng.random_range(0..objects.len())];
        let angle = rng.random_range(0.0..std::f64::consts::TAU);
        let away = rng.random_range(0.35..0.75) * d;
        let front = (centre + Vector3::new(angle.cos() * away, angle.sin() * away, 0.0)) * 0.75;
        items.push(Item { mesh: &*other.mesh, camera_from_object: place(other, front, turn(rng)) });
    }
    let background = pseudoflow_imaging::load_rgb(&backgrounds[rng.random_range(0..backgrounds.len())])?;
    let rgb = photograph(&items, &k, &background, z as f32, blur, rng);
    let jitter = Jitter { angle_rad: 9_f64.to_radians(), max_angle_rad: 1.0, xy_m: 0.03 * d, z_m: 0.14 * d };
    // The noise of rough poses turns about the object's middle.
    let to_middle = Pose::translation(object.box_centre_m().x, object.box_centre_m().y, object.box_centre_m().z);
    let rough = jitter.sample(&(truth * to_middle), rng) * to_middle.inverse();
    Ok(Case { image: rgb.into(), intrinsics: k, object_id: object.id, rough, truth: truth.into(), visible: 1.0 })
}

fn photograph(
    items: &[Item<'_>],
    k: &Intrinsics,
    background: &RgbImage,
    z: f32,
    blur: f64,
    rng: &mut StdRng,
) -> RgbImage {
    const S: u32 = 3;
    let s = f64::from(S);
    let (w, h) = (SIZE.0 * S, SIZE.1 * S);
    // Pixel centres at integers: u' = s u + (s - 1) / 2.
    let large =
        Intrinsics { fx: s * k.fx, fy: s * k.fy, cx: s * k.cx + (s - 1.0) / 2.0, cy: s * k.cy + (s - 1.0) / 2.0 };
    let background =
        RgbImage::from_fn(w, h, |x, y| *background.get_pixel(x * background.width() / w, y * background.height() / h));
    let scene = Scene { items, intrinsics: large, width: w, height: h, background: Background::Image(&background) };
    let studio = Studio::random(items.len(), z, rng);
    let mut out = Rendering::new(w, h);
    render_scene(&scene, &studio, &mut Scratch::default(), &mut out);
    let noise = rng.random_range(2.0..6.0);
    // Box over the S x S samples, then a Gaussian of `blur` pixels.
    let mut plane: Vec<[f32; 3]> = Vec::with_capacity((SIZE.0 * SIZE.1) as usize);
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let mut sum = [0.0; 3];
            for i in 0..S * S {
                let p = out.rgb.get_pixel(x * S + i % S, y * S + i / S);
                (0..3).for_each(|c| sum[c] += f32::from(p[c]) / (S * S) as f32);
            }
            plane.push(sum);
        }
    }
    let weights: Vec<f32> = (-3..=3).map(|i| (-0.5 * (f64::from(i) / blur.max(1e-3)).powi(2)).exp() as f32).collect();
    let total: f32 = weights.iter().sum();
    let (w, h) = (SIZE.0 as i32, SIZE.1 as i32);
    for (dx, dy) in [(1, 0), (0, 1)] {
        let from = plane.clone();
        for y in 0..h {
            for x in 0..w {
                let mut sum = [0.0; 3];
                for (i, weight) in weights.iter().enumerate() {
                    let i = i as i32 - 3;
                    let (u, v) = ((x + i * dx).clamp(0, w - 1), (y + i * dy).clamp(0, h - 1));
                    (0..3).for_each(|c| sum[c] += weight * from[(v * w + u) as usize][c] / total);
                }
                plane[(y * w + x) as usize] = sum;
            }
        }
    }
    let mut bytes = Vec::with_capacity(plane.len() * 3);
    for pixel in plane {
        bytes.extend(pixel.map(|v| (v + noise * standard_normal(rng) as f32 + 0.5).clamp(0.0, 255.0) as u8));
    }
    RgbImage::from_raw(SIZE.0, SIZE.1, bytes).unwrap_or_default()
}
