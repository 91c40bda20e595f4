//! What a command says of itself fits a screen: `-h` the options of every day, `--help` all of them.

mod common;

use common::run;

/// Every command that people call, as on the command line.
const COMMANDS: [&str; 18] = [
    "",
    "demo",
    "run",
    "check",
    "graph",
    "schema",
    "interface",
    "pretrain",
    "adapt",
    "ablate",
    "calibrate",
    "export",
    "bench",
    "bench-device",
    "eval",
    "compare",
    "bag",
    "bag from-bop",
];

/// Rows of a screen, and of the overview of all commands.
const MOST_LINES: usize = 24;
const MOST_LINES_OF_ALL: usize = 28;

/// Columns at which a terminal breaks a line.
const COLUMNS: usize = 100;

fn rows(text: &str) -> usize {
    text.lines().map(|line| line.chars().count().div_ceil(COLUMNS).max(1)).sum()
}

fn help(command: &str, flag: &str) -> String {
    let words: Vec<&str> = command.split_whitespace().chain([flag]).collect();
    let output = run(&words);
    assert!(output.status.success(), "`pseudoflow {command} {flag}` fails");
    String::from_utf8(output.stdout).expect("text")
}

#[test]
fn short_help_fits_a_screen() {
    let most = |command: &str| if command.is_empty() { MOST_LINES_OF_ALL } else { MOST_LINES };
    let counted = COMMANDS.map(|command| (command, rows(&help(command, "-h"))));
    let long: Vec<_> = counted.iter().filter(|(command, rows)| *rows > most(command)).collect();
    assert!(
        long.is_empty(),
        "too long for a screen: {long:?}; a rare option gets `hide_short_help` and the heading RARE"
    );
}

#[test]
fn long_help_knows_what_short_help_leaves_out() {
    for (command, rare) in [("adapt", "--photo-weight"), ("pretrain", "--cool-down"), ("eval", "--backend")] {
        assert!(!help(command, "-h").contains(rare), "{command} {rare} is rare");
        assert!(help(command, "--help").contains(rare), "{command} {rare} is nowhere");
    }
}
