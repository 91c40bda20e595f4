use crate::InitializerError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How objects are followed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TrackConfig {
    /// While something is missing, every n-th image is searched; while nothing is tracked, each.
    pub search_every: u32,
    /// Good frames in a row that make a detection a track.
    pub confirm_after: u32,
    /// Bad frames in a row after which a track is lost.
    pub lose_after: u32,
    /// A pose with a smaller confidence (pnp's probability that it is right) is a bad one, 0..1.
    pub min_confidence: f64,
    /// Largest distance of a pose from its prediction, diameters.
    pub max_jump_diameters: f64,
    /// Largest angle of a pose from its prediction, degrees.
    pub max_turn_deg: f64,
    /// Share of the measured velocity that the prediction believes, 0..1.
    pub velocity_gain: f64,
}

impl Default for TrackConfig {
    fn default() -> Self {
        Self {
            search_every: 5,
            confirm_after: 2,
            lose_after: 3,
            min_confidence: 0.15,
            max_jump_diameters: 0.5,
            max_turn_deg: 40.0,
            velocity_gain: 0.7,
        }
    }
}

impl TrackConfig {
    /// Checks the ranges.
    ///
    /// # Errors
    /// Names the first setting out of range.
    pub fn check(&self) -> Result<(), InitializerError> {
        let count = |v: u32| (1..=1000).contains(&v);
        let share = |v: f64| (0.0..=1.0).contains(&v);
        let rules = [
            ("track.search_every", f64::from(self.search_every), count(self.search_every), "1 to 1000"),
            ("track.confirm_after", f64::from(self.confirm_after), count(self.confirm_after), "1 to 1000"),
            ("track.lose_after", f64::from(self.lose_after), count(self.lose_after), "1 to 1000"),
            ("track.min_confidence", self.min_confidence, share(self.min_confidence), "0 to 1"),
            ("track.max_jump_diameters", self.max_jump_diameters, self.max_jump_diameters > 0.0, "a number over 0"),
            ("track.max_turn_deg", self.max_turn_deg, (0.0..=180.0).contains(&self.max_turn_deg), "0 to 180"),
            ("track.velocity_gain", self.velocity_gain, share(self.velocity_gain), "0 to 1"),
        ];
        match rules.into_iter().find(|(_, _, holds, _)| !holds) {
            Some((field, got, _, wanted)) => Err(InitializerError::Setting { field, got, wanted }),
            None => Ok(()),
        }
    }
}
