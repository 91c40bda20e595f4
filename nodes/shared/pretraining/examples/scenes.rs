//! Sheet of the initializer's training images, and how fast they are made:
//! `cargo run --release --workspace --example scenes -- MODELS_DIR SHEET.png`

use pseudoflow_imaging::{ObjectSet, save_png};
use pseudoflow_pretraining::initializer::{InitializerTraining, scene_sheet};
use pseudoflow_synthetic::{SceneConfig, SceneGenerator};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [models, sheet] = args.as_slice() else { return Err("usage: scenes MODELS_DIR SHEET.png".into()) };
    let config = InitializerTraining::new(PathBuf::from(models), "nano", PathBuf::new());
    save_png(&scene_sheet(&config, 12)?, Path::new(sheet))?;
    let objects = Arc::new(ObjectSet::load(Path::new(models))?);
    let generator = SceneGenerator::new(objects, SceneConfig::for_images(320, 240), 1)?;
    let start = Instant::now();
    for index in 0..40 {
        generator.scene(index)?;
    }
    eprintln!("{:.1} scenes a second on one thread", 40.0 / start.elapsed().as_secs_f64());
    Ok(())
}
