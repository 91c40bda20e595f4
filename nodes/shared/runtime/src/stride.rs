use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::num::NonZeroU64;

/// Which frames of a recording are played: number `start`, and from there every `step`-th.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Stride {
    /// Number of the first frame, counted from 0.
    pub start: u64,
    /// 1 for every frame.
    pub step: NonZeroU64,
}

impl Default for Stride {
    fn default() -> Self {
        Self { start: 0, step: NonZeroU64::MIN }
    }
}

impl Stride {
    /// Number in the recording of the frame that is played at a place.
    #[must_use]
    pub fn number(&self, place: u64) -> u64 {
        self.start + place * self.step.get()
    }

    /// How many of `frames` frames are played.
    #[must_use]
    pub fn count(&self, frames: u64) -> u64 {
        frames.saturating_sub(self.start).div_ceil(self.step.get())
    }

    /// The numbers that are played of `frames` frames.
    pub fn numbers(self, frames: u64) -> impl Iterator<Item = u64> {
        (0..self.count(frames)).map(move |place| self.number(place))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_nth_frame_from_the_first_on() {
        let stride = |text: &str| serde_yaml::from_str::<Stride>(text).unwrap();
        assert_eq!(stride("{}").numbers(3).collect::<Vec<_>>(), [0, 1, 2]);
        assert_eq!(stride("{start: 4, step: 5}").numbers(15).collect::<Vec<_>>(), [4, 9, 14]);
        assert_eq!(stride("{start: 4, step: 5}").numbers(14).collect::<Vec<_>>(), [4, 9]);
        assert_eq!(stride("{start: 4}").count(3), 0);
        assert!(serde_yaml::from_str::<Stride>("{step: 0}").is_err());
    }
}
