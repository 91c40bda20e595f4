//! The commands that train, or that need what trainings need: absent from a binary without the feature `training`.

use super::{ablate, adapt, bench_device, calibrate, pretrain};
use anyhow::Result;
use clap::Subcommand;
use std::process::ExitCode;

#[derive(Subcommand)]
pub(crate) enum Command {
    /// Trains a network on synthetic renderings of an object set.
    Pretrain(pretrain::Args),
    /// Trains on recordings without annotations; keeps what is better.
    Adapt(adapt::Args),
    /// Trains once for every row of a table and every seed, and scores what came out.
    Ablate(ablate::Args),
    /// Learns from synthetic images when refined poses can be believed.
    Calibrate(calibrate::Args),
    /// Times a training step and a look on a device.
    BenchDevice(bench_device::Args),
}

pub(crate) fn run(command: &Command) -> Result<ExitCode> {
    match command {
        Command::Pretrain(args) => pretrain::run(args),
        Command::Adapt(args) => adapt::run(args),
        Command::Ablate(args) => ablate::run(args),
        Command::Calibrate(args) => calibrate::run(args),
        Command::BenchDevice(args) => bench_device::run(args),
    }
}
