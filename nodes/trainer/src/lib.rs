//! The trainer node: self-supervised training of a student by its own moving average (paper, section "Overall framework"; docs/method.md,
//! "Self-supervision"): labels from the teacher's flows where the views agree, and a photometric loss between real
//! images. No truth can get here: what comes in are rendered views, real crops and flows.
//!
//! [`AdaptState`] is the training: a function of its configuration and its samples, to the bit. [`TrainerNode`] is the
//! shell that gathers samples from messages, keeps checkpoints and sends the teacher's weights back.

mod augment;
mod config;
mod error;
mod log;
mod node;
mod photo;
mod sample;
mod shrink;
mod state;

#[cfg(test)]
mod tests;

pub use config::{TrainerConfig, label_px};
pub use error::TrainerError;
pub use node::TrainerNode;
pub use photo::{PhotoLoss, PhotoSample, photo_loss};
pub use sample::{Sample, SampleForm};
pub use state::{AdaptState, StepResult, steps_taken};

/// Names of the files in a training's folder.
pub mod files {
    /// Student, optimiser, teacher and what was published.
    pub const CHECKPOINT: &str = "checkpoint.safetensors";
    /// The teacher after the last step: what the training made.
    pub const TEACHER: &str = "teacher.safetensors";
    /// Folder of the teachers that are kept, each named by its steps.
    pub const TEACHERS: &str = "teachers";
    /// The student after the last step.
    pub const STUDENT: &str = "student.safetensors";
    /// One line a step.
    pub const LOG: &str = "adapt.csv";
}
