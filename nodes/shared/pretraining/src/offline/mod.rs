//! Trainings on what is made beside them, from begin to end: their one loop, their log, and what stands beside their weights.

mod log;
mod progress;

pub use progress::{Progress, Silent, TerminalProgress};

use crate::PretrainError;
pub(crate) use log::{Curve, Row, RunLog};
use pseudoflow_network::NetworkError;
use pseudoflow_network::storage::write_atomically;
use std::path::Path;

/// A training in progress.
pub(crate) trait Training {
    /// Steps taken.
    fn step(&self) -> u64;
    /// Takes the next step; says how it goes.
    fn advance(&mut self) -> Result<String, PretrainError>;
    /// What is due after a step: measurements, checkpoints.
    fn between_steps(&mut self) -> Result<(), PretrainError>;
    /// Writes log and checkpoint, the log first: a checkpoint never lacks lines of its log.
    fn save(&self) -> Result<(), PretrainError>;
}

/// Takes the steps that are left until the last one, or until somebody wants to stop, and saves.
pub(crate) fn train(
    training: &mut impl Training,
    steps: u64,
    progress: &mut dyn Progress,
) -> Result<(), PretrainError> {
    progress.start(training.step(), steps);
    while training.step() < steps && !progress.should_stop() {
        let news = training.advance();
        let news = news.inspect_err(|error| rescue(error, training))?;
        progress.step(training.step(), &news);
        training.between_steps()?;
    }
    training.save()
}

/// When a GPU fails, the steps before are whole: they go to the checkpoint, whatever its interval.
fn rescue(error: &PretrainError, training: &impl Training) {
    if let PretrainError::Network(NetworkError::DeviceFailed { .. }) = error {
        match training.save() {
            Ok(()) => ::log::error!("the device failed; all steps before are in the checkpoint (`--resume`)"),
            Err(error) => ::log::error!("the device failed, and the checkpoint could not be written: {error}"),
        }
    }
}

/// Keeps what decides the weights of a new run beside them (`run_path`), in the folder of `out`, which is made.
pub(crate) fn keep_description(out: &Path, run_path: &Path, description: &str) -> Result<(), PretrainError> {
    if let Some(folder) = out.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).map_err(PretrainError::io(folder))?;
    }
    Ok(write_atomically(run_path, description.as_bytes())?)
}

/// Refuses to resume with another configuration than the kept one.
pub(crate) fn check_same_run(path: &Path, description: &str) -> Result<(), PretrainError> {
    let found = std::fs::read_to_string(path).map_err(PretrainError::io(path))?;
    let differs = found.lines().zip(description.lines()).find(|(a, b)| a != b);
    match differs {
        Some((there, here)) => Err(PretrainError::OtherRun {
            path: path.to_owned(),
            there: there.trim().to_owned(),
            here: here.trim().to_owned(),
        }),
        None => Ok(()),
    }
}
