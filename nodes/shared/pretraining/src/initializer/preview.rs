//! A sheet of examples for the eye.

use super::InitializerTraining;
use super::augment::{Example, example};
use crate::PretrainError;
use image::Rgb;
use pseudoflow_imaging::{ObjectSet, RgbImage};
use pseudoflow_network::{DetectorConfig, Grid};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

const COLUMNS: u32 = 4;

/// `count` examples as the network sees them, four in a row: the box of each instance, and a dot in its colour at each
/// cell of the finest level that belongs to it.
///
/// # Errors
/// As [`super::train_initializer`].
pub fn scene_sheet(config: &InitializerTraining, count: u32) -> Result<RgbImage, PretrainError> {
    config.check()?;
    let objects = Arc::new(ObjectSet::load(&config.objects)?);
    let network = DetectorConfig::named(&config.network, objects.len())?;
    let generator = config.generator(&objects, &network)?;
    let [width, height] = network.input_px;
    let grid = Grid::new(width, height);
    let [width, height] = [width as u32, height as u32];
    let mut sheet = RgbImage::new(COLUMNS * width, count.div_ceil(COLUMNS) * height);
    for i in 0..count {
        let scene = generator.scene(u64::from(i))?;
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed + u64::from(i));
        let picture = drawn(example(&scene, &objects, &grid, &mut rng), &grid);
        let (x0, y0) = (i % COLUMNS * width, i / COLUMNS * height);
        picture.enumerate_pixels().for_each(|(x, y, pixel)| sheet.put_pixel(x0 + x, y0 + y, *pixel));
    }
    Ok(sheet)
}

fn colour(class: usize) -> Rgb<u8> {
    const COLOURS: [[u8; 3]; 6] =
        [[255, 60, 40], [60, 220, 60], [80, 120, 255], [250, 220, 40], [230, 80, 230], [60, 230, 230]];
    Rgb(COLOURS[class % COLOURS.len()])
}

fn drawn(example: Example, grid: &Grid) -> RgbImage {
    let Example { mut image, truth } = example;
    let [fx, fy, cx, cy] = truth.intrinsics;
    for instance in &truth.instances {
        let at = instance.corners_m.map(|[x, y, z]| [fx * x / z + cx, fy * y / z + cy]);
        for (from, axis) in (0..8_usize).flat_map(|i| (0..3).map(move |k| (i, 1 << k))).filter(|(i, k)| i & k == 0) {
            line(&mut image, at[from], at[from | axis], colour(instance.class));
        }
    }
    for (cell, owner) in grid.cells.iter().zip(&truth.owner).filter(|(cell, owner)| cell.level == 0 && **owner > 0) {
        let class = truth.instances[usize::from(*owner) - 1].class;
        line(&mut image, cell.centre_px, cell.centre_px, colour(class));
    }
    image
}

fn line(image: &mut RgbImage, from: [f32; 2], to: [f32; 2], colour: Rgb<u8>) {
    let steps = (to[0] - from[0]).abs().max((to[1] - from[1]).abs()).clamp(1.0, 2000.0).ceil();
    for i in 0..=steps as u32 {
        let t = i as f32 / steps;
        let [x, y] = [0, 1].map(|k| (from[k] + t * (to[k] - from[k])).round());
        if x >= 0.0 && y >= 0.0 && x < image.width() as f32 && y < image.height() as f32 {
            image.put_pixel(x as u32, y as u32, colour);
        }
    }
}
