//! Runs graphs of toy nodes over shared memory, every node in a process of its own: this binary starts itself
//! again as each node. One suite for what delivery promises: order, completeness, windows, restarts, stops.

mod live;
mod liveness;
mod local;
mod replay;
mod scene;
mod stop;
mod toys;

use libtest_mimic::{Arguments, Trial};
use pseudoflow_runtime::{Graph, supervisor};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().collect();
    let words: Vec<&str> = arguments.iter().skip(1).map(String::as_str).collect();
    match words.as_slice() {
        ["node", name, "--graph", graph, "--run-dir", run_dir] => {
            report(toys::registry().run_node(name, Path::new(graph), Path::new(run_dir)).map_err(|e| e.to_string()))
        }
        ["supervise", graph, run_dir] => report(supervise(Path::new(graph), Path::new(run_dir))),
        _ => run_tests(),
    }
}

fn report(result: Result<(), String>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn supervise(graph: &Path, run_dir: &Path) -> Result<(), String> {
    let graph = Graph::read(graph).map_err(|error| error.to_string())?;
    // Patient, so that a busy machine ends in order, too.
    let stop_timeout = Duration::from_secs(30);
    let options = supervisor::Options { print: true, stop_timeout, ..supervisor::Options::new(run_dir) };
    supervisor::run(&graph, &toys::registry(), &options).map(|_| ()).map_err(|error| error.to_string())
}

fn run_tests() -> ExitCode {
    let mut arguments = Arguments::from_args();
    // Each test is several processes; more than two tests at once only wait for each other.
    arguments.test_threads = arguments.test_threads.or(Some(2));
    let tests = replay::tests().into_iter().chain(local::tests()).chain(live::tests()).chain(stop::tests());
    let tests = tests.chain(liveness::tests());
    libtest_mimic::run(&arguments, tests.collect()).exit_code()
}

/// A test from a function that panics when it fails.
fn test(name: &str, body: impl FnOnce() + Send + 'static) -> Trial {
    Trial::test(name, move || {
        body();
        Ok(())
    })
}

fn this_program() -> PathBuf {
    std::env::current_exe().expect("the running program has a path")
}
