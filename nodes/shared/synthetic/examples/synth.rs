//! Preview sheet and speed of the synthetic data:
//! `cargo run --release --workspace --example synth -- MODELS_DIR[,DIR...] SHEET.png [FIRST COUNT SIZE SEED]`,
//! with photographs of the folder in the environment variable BACKGROUNDS.

use pseudoflow_imaging::save_png;
use pseudoflow_synthetic::preview_sheet;
use pseudoflow_synthetic::{ObjectPool, SampleGenerator, SynthConfig};
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
    // Procedural shapes are made when first used: here, and not in what is measured.
    generator.batch(first, count as usize, size as u32)?;
    let (start, cpu) = (Instant::now(), cpu_s());
    let samples = generator.batch(first, count as usize, size as u32)?;
    let rate = count as f64 / start.elapsed().as_secs_f64();
    let (cpu_ms, threads) = (1e3 * (cpu_s() - cpu) / count as f64, rayon::current_num_threads());
    eprintln!("{rate:.1} samples/s at {size} px on {threads} threads; {cpu_ms:.2} CPU-ms each");
    // One pair of each scene is shown.
    let shown: Vec<_> = samples.into_iter().step_by(generator.pairs_per_scene()).collect();
    Ok(save_png(&preview_sheet(&shown), Path::new(sheet))?)
}

/// CPU time of this process, seconds, in steps of 10 ms; 0 where the system does not tell.
fn cpu_s() -> f64 {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = text.rsplit(')').next().unwrap_or_default();
    let ticks = after_name.split_whitespace().skip(11).take(2).filter_map(|v| v.parse::<f64>().ok());
    ticks.sum::<f64>() / 100.0
}
