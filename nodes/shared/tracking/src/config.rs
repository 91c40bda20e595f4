use crate::TrackingError;
use pseudoflow_contour::{PriorConfig, RegionConfig};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What texture is worth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TextureConfig {
    /// Smallest and largest standard deviation of a coordinate of a patch's place, pixels of the image.
    pub sigma_px: [f64; 2],
    /// Independent errors for each patch: those of one keyframe share its pose's.
    pub share: f64,
    /// How far a patch may be from its prediction in `frame_s`, diameters of the object.
    pub reach: f64,
    /// A view that differs by more from all keyframes makes another, degrees.
    pub keyframe_deg: f64,
    /// Keyframes kept of an object; 0 follows contours alone.
    pub keyframes: usize,
}

impl Default for TextureConfig {
    fn default() -> Self {
        Self { sigma_px: [0.7, 4.0], share: 0.3, reach: 0.08, keyframe_deg: 15.0, keyframes: 4 }
    }
}

/// Settings of a tracker. Chosen on tabletop's train split and on rendered sequences.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TrackingConfig {
    /// The contour, from frame to frame; its prior says how far an object moves beside its prediction in `frame_s`.
    pub region: RegionConfig,
    /// The contour of what was found or looked at: further away, with colours of its own.
    pub first: RegionConfig,
    /// Texture.
    pub texture: TextureConfig,
    /// Seconds between frames that the prior of `region` is meant for; it grows with the root of the gap.
    pub frame_s: f64,
    /// Share of the measured velocity that the prediction believes, 0..1.
    pub velocity_gain: f64,
    /// A longer gap between frames (or a step back in time) ends all velocities, seconds.
    pub longest_gap_s: f64,
    /// Share of fresh colours in a believed frame.
    pub renewal: f32,
    /// An object that has not been seen for so long is lost: its pose is no longer given, seconds.
    pub hold_s: f64,
    /// How much a frame must show of an object for its pose to be measured there, 0..1; else it is held.
    pub min_seen: f64,
    /// The same for colours and texture to be learnt from the frame.
    pub learn_seen: f64,
    /// Confidence that makes what was found a track, 0..1.
    pub min_confidence: f64,
    /// Less confidence for `hold_s` ends a track, 0..1.
    pub lose_confidence: f64,
    /// What is sure is looked at every so often all the same, seconds.
    pub look_every_s: f64,
    /// What is not sure is looked at again after this, seconds.
    pub look_again_s: f64,
    /// A look that has not come back after this is given up, seconds.
    pub look_timeout_s: f64,
    /// CPU time that looks may take, milliseconds a frame in the mean.
    pub budget_ms: f64,
    /// CPU time that one look takes, milliseconds.
    pub look_ms: f64,
    /// Objects that are asked for at a time; the next are when these looks have come.
    pub looks_at_once: usize,
    /// A look with this score makes what was found a track at once, 0..1; with a smaller one a second look from there must agree.
    pub sure_score: f64,
    /// A look with a smaller score speaks against the pose that it began from, 0..1.
    pub doubtful_score: f64,
    /// So many looks in a row that speak against an object that is seen end its track: it is searched for anew.
    pub doubtful_looks: u32,
    /// Covariances are those of the normal equations times this.
    pub covariance_scale: f64,
}

impl Default for TrackingConfig {
    fn default() -> Self {
        let prior = PriorConfig { rotation_deg: 2.0, xy: 0.015, z: 0.03, freedom: 8.0 };
        Self {
            region: RegionConfig { scales_px: vec![4.0, 2.0, 1.0], edges: 2, prior, ..RegionConfig::default() },
            first: RegionConfig::default(),
            texture: TextureConfig::default(),
            frame_s: 1.0 / 30.0,
            velocity_gain: 0.7,
            longest_gap_s: 0.5,
            renewal: 0.2,
            hold_s: 0.5,
            min_seen: 0.5,
            learn_seen: 0.7,
            min_confidence: 0.5,
            lose_confidence: 0.1,
            look_every_s: 1.0,
            look_again_s: 0.2,
            look_timeout_s: 1.0,
            budget_ms: 10.0,
            look_ms: 30.0,
            looks_at_once: 2,
            sure_score: 0.9,
            doubtful_score: 0.5,
            doubtful_looks: 2,
            covariance_scale: 1.0,
        }
    }
}

impl TrackingConfig {
    /// Checks every range.
    ///
    /// # Errors
    /// Names the first setting that is out of range.
    pub fn validate(&self) -> Result<(), TrackingError> {
        self.region.validate()?;
        self.first.validate()?;
        let share = |v: f64| (0.0..=1.0).contains(&v);
        let checks = [
            ("texture.sigma_px", self.texture.sigma_px[0], self.texture.sigma_px[0] > 0.0, "positive"),
            (
                "texture.sigma_px",
                self.texture.sigma_px[1],
                self.texture.sigma_px[1] >= self.texture.sigma_px[0],
                "growing",
            ),
            ("texture.share", self.texture.share, self.texture.share > 0.0, "positive"),
            ("texture.reach", self.texture.reach, self.texture.reach > 0.0, "positive"),
            ("texture.keyframe_deg", self.texture.keyframe_deg, self.texture.keyframe_deg > 0.0, "positive"),
            ("frame_s", self.frame_s, self.frame_s > 0.0, "positive"),
            ("velocity_gain", self.velocity_gain, share(self.velocity_gain), "0 to 1"),
            ("longest_gap_s", self.longest_gap_s, self.longest_gap_s > 0.0, "positive"),
            ("renewal", f64::from(self.renewal), share(f64::from(self.renewal)), "0 to 1"),
            ("hold_s", self.hold_s, self.hold_s >= 0.0, "0 or more"),
            ("min_seen", self.min_seen, share(self.min_seen), "0 to 1"),
            ("learn_seen", self.learn_seen, share(self.learn_seen), "0 to 1"),
            ("min_confidence", self.min_confidence, share(self.min_confidence), "0 to 1"),
            ("sure_score", self.sure_score, share(self.sure_score), "0 to 1"),
            ("doubtful_score", self.doubtful_score, share(self.doubtful_score), "0 to 1"),
            ("doubtful_looks", f64::from(self.doubtful_looks), self.doubtful_looks > 0, "1 or more"),
            ("lose_confidence", self.lose_confidence, share(self.lose_confidence), "0 to 1"),
            ("look_every_s", self.look_every_s, self.look_every_s > 0.0, "positive"),
            ("look_again_s", self.look_again_s, self.look_again_s > 0.0, "positive"),
            ("look_timeout_s", self.look_timeout_s, self.look_timeout_s > 0.0, "positive"),
            ("budget_ms", self.budget_ms, self.budget_ms >= 0.0, "0 or more"),
            ("look_ms", self.look_ms, self.look_ms > 0.0, "positive"),
            ("covariance_scale", self.covariance_scale, self.covariance_scale > 0.0, "positive"),
        ];
        match checks.into_iter().find(|(_, value, good, _)| !good || !value.is_finite()) {
            Some((name, got, _, must)) => Err(TrackingError::Setting { name, got, must }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_setting_out_of_range_is_named() {
        assert!(TrackingConfig::default().validate().is_ok());
        let bad = TrackingConfig { velocity_gain: 1.5, ..TrackingConfig::default() };
        assert!(bad.validate().unwrap_err().to_string().contains("velocity_gain"));
        let bad = TrackingConfig { hold_s: f64::NAN, ..TrackingConfig::default() };
        assert!(bad.validate().unwrap_err().to_string().contains("hold_s"));
    }
}
