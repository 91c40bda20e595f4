use super::frames::picture_folders;
use anyhow::{Context as _, Result, bail};
use pseudoflow_cli::RARE;
use pseudoflow_imaging::{RgbImage, save_png};
use pseudoflow_network::ComputeDevice;
use pseudoflow_pretraining::initializer::{InitializerTraining, scene_sheet, train_initializer};
use pseudoflow_pretraining::offline::TerminalProgress;
use pseudoflow_pretraining::pretrain::{Course, PretrainConfig, SizeShare, WarmStart, pretrain};
use pseudoflow_synthetic::preview_sheet;
use pseudoflow_synthetic::{ObjectPool, SampleGenerator};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

/// Which network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Stage {
    /// The one that finds objects in an image and gives them a first pose.
    Initializer,
    /// The one that refines poses.
    Flow,
}

#[derive(clap::Args)]
pub(crate) struct Args {
    /// Which network to train.
    #[arg(long, value_enum, default_value = "flow")]
    stage: Stage,
    /// The objects: BOP `models/` folders.
    ///
    /// One network is trained for all of them (initializer: one folder).
    #[arg(long, value_delimiter = ',', required = true, value_name = "DIR[,DIR...]", value_parser = pseudoflow_runtime::shipped::input)]
    objects: Vec<PathBuf>,
    /// refiner, nano, small, paper, or a YAML file as in config/networks.
    ///
    /// Initializer: nano or full.
    #[arg(long, default_value = "nano")]
    network: String,
    /// Pictures or recordings to put behind the objects.
    ///
    /// Photographs for walls, tables and cards of the scenes, without any annotation: folders of pictures (and the
    /// folders in them), or recordings (bags), whose frames are copied to a folder beside `--out`. For an initializer
    /// none of the objects may be seen in them.
    #[arg(long, value_delimiter = ',', value_name = "DIR|BAG[,...]", value_parser = pseudoflow_runtime::shipped::input)]
    backgrounds: Vec<PathBuf>,
    /// Initializer: meshes of other things, to stand between the objects.
    ///
    /// BOP `models/` folders; none of the objects may be among them. Procedural shapes stand there anyway.
    #[arg(long, help_heading = RARE, hide_short_help = true, value_delimiter = ',', value_name = "DIR[,DIR...]", value_parser = pseudoflow_runtime::shipped::input)]
    others: Vec<PathBuf>,
    /// Leaves out what `meta.json` does not release for shipping.
    ///
    /// Meshes and pictures; `meta.json` lies in their folders.
    #[arg(long, help_heading = RARE, hide_short_help = true)]
    only_shippable: bool,
    /// Flow: what the synthetic pairs look like, YAML or JSON.
    ///
    /// Any of the keys of `SynthConfig`. `--preview` shows what comes out.
    #[arg(long, help_heading = RARE, hide_short_help = true, value_name = "FILE")]
    synth: Option<PathBuf>,
    /// The weights to write (.safetensors); log, plot and checkpoint stand beside.
    #[arg(long)]
    out: PathBuf,
    /// Optimiser steps.
    #[arg(long)]
    steps: Option<u64>,
    /// Refiner: the learning rate falls over the last so many steps.
    ///
    /// With `--resume` and more `--steps` the training goes on from before that.
    #[arg(long, help_heading = RARE, hide_short_help = true)]
    cool_down: Option<u64>,
    /// Keeps every n-th object out of the training, and measures on it.
    ///
    /// The error on renderings of these is the learning curve.
    #[arg(long, help_heading = RARE, hide_short_help = true, value_name = "N")]
    hold_out: Option<usize>,
    /// Steps between checkpoints.
    #[arg(long, help_heading = RARE, hide_short_help = true)]
    checkpoint_every: Option<u64>,
    /// Pairs (initializer: images) in a step.
    #[arg(long, help_heading = RARE, hide_short_help = true)]
    batch: Option<usize>,
    /// Flow: crop sizes to train at, each with how often it comes.
    ///
    /// A step of larger crops has fewer. RAFT trains at its own size, the refiner at 128 and 256:2.
    #[arg(long, help_heading = RARE, hide_short_help = true, value_delimiter = ',', value_name = "PX[:WEIGHT][,...]")]
    sizes: Vec<SizeShare>,
    /// Refiner: weight of the error of the poses that its flows say.
    ///
    /// Crop pixels at 256 for an ADD of a diameter.
    #[arg(long, help_heading = RARE, hide_short_help = true)]
    pose_weight: Option<f64>,
    /// Initializer: scenes that are used in changing order; a multiple of `--batch`.
    #[arg(long, help_heading = RARE, hide_short_help = true)]
    block: Option<u64>,
    /// Peak of the one-cycle learning rate.
    #[arg(long, help_heading = RARE, hide_short_help = true)]
    max_lr: Option<f64>,
    /// Seed of data and fresh weights.
    #[arg(long, help_heading = RARE, hide_short_help = true, default_value_t = 0)]
    seed: u64,
    /// Weights to start from; `random` for none.
    ///
    /// The default is RAFT-small as its authors trained it (initializer: that of this repository, which knows other
    /// objects; a flow network may be given too).
    #[arg(long, value_parser = pseudoflow_runtime::shipped::input)]
    warm_start: Option<PathBuf>,
    /// What trains: auto, cpu, `vulkan[:N]` or `cuda[:N]`.
    ///
    /// A training may go on with another one.
    #[arg(long, default_value = "auto")]
    device: ComputeDevice,
    /// Goes on from the checkpoint.
    #[arg(long)]
    resume: bool,
    /// Threads that render beside the training.
    #[arg(long, help_heading = RARE, hide_short_help = true)]
    data_threads: Option<usize>,
    /// Only writes a sheet of samples to this PNG.
    ///
    /// Flow: reference, real-like, flow, warped.
    #[arg(long, value_name = "FILE.png")]
    preview: Option<PathBuf>,
}

impl Args {
    fn warm_start(&self) -> WarmStart {
        match &self.warm_start {
            None => WarmStart::Auto,
            Some(word) if word.as_os_str() == "random" => WarmStart::Random,
            Some(file) => WarmStart::File(file.clone()),
        }
    }

    fn flow(&self) -> Result<PretrainConfig> {
        let mut config = PretrainConfig::new(self.objects.clone(), &self.network, self.out.clone());
        config.steps = self.steps.unwrap_or(config.steps);
        config.batch = self.batch.unwrap_or(config.batch);
        config.max_lr = self.max_lr.unwrap_or(config.max_lr);
        config.data_threads = self.data_threads.unwrap_or(config.data_threads);
        config.pose_weight = self.pose_weight.unwrap_or(config.pose_weight);
        config.hold_out = self.hold_out.unwrap_or(config.hold_out);
        config.checkpoint_every = self.checkpoint_every.unwrap_or(config.checkpoint_every);
        config.schedule = self.cool_down.map(|cool_down| Course::Plateau { warm_up: 500, cool_down });
        (config.seed, config.resume, config.device) = (self.seed, self.resume, self.device);
        config.warm_start = self.warm_start();
        config.sizes.clone_from(&self.sizes);
        config.only_shippable = self.only_shippable;
        config.backgrounds = picture_folders(&self.backgrounds, &self.out)?;
        if let Some(path) = &self.synth {
            let text = std::fs::read_to_string(path).with_context(|| format!("{}: cannot be read", path.display()))?;
            config.synth = serde_yaml::from_str(&text)
                .with_context(|| format!("{}: not what `synth` may hold", path.display()))?;
        }
        Ok(config)
    }

    fn initializer(&self) -> Result<InitializerTraining> {
        let [objects] = self.objects.as_slice() else { bail!("--objects: an initializer takes one folder") };
        let mut config = InitializerTraining::new(objects.clone(), &self.network, self.out.clone());
        config.block = self.block.unwrap_or(config.block);
        config.steps = self.steps.unwrap_or(config.steps);
        config.batch = self.batch.unwrap_or(config.batch);
        config.max_lr = self.max_lr.unwrap_or(config.max_lr);
        config.data_threads = self.data_threads.unwrap_or(config.data_threads);
        (config.seed, config.resume, config.device) = (self.seed, self.resume, self.device);
        config.warm_start = self.warm_start();
        config.others.clone_from(&self.others);
        config.only_shippable = self.only_shippable;
        config.backgrounds = picture_folders(&self.backgrounds, &self.out)?;
        Ok(config)
    }
}

pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    match (args.stage, &args.preview) {
        (Stage::Flow, Some(sheet)) => preview(&args.flow()?, sheet),
        (Stage::Flow, None) => flow(&args.flow()?),
        (Stage::Initializer, Some(sheet)) => written(&scene_sheet(&args.initializer()?, 12)?, sheet),
        (Stage::Initializer, None) => initializer(&args.initializer()?),
    }
}

fn flow(config: &PretrainConfig) -> Result<ExitCode> {
    let summary = pretrain(config, &mut TerminalProgress::new()?)?;
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

fn initializer(config: &InitializerTraining) -> Result<ExitCode> {
    let summary = train_initializer(config, &mut TerminalProgress::new()?)?;
    println!(
        "{} of {} steps in {:.0} s ({:.0} s of rendering beside it): loss {:.3}, corners off by {:.3} diameters",
        summary.step, config.steps, summary.seconds, summary.rendering_s, summary.loss, summary.space_diameters
    );
    println!("{}   plot: {}", summary.written.display(), summary.plot.display());
    Ok(if summary.finished { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn preview(config: &PretrainConfig, sheet: &Path) -> Result<ExitCode> {
    config.check()?;
    let size_px = config.network_size_px()? as u32;
    let objects = Arc::new(ObjectPool::load(&config.objects)?);
    let generator = SampleGenerator::new(objects, config.synth.clone(), config.seed)?;
    let generator = generator.with_backgrounds(&config.backgrounds, config.only_shippable)?;
    // One pair of each of a dozen scenes.
    let each = generator.pairs_per_scene();
    let samples: Vec<_> = generator.batch(0, 12 * each, size_px)?.into_iter().step_by(each).collect();
    written(&preview_sheet(&samples), sheet)
}

fn written(picture: &RgbImage, sheet: &Path) -> Result<ExitCode> {
    save_png(picture, sheet).with_context(|| format!("{}: cannot be written", sheet.display()))?;
    println!("{}", sheet.display());
    Ok(ExitCode::SUCCESS)
}
