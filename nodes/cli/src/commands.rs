//! One file per command; each parses its arguments, calls a library and prints.
#![allow(clippy::print_stdout, reason = "the commands talk to people")]

#[cfg(feature = "training")]
pub(crate) mod ablate;
#[cfg(feature = "training")]
pub(crate) mod adapt;
pub(crate) mod bag;
pub(crate) mod bench;
#[cfg(feature = "training")]
pub(crate) mod bench_device;
#[cfg(feature = "training")]
pub(crate) mod calibrate;
pub(crate) mod demo;
pub(crate) mod eval;
pub(crate) mod export;
#[cfg(feature = "training")]
mod frames;
mod inherit;
pub(crate) mod interface;
#[cfg(feature = "training")]
pub(crate) mod pretrain;
pub(crate) mod ros_args;
pub(crate) mod run;
#[cfg(feature = "training")]
pub(crate) mod trainings;

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
