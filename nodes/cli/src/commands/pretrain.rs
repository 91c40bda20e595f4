use anyhow::{Context as _, Result};
use pseudoflow_imaging::{ObjectSet, save_png};
use pseudoflow_trainer::pretrain::{PretrainConfig, TerminalProgress, WarmStart, pretrain};
use pseudoflow_trainer::preview_sheet;
use pseudoflow_trainer::synth::SampleGenerator;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

#[derive(clap::Args)]
pub(crate) struct Args {
    /// The object set: a BOP `models/` folder. One network is trained for all its objects.
    #[arg(long)]
    objects: PathBuf,
    /// nano, small, paper, or a YAML file as in config/networks.
    #[arg(long, default_value = "nano")]
    network: String,
    /// The weights to write (.safetensors). Log, plot and checkpoint stand beside them.
    #[arg(long)]
    out: PathBuf,
    /// Optimiser steps.
    #[arg(long)]
    steps: Option<u64>,
    /// Pairs in a step.
    #[arg(long)]
    batch: Option<usize>,
    /// Peak of the one-cycle learning rate.
    #[arg(long)]
    max_lr: Option<f64>,
    /// Seed of data and fresh weights.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Weights to start from; `random` for none. The default is RAFT-small as its authors trained it.
    #[arg(long)]
    warm_start: Option<PathBuf>,
    /// Goes on from the checkpoint.
    #[arg(long)]
    resume: bool,
    /// Only writes a sheet of samples (reference, real-like, flow, warped) to this PNG.
    #[arg(long, value_name = "FILE.png")]
    preview: Option<PathBuf>,
}

impl Args {
    fn config(self) -> PretrainConfig {
        let mut config = PretrainConfig::new(self.objects, &self.network, self.out);
        config.steps = self.steps.unwrap_or(config.steps);
        config.batch = self.batch.unwrap_or(config.batch);
        config.max_lr = self.max_lr.unwrap_or(config.max_lr);
        config.seed = self.seed;
        config.resume = self.resume;
        config.warm_start = match self.warm_start {
            None => WarmStart::Auto,
            Some(word) if word.as_os_str() == "random" => WarmStart::Random,
            Some(file) => WarmStart::File(file),
        };
        config
    }
}

pub(crate) fn run(mut args: Args) -> Result<ExitCode> {
    let sheet = args.preview.take();
    let config = args.config();
    if let Some(sheet) = sheet {
        return preview(&config, &sheet);
    }
    let summary = pretrain(&config, &mut TerminalProgress::new()?)?;
    println!(
        "{} of {} steps in {:.0} s ({:.1} pairs/s trained, {:.1} pairs/s made by a thread): loss {:.3} px, EPE {:.3} px",
        summary.step,
        config.steps,
        summary.seconds,
        summary.trained_per_s,
        summary.made_per_s,
        summary.loss_px,
        summary.epe_px
    );
    println!("{}   plot: {}", summary.written.display(), summary.plot.display());
    Ok(if summary.finished { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn preview(config: &PretrainConfig, sheet: &Path) -> Result<ExitCode> {
    config.check()?;
    let size_px = config.resolve_network()?.size_px as u32;
    let objects = Arc::new(ObjectSet::load(&config.objects)?);
    let samples = SampleGenerator::new(objects, config.synth.clone(), config.seed)?.batch(0, 8, size_px)?;
    save_png(&preview_sheet(&samples), sheet).with_context(|| format!("{}: cannot be written", sheet.display()))?;
    println!("{}", sheet.display());
    Ok(ExitCode::SUCCESS)
}
