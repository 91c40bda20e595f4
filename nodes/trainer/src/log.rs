use super::StepResult;
use crate::TrainerError;
use pseudoflow_network::storage::write_atomically;
use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};

const HEADER: &str = "step,loss_flow,loss_photo,epe_px,valid_fraction,median_sigma_px,samples,skipped,staleness_steps,\
                      grad_norm,learning_rate,seconds";

/// What the labels of a step were like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LabelStats {
    /// Share of the object's pixels with a label.
    pub(super) valid_fraction: f64,
    /// Mean over instances of the median sigma, pixels.
    pub(super) median_sigma_px: f64,
    /// Instances that were trained with.
    pub(super) samples: usize,
    /// Instances without usable labels.
    pub(super) skipped: usize,
    /// Steps since the teacher that made the labels.
    pub(super) staleness_steps: u64,
}

/// The log of a training: one line a step, appended.
#[derive(Debug)]
pub(super) struct AdaptLog {
    path: PathBuf,
    file: File,
}

impl AdaptLog {
    /// Begins a log, or goes on behind line `steps` of an earlier one.
    pub(super) fn open(path: &Path, steps: u64) -> Result<Self, TrainerError> {
        let failed = || TrainerError::io(path);
        let earlier = match steps {
            0 => String::new(),
            _ => std::fs::read_to_string(path).map_err(failed())?,
        };
        let step_of = |line: &str| line.split(',').next()?.parse::<u64>().ok();
        let kept = earlier.lines().skip(1).filter(|line| step_of(line).is_some_and(|step| step <= steps));
        let text = std::iter::once(HEADER).chain(kept).fold(String::new(), |text, line| text + line + "\n");
        write_atomically(path, text.as_bytes())?;
        let file = OpenOptions::new().append(true).open(path).map_err(failed())?;
        Ok(Self { path: path.to_owned(), file })
    }

    pub(super) fn add(&mut self, result: &StepResult, labels: &LabelStats, seconds: f64) -> Result<(), TrainerError> {
        let StepResult { step, loss_flow, loss_photo, epe_px, grad_norm, learning_rate } = result;
        let LabelStats { valid_fraction, median_sigma_px, samples, skipped, staleness_steps } = labels;
        let line = format!(
            "{step},{loss_flow},{loss_photo},{epe_px},{valid_fraction},{median_sigma_px},{samples},{skipped},\
             {staleness_steps},{grad_norm},{learning_rate},{seconds:.3}\n"
        );
        self.file.write_all(line.as_bytes()).map_err(TrainerError::io(&self.path))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_goes_on_behind_its_checkpoint() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("adapt.csv");
        let result = |step| StepResult {
            step,
            loss_flow: 1.0,
            loss_photo: f32::NAN,
            epe_px: 0.5,
            grad_norm: 1.0,
            learning_rate: 0.1,
        };
        let labels =
            LabelStats { valid_fraction: 0.5, median_sigma_px: 0.2, samples: 4, skipped: 0, staleness_steps: 3 };
        let mut log = AdaptLog::open(&path, 0).unwrap();
        (1..=5).for_each(|step| log.add(&result(step), &labels, 0.1).unwrap());
        let mut log = AdaptLog::open(&path, 3).unwrap();
        log.add(&result(4), &labels, 0.2).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let steps: Vec<&str> = text.lines().map(|line| line.split(',').next().unwrap()).collect();
        assert_eq!(steps, ["step", "1", "2", "3", "4"]);
        assert!(text.lines().all(|line| line.split(',').count() == HEADER.split(',').count()));
    }
}
