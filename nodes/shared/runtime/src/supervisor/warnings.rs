//! What nodes warn of, in a file of the run: the bridge reads it and passes it on to `/rosout`.
//!
//! A file, not a channel: a node that hangs holds up nobody, and one that starts again begins at its end.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

const FILE: &str = "warnings.log";
/// No more than this is written in a run: who warns so much is not read.
const MOST_BYTES: u64 = 4 << 20;
/// And so much is read at once.
const AT_ONCE: u64 = 64 << 10;

/// How bad it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Severity {
    /// The run goes on.
    Warning,
    /// Something failed.
    Error,
}

/// A warning of a node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Warning {
    /// How bad it is.
    pub severity: Severity,
    /// Name of the node in its graph.
    pub node: String,
    /// What it says.
    pub text: String,
}

/// The severity and message of a line of a log, where it is a warning: `[TIME LEVEL MODULE] MESSAGE`.
fn warning(line: &str) -> Option<(Severity, &str)> {
    let (head, text) = line.strip_prefix('[')?.split_once("] ")?;
    match head.split_whitespace().nth(1)? {
        "WARN" => Some((Severity::Warning, text)),
        "ERROR" => Some((Severity::Error, text)),
        _ => None,
    }
}

/// Writes what nodes warn of.
#[derive(Debug)]
pub(super) struct WarningsFile {
    file: Option<File>,
    written: u64,
}

impl WarningsFile {
    pub(super) fn create(run_dir: &Path) -> Self {
        let path = run_dir.join(FILE);
        let file = File::create(&path).inspect_err(|e| log::warn!("{}: {e}: /rosout lacks warnings", path.display()));
        Self { file: file.ok(), written: 0 }
    }

    /// A line of a node's log, which counts if it is a warning.
    pub(super) fn hear(&mut self, node: &str, line: &str) {
        if let Some((severity, text)) = warning(line) {
            self.write(severity, node, text);
        }
    }

    pub(super) fn write(&mut self, severity: Severity, node: &str, text: &str) {
        let Some(file) = &mut self.file else { return };
        let level = if severity == Severity::Error { 'E' } else { 'W' };
        let line = format!("{level} {node} {text}\n");
        self.written += line.len() as u64;
        if self.written > MOST_BYTES || file.write_all(line.as_bytes()).is_err() {
            self.file = None;
        }
    }
}

/// Reads what nodes warn of, as it comes.
#[derive(Debug)]
pub struct Warnings {
    path: PathBuf,
    at: u64,
}

impl Warnings {
    /// Of a run; `later`: only what comes from now on.
    #[must_use]
    pub fn of_run(run_dir: &Path, later: bool) -> Self {
        let path = run_dir.join(FILE);
        let at = if later { std::fs::metadata(&path).map_or(0, |meta| meta.len()) } else { 0 };
        Self { path, at }
    }

    /// What has come since this was last asked: nothing where no supervisor writes.
    pub fn take(&mut self) -> Vec<Warning> {
        let text = self.read().unwrap_or_default();
        let whole = text.rfind('\n').map_or("", |end| &text[..=end]);
        self.at += whole.len() as u64;
        whole.lines().filter_map(parse).collect()
    }

    fn read(&self) -> std::io::Result<String> {
        let mut file = File::open(&self.path)?;
        file.seek(SeekFrom::Start(self.at))?;
        let mut bytes = Vec::new();
        file.take(AT_ONCE).read_to_end(&mut bytes)?;
        let valid = bytes.utf8_chunks().next().map_or("", |chunk| chunk.valid());
        Ok(valid.to_owned())
    }
}

fn parse(line: &str) -> Option<Warning> {
    let (level, rest) = line.split_once(' ')?;
    let (node, text) = rest.split_once(' ')?;
    let severity = if level == "E" { Severity::Error } else { Severity::Warning };
    Some(Warning { severity, node: node.to_owned(), text: text.to_owned() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn warnings_are_read_once_and_what_is_none_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let mut reader = Warnings::of_run(folder.path(), false);
        assert_eq!(reader.take(), []);
        let mut file = WarningsFile::create(folder.path());
        file.hear("flow", "[2026-01-01T00:00:00Z INFO  pseudoflow_flow::node] ready");
        file.hear("flow", "[2026-01-01T00:00:00Z WARN  pseudoflow_flow::node] frame 3: [odd] \u{e4}");
        file.hear("pnp", "[2026-01-01T00:00:00Z ERROR pseudoflow_pnp] broken");
        file.hear("pnp", "error: WARN of nothing");
        let warning = |severity, node: &str, text: &str| Warning { severity, node: node.into(), text: text.into() };
        let both =
            [warning(Severity::Warning, "flow", "frame 3: [odd] \u{e4}"), warning(Severity::Error, "pnp", "broken")];
        assert_eq!(reader.take(), both);
        assert_eq!(Warnings::of_run(folder.path(), true).take(), []);
        file.write(Severity::Warning, "flow", "died");
        assert_eq!(reader.take(), [warning(Severity::Warning, "flow", "died")]);
    }

    #[test]
    fn who_warns_without_end_fills_no_disk() {
        let folder = tempfile::tempdir().unwrap();
        let mut file = WarningsFile::create(folder.path());
        (0..5000).for_each(|_| file.write(Severity::Warning, "flow", &"x".repeat(1000)));
        assert!(std::fs::metadata(folder.path().join(FILE)).unwrap().len() <= MOST_BYTES);
    }
}
