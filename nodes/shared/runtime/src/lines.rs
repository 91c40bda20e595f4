//! Files that grow by a line of JSON for each frame: what sinks leave for a command to read.

use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Why such a file cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum LinesError {
    /// The file itself.
    #[error("{}: {source}: check the path, and the space on the disk", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// A line that is not what it should be.
    #[error("{}: line {line}: {source}: it was written by something else, or changed since", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// What is wrong with it.
        source: serde_json::Error,
    },
}

/// A file that is being written, line by line.
#[derive(Debug)]
pub struct JsonLines {
    path: PathBuf,
    file: File,
    lines: usize,
}

impl JsonLines {
    /// Opens the file and makes its folder. One to `append` to loses a line that was cut off.
    ///
    /// # Errors
    /// The file or its folder cannot be written.
    pub fn open(path: &Path, append: bool) -> Result<Self, LinesError> {
        let failed = |source| LinesError::File { path: path.to_owned(), source };
        path.parent().map_or(Ok(()), std::fs::create_dir_all).map_err(failed)?;
        let mut options = OpenOptions::new();
        options.create(true);
        if !append {
            let file = options.write(true).truncate(true).open(path).map_err(failed)?;
            return Ok(Self { path: path.to_owned(), file, lines: 0 });
        }
        let file = options.append(true).open(path).map_err(failed)?;
        let text = std::fs::read(path).map_err(failed)?;
        let whole = text.iter().rposition(|byte| *byte == b'\n').map_or(0, |at| at + 1);
        file.set_len(whole as u64).map_err(failed)?;
        let lines = text[..whole].iter().filter(|byte| **byte == b'\n').count();
        Ok(Self { path: path.to_owned(), file, lines })
    }

    /// Adds a line.
    ///
    /// # Errors
    /// The value is nothing that JSON can say, or the disk is full.
    pub fn write(&mut self, value: &impl Serialize) -> Result<(), LinesError> {
        let at_fault = |source| LinesError::Line { path: self.path.clone(), line: self.lines + 1, source };
        let line = serde_json::to_string(value).map_err(at_fault)? + "\n";
        let failed = |source| LinesError::File { path: self.path.clone(), source };
        self.file.write_all(line.as_bytes()).map_err(failed)?;
        self.lines += 1;
        Ok(())
    }
}

/// The lines of a file.
///
/// # Errors
/// The file cannot be read, or a line is no `T`.
pub fn read_lines<T: DeserializeOwned>(path: &Path) -> Result<Vec<T>, LinesError> {
    let failed = |source| LinesError::File { path: path.to_owned(), source };
    let text = std::fs::read_to_string(path).map_err(failed)?;
    let read = |(at, line)| {
        serde_json::from_str(line).map_err(|source| LinesError::Line { path: path.to_owned(), line: at + 1, source })
    };
    text.lines().enumerate().map(read).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interrupted_file_goes_on_behind_its_last_whole_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/a.jsonl");
        let mut lines = JsonLines::open(&path, false).unwrap();
        (0..3).for_each(|n| lines.write(&vec![n, 7]).unwrap());
        drop(lines);
        let text = std::fs::read(&path).unwrap();
        std::fs::write(&path, &text[..text.len() - 2]).unwrap(); // killed within the third line
        assert!(read_lines::<Vec<u32>>(&path).unwrap_err().to_string().contains("line 3"));
        JsonLines::open(&path, true).unwrap().write(&vec![9]).unwrap();
        assert_eq!(read_lines::<Vec<u32>>(&path).unwrap(), [vec![0, 7], vec![1, 7], vec![9]]);
        JsonLines::open(&path, false).unwrap();
        assert!(read_lines::<Vec<u32>>(&path).unwrap().is_empty());
    }
}
