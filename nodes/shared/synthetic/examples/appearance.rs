//! How crops look, in numbers: `appearance synth MODELS[,DIR] [COUNT SIZE SEED [CONFIG.json]]` for synthetic pairs,
//! `appearance bop MODELS SCENE POSES.json [SIZE EVERY]` for photographs whose poses are known (for the comparison alone).
//! Prints the 10th, 50th and 90th percentile over the crops of each number.

use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion};
use pseudoflow_geometry::{Crop, Pose};
use pseudoflow_imaging::raster::{Background, Headlight, Item, Rendering, Scene, Scratch, render_scene};
use pseudoflow_imaging::{BopScene, ObjectSet, RgbImage, load_rgb, resample};
use pseudoflow_synthetic::{ObjectPool, SampleGenerator, SynthConfig};
use std::path::{Path, PathBuf};
use std::sync::Arc;

type Error = Box<dyn std::error::Error>;

fn main() -> Result<(), Error> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let number = |i: usize, default: u64| args.get(i).map_or(Ok(default), |v| v.parse());
    let rows = match args.first().map(String::as_str) {
        Some("synth") if args.len() > 1 => {
            synthetic(&args[1], number(2, 300)?, number(3, 128)?, number(4, 1)?, args.get(5))?
        }
        Some("bop") if args.len() > 3 => photographs(
            Path::new(&args[1]),
            Path::new(&args[2]),
            Path::new(&args[3]),
            number(4, 128)? as u32,
            number(5, 3)?,
        )?,
        _ => return Err("usage: appearance synth MODELS ... | bop MODELS SCENE POSES.json ...".into()),
    };
    print(&rows);
    Ok(())
}

#[allow(clippy::print_stdout)]
fn print(rows: &[Vec<f32>]) {
    println!("{} crops", rows.len());
    for (k, name) in NAMES.iter().enumerate() {
        let mut values: Vec<f32> = rows.iter().map(|r| r[k]).filter(|v| v.is_finite()).collect();
        values.sort_by(f32::total_cmp);
        let at = |q: f32| values.get((q * values.len() as f32) as usize).copied().unwrap_or(f32::NAN);
        println!("{name:28} {:8.3} {:8.3} {:8.3}", at(0.1), at(0.5), at(0.9));
    }
}

const NAMES: [&str; 16] = [
    "noise, luma (of 255)",
    "noise, colour",
    "gradient, object",
    "gradient, background",
    "gradient 2 px / 1 px",
    "gradient 4 px / 1 px",
    "luma, object",
    "luma, background",
    "luma sd, object",
    "luma sd, background",
    "saturation, object",
    "saturation, background",
    "saturation, rendering",
    "object - surroundings, luma",
    "object - surroundings, |rgb|",
    "correlation with rendering",
];

fn synthetic(models: &str, count: u64, size: u64, seed: u64, config: Option<&String>) -> Result<Vec<Vec<f32>>, Error> {
    let folders: Vec<PathBuf> = models.split(',').map(PathBuf::from).collect();
    let pool = Arc::new(ObjectPool::load(&folders)?);
    let config = match config {
        Some(path) => serde_json::from_str(&std::fs::read_to_string(path)?)?,
        None => SynthConfig::default(),
    };
    let backgrounds: Vec<PathBuf> = std::env::var_os("BACKGROUNDS").map(PathBuf::from).into_iter().collect();
    let generator = SampleGenerator::new(pool, config, seed)?.with_backgrounds(&backgrounds, false)?;
    let mut rows = Vec::new();
    for sample in generator.batch(0, count as usize, size as u32)? {
        let object = generator.object(sample.object)?;
        let item = Item { mesh: &object.mesh, camera_from_object: sample.truth_camera_from_object };
        rows.extend(measure(&sample.real_like, &rendering(item, sample.intrinsics, size as u32)));
    }
    Ok(rows)
}

#[derive(serde::Deserialize)]
struct Truth {
    #[serde(rename = "cam_R_m2c")]
    rotation: [f64; 9],
    #[serde(rename = "cam_t_m2c")]
    translation_mm: [f64; 3],
    obj_id: u32,
}

fn photographs(models: &Path, scene: &Path, poses: &Path, size: u32, every: u64) -> Result<Vec<Vec<f32>>, Error> {
    let objects = ObjectSet::load(models)?;
    let poses: std::collections::BTreeMap<u32, Vec<Truth>> = serde_json::from_str(&std::fs::read_to_string(poses)?)?;
    let mut rows = Vec::new();
    for frame in BopScene::open(scene)?.frames.iter().step_by(every as usize) {
        let image = load_rgb(&frame.image_path)?;
        for truth in poses.get(&frame.image_id).into_iter().flatten() {
            let Ok(object) = objects.get(truth.obj_id) else { continue };
            let rotation = Rotation3::from_matrix(&Matrix3::from_row_slice(&truth.rotation));
            let [x, y, z] = truth.translation_mm.map(|v| v * 1e-3);
            let pose = Pose::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_rotation_matrix(&rotation));
            let Some(crop) = Crop::around(&object.hull_m, &pose, &frame.intrinsics, 1.15, size) else { continue };
            let item = Item { mesh: &object.mesh, camera_from_object: pose };
            rows.extend(measure(&resample(&image, &crop), &rendering(item, crop.intrinsics(&frame.intrinsics), size)));
        }
    }
    Ok(rows)
}

fn rendering(item: Item<'_>, intrinsics: pseudoflow_geometry::Intrinsics, size: u32) -> Rendering {
    let background = Background::Colour([128; 3]);
    let scene = Scene { items: &[item], intrinsics, width: size, height: size, background };
    let mut out = Rendering::new(size, size);
    render_scene(&scene, &Headlight::default(), &mut Scratch::default(), &mut out);
    out
}

fn luma(p: &[u8; 3]) -> f32 {
    0.299 * f32::from(p[0]) + 0.587 * f32::from(p[1]) + 0.114 * f32::from(p[2])
}

fn saturation(p: &[u8; 3]) -> f32 {
    let (low, high) = (p.iter().min().copied().unwrap_or(0), p.iter().max().copied().unwrap_or(0));
    f32::from(high - low) / f32::from(high.max(1))
}

/// One row of numbers; none where the object is hardly in the crop.
fn measure(image: &RgbImage, truth: &Rendering) -> Option<Vec<f32>> {
    let n = image.width() as usize;
    let pixels = image.as_chunks::<3>().0;
    let inside = erode(&truth.mask, n, 3, true);
    let outside = erode(&truth.mask, n, 3, false);
    let near = erode(&truth.mask, n, 14, false);
    let object: Vec<usize> = (0..n * n).filter(|&i| inside[i]).collect();
    let background: Vec<usize> = (0..n * n).filter(|&i| outside[i]).collect();
    let ring: Vec<usize> = background.iter().copied().filter(|&i| !near[i]).collect();
    if object.len() < 150 || background.len() < 150 || ring.len() < 50 {
        return None;
    }
    let y: Vec<f32> = pixels.iter().map(luma).collect();
    let blue: Vec<f32> = pixels.iter().map(|p| f32::from(p[2]) - luma(p)).collect();
    let mean = |of: &dyn Fn(usize) -> f32, at: &[usize]| at.iter().map(|&i| of(i)).sum::<f32>() / at.len() as f32;
    let sd = |at: &[usize]| {
        let m = mean(&|i| y[i], at);
        mean(&|i| (y[i] - m).powi(2), at).sqrt()
    };
    let gradient = |step: usize, at: &[usize]| {
        let of = |i: usize| {
            let (x, v) = (i % n, i / n);
            if x + step < n && v + step < n {
                0.5 * ((y[i + step] - y[i]).abs() + (y[i + step * n] - y[i]).abs())
            } else {
                0.0
            }
        };
        mean(&of, at)
    };
    let all: Vec<usize> = object.iter().chain(&background).copied().collect();
    let one = gradient(1, &all).max(1e-3);
    let rendered = truth.rgb.as_chunks::<3>().0;
    let ry: Vec<f32> = rendered.iter().map(luma).collect();
    let (my, mr) = (mean(&|i| y[i], &object), mean(&|i| ry[i], &object));
    let covariance = mean(&|i| (y[i] - my) * (ry[i] - mr), &object);
    let spread = mean(&|i| (ry[i] - mr).powi(2), &object).sqrt() * sd(&object);
    let colour = |at: &[usize]| [0, 1, 2].map(|k| mean(&|i| f32::from(pixels[i][k]), at));
    let (a, b) = (colour(&object), colour(&ring));
    Some(vec![
        noise(&y, n, &all),
        noise(&blue, n, &all),
        gradient(1, &object),
        gradient(1, &background),
        gradient(2, &all) / one,
        gradient(4, &all) / one,
        my,
        mean(&|i| y[i], &background),
        sd(&object),
        sd(&background),
        mean(&|i| saturation(&pixels[i]), &object),
        mean(&|i| saturation(&pixels[i]), &background),
        mean(&|i| saturation(&rendered[i]), &object),
        my - mean(&|i| y[i], &ring),
        (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().sqrt(),
        covariance / spread.max(1e-3),
    ])
}

/// Pixels of the object (or beside it) that are further than `by` from the other.
fn erode(mask: &[u8], n: usize, by: usize, object: bool) -> Vec<bool> {
    let is = |i: usize| (mask[i] != 0) == object;
    let far = |i: usize| {
        let (x, y) = (i % n, i / n);
        let mut around = (y.saturating_sub(by)..(y + by + 1).min(n)).step_by(by.div_ceil(4).max(1));
        around
            .all(|v| (x.saturating_sub(by)..(x + by + 1).min(n)).step_by(by.div_ceil(4).max(1)).all(|u| is(v * n + u)))
    };
    (0..n * n).map(|i| is(i) && far(i)).collect()
}

/// Immerkaer's estimate on the flattest third of the pixels.
fn noise(v: &[f32], n: usize, at: &[usize]) -> f32 {
    let inner = at.iter().copied().filter(|i| (1..n - 1).contains(&(i % n)) && (1..n - 1).contains(&(i / n)));
    let mut found: Vec<(f32, f32)> = inner
        .map(|i| {
            let slope = (v[i + 1] - v[i - 1]).abs() + (v[i + n] - v[i - n]).abs();
            let cross = v[i - 1] + v[i + 1] + v[i - n] + v[i + n];
            let corners = v[i - n - 1] + v[i - n + 1] + v[i + n - 1] + v[i + n + 1];
            (slope, (4.0 * v[i] - 2.0 * cross + corners).abs())
        })
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let flat = &found[..(found.len() / 3).max(1)];
    (std::f32::consts::FRAC_PI_2).sqrt() / 6.0 * flat.iter().map(|f| f.1).sum::<f32>() / flat.len() as f32
}
