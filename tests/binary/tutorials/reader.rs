//! Somebody who follows a document: in a folder that looks like the repository, with a recording and meshes of their own.

use crate::blocks::{Block, commands};
use crate::common::root;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

/// What is the reader's in the documents, and what stands in for it here.
const OWN: [(&str, &str); 7] = [
    ("my_bag", "bags/tabletop_demo"),
    ("my/models", "config/objects/tabletop"),
    ("room_1", "bags/tabletop_demo"),
    ("room_2.mcap", "bags/tabletop_demo/tabletop_demo_0.mcap"),
    ("POOL/meshes", "config/objects/tabletop"),
    ("POOL/backgrounds", "docs/images"),
    ("my_live_graph.yaml", "config/graphs/live_track.yaml"),
];

/// Stands in for weights that hours of training would make.
const WEIGHTS: &str = "config/weights/refiner.safetensors";

/// `cargo run --release --` is the binary under test; it is built already.
const CARGO: &str = "#!/bin/sh
[ \"$1 $2 $3\" = \"run --release --\" ] || { echo \"cargo $*: the documents use 'cargo run --release --'\" >&2; exit 1; }
shift 3
exec pseudoflow \"$@\"
";

/// Words whose next word is a file that a command makes.
const MADE: [&str; 5] = ["--out", "--report", "--record", "--csv", "--preview"];

pub(crate) struct Reader(TempDir);

impl Reader {
    pub(crate) fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let at = folder.path();
        for name in ["config", "bags", "docs", "launch", "tests"] {
            symlink(root().join(name), at.join(name)).expect("a link");
        }
        for (own, shipped) in OWN {
            let own = at.join(own);
            std::fs::create_dir_all(own.parent().expect("a folder")).expect("a folder");
            symlink(root().join(shipped), own).expect("a link");
        }
        let bin = at.join(".bin");
        std::fs::create_dir(&bin).expect("a folder");
        symlink(env!("CARGO_BIN_EXE_pseudoflow"), bin.join("pseudoflow")).expect("a link");
        std::fs::write(bin.join("cargo"), CARGO).expect("a file");
        std::fs::set_permissions(bin.join("cargo"), PermissionsExt::from_mode(0o755)).expect("a program");
        Self(folder)
    }

    pub(crate) fn folder(&self) -> &Path {
        self.0.path()
    }

    fn shell(&self, script: &str) -> Output {
        let path = format!("{}:{}", self.folder().join(".bin").display(), std::env::var("PATH").unwrap_or_default());
        let mut bash = Command::new("bash");
        bash.args(["-euo", "pipefail", "-c", script]).current_dir(self.folder()).env("PATH", path);
        // Runs beside each other must not meet.
        bash.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF").output().expect("bash is there")
    }

    /// Follows a block; says what went wrong.
    pub(crate) fn follow(&self, block: &Block) -> Result<(), String> {
        match block.parsed {
            None => succeeded(&self.shell(&block.text), &block.text),
            Some(_) => commands(&block.text).iter().try_for_each(|words| self.parse(words, true)),
        }
    }

    /// Whether a command has a meaning. `with_files`: and whether what it reads is there.
    pub(crate) fn parse(&self, words: &[String], with_files: bool) -> Result<(), String> {
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        match words.as_slice() {
            ["pseudoflow", rest @ ..] | ["cargo", "run", "--release", "--", rest @ ..] => {
                self.parse_ours(rest, with_files)
            }
            [program, ..] if program.contains('/') && !self.folder().join(program).is_file() => {
                Err(format!("{program}: no such program"))
            }
            _ => Ok(()), // other people's programs
        }
    }

    fn parse_ours(&self, words: &[&str], with_files: bool) -> Result<(), String> {
        if let (true, Some(missing)) = (with_files, self.missing(words)) {
            return Err(format!("pseudoflow {}: there is no {missing}", words.join(" ")));
        }
        let tried = match words {
            ["run", rest @ ..] if with_files => without_run_options(rest),
            // The first option that does not exist ends it before the help.
            _ => [words, &["--help"]].concat(),
        };
        let quoted: Vec<String> = tried.iter().map(|word| format!("'{word}'")).collect();
        let line = format!("pseudoflow {}", quoted.join(" "));
        succeeded(&self.shell(&line), &line)?;
        self.make_weights(words);
        Ok(())
    }

    /// The first word that names a file which is not there.
    fn missing<'a>(&self, words: &[&'a str]) -> Option<&'a str> {
        let made = |i: usize| i > 0 && MADE.contains(&words[i - 1]);
        let files = words.iter().enumerate().filter(|(i, word)| !made(*i) && is_file(word));
        files.flat_map(|(_, word)| word.split(',')).find(|file| !self.folder().join(file).exists())
    }

    /// Later commands go on with the weights that this one would have made.
    fn make_weights(&self, words: &[&str]) {
        let out = words.windows(2).find(|pair| pair[0] == "--out").map(|pair| self.folder().join(pair[1]));
        if let Some(out) = out.filter(|out| out.extension().is_some_and(|e| e == "safetensors") && !out.exists()) {
            std::fs::copy(root().join(WEIGHTS), out).expect("weights");
        }
    }
}

/// Whether a word names a file: not a topic, a setting or an option.
fn is_file(word: &str) -> bool {
    let extensions = [".yaml", ".safetensors", ".mcap", ".json", ".onnx"];
    let relative = word.contains('/') && !word.starts_with('/');
    !word.starts_with('-') && !word.contains(['=', ':']) && (relative || extensions.iter().any(|e| word.ends_with(e)))
}

/// `run`'s own words for `check`, which finds wrong settings and missing files and starts nothing.
fn without_run_options<'a>(words: &[&'a str]) -> Vec<&'a str> {
    let mut kept = vec!["check"];
    let mut words = words.iter();
    while let Some(word) = words.next() {
        match *word {
            "--out" => drop(words.next()),
            "--in-process" => {}
            word => kept.push(word),
        }
    }
    kept
}

fn succeeded(output: &Output, what: &str) -> Result<(), String> {
    if output.status.success() {
        return Ok(());
    }
    let said = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
    Err(format!("{what}\n{}: {}\n{}", output.status, said[0], said[1]))
}
