//! Progress of what takes long, on a terminal and in a log.

/// How often progress is logged where standard error is no terminal.
const LOG_EVERY: std::time::Duration = std::time::Duration::from_secs(30);

/// A progress bar on standard error; where that is no terminal, a line in the log now and then.
#[must_use]
pub fn progress_bar(length: u64, what: &str) -> indicatif::ProgressBar {
    let bar = indicatif::ProgressBar::new(length);
    if bar.is_hidden() {
        let (watched, what) = (bar.downgrade(), what.to_owned());
        std::thread::spawn(move || log_progress(&watched, &what));
    }
    let style = indicatif::ProgressStyle::with_template("{prefix} {wide_bar} {pos}/{len} {per_sec} eta {eta} {msg}");
    bar.set_style(style.unwrap_or_else(|_| indicatif::ProgressStyle::default_bar()));
    bar.set_prefix(what.to_owned());
    bar
}

/// Says how far a bar is until it is finished or gone.
fn log_progress(bar: &indicatif::WeakProgressBar, what: &str) {
    loop {
        std::thread::sleep(LOG_EVERY);
        let Some(bar) = bar.upgrade().filter(|bar| !bar.is_finished()) else { return };
        log::info!("{}", progress_line(what, bar.position(), bar.length().unwrap_or(0), bar.elapsed().as_secs_f64()));
    }
}

fn progress_line(what: &str, done: u64, all: u64, elapsed_s: f64) -> String {
    match done {
        0 => format!("{what}: 0 of {all} after {elapsed_s:.0} s"),
        _ => {
            let left_s = elapsed_s * all.saturating_sub(done) as f64 / done as f64;
            format!("{what}: {done} of {all} after {elapsed_s:.0} s, about {left_s:.0} s to go")
        }
    }
}

/// A count on standard error of what has no known length, silent where that is no terminal.
#[must_use]
pub fn progress_spinner(what: &str) -> indicatif::ProgressBar {
    let bar = indicatif::ProgressBar::new_spinner();
    let style = indicatif::ProgressStyle::with_template("{spinner} {pos} {prefix} {elapsed}");
    bar.set_style(style.unwrap_or_else(|_| indicatif::ProgressStyle::default_spinner()));
    bar.set_prefix(what.to_owned());
    bar
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_says_how_long_it_will_take() {
        assert_eq!(progress_line("find", 0, 40, 30.2), "find: 0 of 40 after 30 s");
        assert_eq!(progress_line("find", 10, 40, 30.0), "find: 10 of 40 after 30 s, about 90 s to go");
    }
}
