use indicatif::{ProgressBar, ProgressStyle};
use pseudoflow_cli::training::files;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// A progress bar over the trainer's log.
pub(super) struct Watch {
    done: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Watch {
    pub(super) fn start(folder: &Path, steps: u64) -> Self {
        let (done, path) = (Arc::new(AtomicBool::new(false)), folder.join(files::LOG));
        let template = "{bar:30} {pos}/{len} steps  {per_sec}  ETA {eta}  {msg}";
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar = ProgressBar::new(steps).with_style(style);
        let stop = Arc::clone(&done);
        let thread = std::thread::spawn(move || {
            let mut said = 0;
            while !stop.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(500));
                show(&bar, &path, &mut said);
            }
            bar.finish();
        });
        Self { done, thread }
    }

    pub(super) fn stop(self) {
        self.done.store(true, Ordering::Relaxed);
        if self.thread.join().is_err() {
            log::warn!("the progress bar stopped");
        }
    }
}

/// The last line of the log, by the names in its first.
fn show(bar: &ProgressBar, path: &Path, said: &mut u64) {
    let Ok(text) = std::fs::read_to_string(path) else { return };
    let mut lines = text.lines();
    let (Some(names), Some(last)) = (lines.next(), lines.next_back()) else { return };
    let value = |name: &str| {
        let at = names.split(',').position(|n| n == name)?;
        last.split(',').nth(at)?.parse::<f64>().ok()
    };
    let Some(step) = value("step") else { return };
    let shown = ["loss_flow", "loss_photo", "valid_fraction", "median_sigma_px", "staleness_steps"];
    let parts = shown.iter().filter_map(|name| Some(format!("{} {:.3}", name.replace('_', " "), value(name)?)));
    let message = parts.collect::<Vec<_>>().join("  ");
    if bar.position() == 0 {
        bar.reset_eta();
    }
    bar.set_position(step as u64);
    bar.set_message(message.clone());
    // Without a terminal a line now and then.
    if bar.is_hidden() && step as u64 >= *said + 50 {
        *said = step as u64;
        log::info!("step {step}: {message}");
    }
}
