//! One file per command; each parses its arguments, calls a library and prints.
#![allow(clippy::print_stdout, reason = "the commands talk to people")]

pub(crate) mod ablate;
pub(crate) mod adapt;
pub(crate) mod bag;
pub(crate) mod bench;
pub(crate) mod bench_device;
pub(crate) mod calibrate;
pub(crate) mod demo;
pub(crate) mod eval;
pub(crate) mod export;
mod frames;
mod inherit;
pub(crate) mod interface;
pub(crate) mod pretrain;
pub(crate) mod ros_args;
pub(crate) mod run;

/// An error and its causes in one line, none said twice.
pub(crate) fn chain(error: &anyhow::Error) -> String {
    error.chain().fold(String::new(), |text, cause| {
        let cause = cause.to_string();
        match text {
            text if text.is_empty() => cause,
            text if text.contains(&cause) => text,
            text => format!("{text}: {cause}"),
        }
    })
}
