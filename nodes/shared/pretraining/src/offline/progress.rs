//! What the person at the terminal sees.

use crate::PretrainError;
use indicatif::{ProgressBar, ProgressStyle};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Who watches a run.
pub trait Progress {
    /// The run begins at `step` of `steps`.
    fn start(&mut self, step: u64, steps: u64);
    /// Step `step` was taken; `news` says how it goes.
    fn step(&mut self, step: u64, news: &str);
    /// Whether to write a checkpoint and stop.
    fn should_stop(&self) -> bool {
        false
    }
}

/// Nobody watches.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Progress for Silent {
    fn start(&mut self, _: u64, _: u64) {}
    fn step(&mut self, _: u64, _: &str) {}
}

/// A progress bar on standard error; SIGINT and SIGTERM stop the run after a checkpoint.
#[derive(Debug)]
pub struct TerminalProgress {
    bar: ProgressBar,
    stop: Arc<AtomicBool>,
}

impl TerminalProgress {
    /// # Errors
    /// When the signals cannot be caught.
    pub fn new() -> Result<Self, PretrainError> {
        let stop = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
            signal_hook::flag::register_conditional_shutdown(signal, 130, Arc::clone(&stop))
                .and_then(|_| signal_hook::flag::register(signal, Arc::clone(&stop)))
                .map_err(PretrainError::Signal)?;
        }
        Ok(Self { bar: ProgressBar::new(0), stop })
    }
}

impl Progress for TerminalProgress {
    fn start(&mut self, step: u64, steps: u64) {
        let template = "{bar:30} {pos}/{len} steps  {per_sec}  ETA {eta}  {msg}";
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        self.bar = ProgressBar::new(steps).with_style(style).with_position(step);
        self.bar.reset_eta();
    }

    fn step(&mut self, step: u64, news: &str) {
        self.bar.set_message(news.to_owned());
        self.bar.set_position(step);
        if self.bar.is_hidden() && step.is_multiple_of(100) {
            log::info!("step {step}: {news}");
        }
    }

    fn should_stop(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}
