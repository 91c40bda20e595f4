//! What strangers wrote: every reader answers, within its budget of memory, whatever it is given.
//!
//! The short run is part of the tests. `PSEUDOFLOW_FUZZ_RUNS=100000` makes a long one of so many inputs for each reader and
//! says what they cost; `PSEUDOFLOW_FUZZ_SEED` begins elsewhere.

mod corpus;
#[path = "../../fuzz/src/lib.rs"]
#[allow(dead_code, unreachable_pub, reason = "cargo-fuzz builds it as a library")]
mod fuzz;
mod memory;
mod mutate;

use fuzz::{TARGETS, Target};
use mutate::Mutator;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Seconds of this thread on a processor: what loops for ever is found, what waits for a busy machine is not.
const MOST_CPU_S: f64 = 20.0;

fn cpu_s() -> f64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}

/// Reads an input; gives the share of the budget of bytes, and seconds.
fn read(target: &Target, what: &str, bytes: &[u8]) -> (f64, f64) {
    let (begin_s, mut answered) = (cpu_s(), false);
    let held = memory::most_held(|| answered = catch_unwind(AssertUnwindSafe(|| (target.read)(bytes))).is_ok());
    let (seconds, budget) = (cpu_s() - begin_s, target.plain_bytes + target.bytes_per_byte * bytes.len());
    if !answered || held > budget || seconds > MOST_CPU_S {
        let kept = std::env::temp_dir().join(format!("pseudoflow_{}_failure", target.name));
        std::fs::write(&kept, bytes).expect("the input is kept");
        let kept = kept.display();
        panic!("{} {what}: answered: {answered}, {held} of {budget} bytes, {seconds:.1} s: {kept}", target.name);
    }
    (held as f64 / budget as f64, seconds)
}

fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).ok().and_then(|text| text.parse().ok()).unwrap_or(default)
}

#[test]
fn known_bad_files_are_answered_within_their_budgets() {
    for target in &TARGETS {
        for (what, bytes) in corpus::bad(target.name) {
            let (share, seconds) = read(target, what, &bytes);
            eprintln!("{} {what}: {seconds:.3} s, {:.1} % of its bytes", target.name, 100.0 * share);
        }
    }
}

#[test]
fn good_files_are_read() {
    use pseudoflow_bag::BagReader;
    let folder = tempfile::tempdir().expect("a folder");
    for (i, bytes) in corpus::good("bag").iter().enumerate() {
        let path = folder.path().join(format!("{i}.mcap"));
        std::fs::write(&path, bytes).expect("a file");
        // The last one holds zeros, which are no records.
        assert_eq!(BagReader::open(&path).is_ok(), i < 2, "bag {i}");
    }
    for (name, load) in [("a.ply", 1e-3), ("a.obj", 1.0)] {
        let bytes = corpus::good(&name[2..]).remove(0);
        let path = folder.path().join(name);
        std::fs::write(&path, &bytes).expect("a file");
        std::fs::write(folder.path().join("a.mtl"), "newmtl red\nKd 0.8 0.1 0.1\n").expect("a file");
        let read = if name == "a.ply" {
            pseudoflow_imaging::load_ply(&path, load)
        } else {
            pseudoflow_imaging::load_obj(&path, load)
        };
        assert!(read.is_ok(), "{:?}", read.err());
    }
}

#[test]
fn mutated_files_are_answered_within_their_budgets() {
    let (runs, seed) = (number("PSEUDOFLOW_FUZZ_RUNS", 300), number("PSEUDOFLOW_FUZZ_SEED", 1));
    for (i, target) in TARGETS.iter().enumerate() {
        let mut mutator = Mutator::new(seed * 1000 + i as u64, corpus::good(target.name));
        let (mut share, mut slowest_s, begin_s) = (0.0_f64, 0.0_f64, cpu_s());
        for run in 0..runs {
            let (held, seconds) = read(target, &format!("input {run} of seed {seed}"), &mutator.next());
            (share, slowest_s) = (share.max(held), slowest_s.max(seconds));
        }
        let (percent, total_s) = (100.0 * share, cpu_s() - begin_s);
        eprintln!(
            "{:8} {runs} inputs, {total_s:.1} s, the slowest {slowest_s:.3} s, at most {percent:.1} % of its bytes",
            target.name
        );
    }
}
