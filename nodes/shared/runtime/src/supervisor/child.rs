use std::collections::VecDeque;
use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Sender, channel};
use std::time::Duration;

/// What children tell the supervisor.
pub(super) enum Event {
    /// A line on standard output or error.
    Line { node: usize, text: String },
    /// The process is gone.
    Exit { node: usize, status: Option<ExitStatus> },
    /// SIGINT or SIGTERM to the supervisor.
    Stop,
}

/// Starts a node's process in a group of its own, so that Ctrl-C reaches the supervisor alone.
pub(super) fn start(
    command: &[OsString],
    name: &str,
    threads: Option<u16>,
    graph: &Path,
    run_dir: &Path,
) -> std::io::Result<Child> {
    let (program, arguments) = command.split_first().ok_or(std::io::ErrorKind::InvalidInput)?;
    Command::new(program)
        // The thread pool of a process is made with its first parallel work and cannot be changed then.
        .envs(threads.map(|threads| ("RAYON_NUM_THREADS", threads.to_string())))
        .args(arguments)
        .arg(name)
        .arg("--graph")
        .arg(graph)
        .arg("--run-dir")
        .arg(run_dir)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .process_group(0)
        .spawn()
}

/// Watches a child from threads of its own until it is gone.
pub(super) fn watch(mut child: Child, node: usize, events: &Sender<Event>) {
    let (done, readers) = channel();
    if let Some(stdout) = child.stdout.take() {
        read_lines(stdout, node, events.clone(), done.clone());
    }
    if let Some(stderr) = child.stderr.take() {
        read_lines(stderr, node, events.clone(), done.clone());
    }
    drop(done);
    let events = events.clone();
    std::thread::spawn(move || {
        let status = child.wait().ok();
        // Its last words come first; a grandchild that holds the pipe open is not waited for.
        while readers.recv_timeout(Duration::from_millis(500)).is_ok() {}
        let _ = events.send(Event::Exit { node, status });
    });
}

fn read_lines(from: impl Read + Send + 'static, node: usize, events: Sender<Event>, done: Sender<()>) {
    std::thread::spawn(move || {
        let mut reader = BufReader::new(from);
        let mut line = Vec::new();
        while matches!(reader.read_until(b'\n', &mut line), Ok(count) if count > 0) {
            let text = String::from_utf8_lossy(&line).trim_end().to_owned();
            line.clear();
            if events.send(Event::Line { node, text }).is_err() {
                break;
            }
        }
        let _ = done.send(());
    });
}

/// Whether a process died (as opposed to ending with an error of its own): killed, or panicked.
pub(super) fn died(status: Option<ExitStatus>) -> bool {
    const PANIC: i32 = 101;
    status.is_none_or(|status| status.signal().is_some() || matches!(status.code(), Some(0 | PANIC)))
}

/// How a process ended, in words.
pub(super) fn how(status: Option<ExitStatus>) -> String {
    match status {
        None => "it could not be waited for".to_owned(),
        Some(status) if status.success() => "it ended before the run did".to_owned(),
        Some(status) => match status.signal() {
            Some(signal) => format!("killed by signal {signal}{}", hint(signal)),
            None => format!("exit code {}", status.code().unwrap_or(-1)),
        },
    }
}

/// What a signal mostly means here.
fn hint(signal: i32) -> &'static str {
    use signal_hook::consts::{SIGABRT, SIGBUS, SIGKILL, SIGSEGV, SIGTERM};
    match signal {
        SIGABRT => ", SIGABRT",
        SIGBUS => ", SIGBUS: is /dev/shm full? A message takes its size there once per frame in flight",
        SIGKILL => ", SIGKILL: by hand, or for want of memory",
        SIGSEGV => ", SIGSEGV",
        SIGTERM => ", SIGTERM",
        _ => "",
    }
}

/// The last lines that a node wrote.
#[derive(Debug, Default, Clone)]
pub(super) struct LastWords(VecDeque<String>);

impl LastWords {
    /// Lines kept: a panic's message is followed by its backtrace.
    const KEPT: usize = 80;
    const TOLD: usize = 12;

    pub(super) fn hear(&mut self, line: &str) {
        if self.0.len() == Self::KEPT {
            self.0.pop_front();
        }
        self.0.push_back(line.to_owned());
    }

    pub(super) fn text(&self) -> String {
        if self.0.is_empty() {
            return "  (it wrote nothing)".to_owned();
        }
        let last = self.0.len().saturating_sub(Self::TOLD);
        let panic = self.0.iter().rposition(|line| line.contains("' panicked at ") || line.contains(") panicked at "));
        let begin = panic.unwrap_or(last);
        let told = self.0.iter().skip(begin).take(Self::TOLD);
        told.map(|line| format!("  {line}")).collect::<Vec<_>>().join("\n")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_words_begin_at_the_panic() {
        let mut words = LastWords::default();
        assert!(words.text().contains("wrote nothing"));
        for line in 0..100 {
            words.hear(&format!("line {line}"));
        }
        assert!(words.text().starts_with("  line 88\n") && words.text().ends_with("line 99"), "{}", words.text());
        words.hear("thread 'main' (7) panicked at src/x.rs:1:2:");
        (0..20).for_each(|frame| words.hear(&format!("backtrace {frame}")));
        assert!(words.text().starts_with("  thread 'main' (7) panicked at"), "{}", words.text());
    }
}
