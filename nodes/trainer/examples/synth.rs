//! Preview sheet and speed of the synthetic data:
//! `cargo run --release -p pseudoflow-trainer --example synth -- MODELS_DIR[,DIR...] SHEET.png [FIRST COUNT SIZE SEED]`,
//! with photographs of the folder in the environment variable BACKGROUNDS.

use pseudoflow_imaging::save_png;
use pseudoflow_trainer::preview_sheet;
use pseudoflow_trainer::synth::{ObjectPool, SampleGenerator, SynthConfig};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [models, sheet, rest @ ..] = args.as_slice() else {
        return Err("usage: synth MODELS_DIR[,DIR...] SHEET.png [FIRST COUNT SIZE SEED]".into());
    };
    let number = |i: usize, default: u64| rest.get(i).map_or(Ok(default), |v| v.parse());
    let (first, count, size, seed) = (number(0, 0)?, number(1, 8)?, number(2, 128)?, number(3, 1)?);
    let folders: Vec<PathBuf> = models.split(',').map(PathBuf::from).collect();
    let objects = Arc::new(ObjectPool::load(&folders)?);
    let backgrounds: Vec<PathBuf> = std::env::var_os("BACKGROUNDS").map(PathBuf::from).into_iter().collect();
    let generator =
        SampleGenerator::new(objects, SynthConfig::default(), seed)?.with_backgrounds(&backgrounds, false)?;
    let start = Instant::now();
    let samples = generator.batch(first, count as usize, size as u32)?;
    let rate = count as f64 / start.elapsed().as_secs_f64();
    eprintln!("{rate:.1} samples/s at {size} px on {} threads", rayon::current_num_threads());
    // One pair of each scene is shown.
    let shown: Vec<_> = samples.into_iter().step_by(generator.pairs_per_scene()).collect();
    Ok(save_png(&preview_sheet(&shown), Path::new(sheet))?)
}
