use crate::ContourError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Spread of rough poses, for the prior: Gaussian near the pose, with the tails of a Student's t.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PriorConfig {
    /// Standard deviation about each camera axis, degrees.
    pub rotation_deg: f64,
    /// Standard deviation of x and of y, diameters.
    pub xy: f64,
    /// Standard deviation of z, diameters.
    pub z: f64,
    /// Degrees of freedom of the tails.
    pub freedom: f64,
}

impl Default for PriorConfig {
    fn default() -> Self {
        Self { rotation_deg: 9.5, xy: 0.035, z: 0.14, freedom: 8.0 }
    }
}

/// Settings of the region stage. Lengths are pixels of a picture in which the object is `object_px` large, but for those that
/// name the image's own pixels. Chosen on LINEMOD's and tabletop's train splits and on rendered pictures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RegionConfig {
    /// Size that the object's bounding sphere is brought to.
    pub object_px: f64,
    /// Side of the picture, in these.
    pub margin: f64,
    /// Length of a line's segments, coarse to fine.
    pub scales_px: Vec<f64>,
    /// Steps at each scale; the first has one.
    pub iterations: usize,
    /// Amplitude of the smoothed step: how sure a pixel's side is at best, 0 to 0.5.
    pub amplitude: f32,
    /// Lines need this much object and background, segments.
    pub shortest: f32,
    /// Colours of either side are taken from this far from the contour.
    pub colours_from_px: f32,
    /// To this far.
    pub colours_to_px: f32,
    /// Share of fresh colours in the histograms at each step.
    pub renewal: f32,
    /// Neighbouring lines that share one error.
    pub lines_per_error: f64,
    /// Standard deviation of a line that the colours do not know of.
    pub sigma_px: f64,
    /// Width of Tukey's loss, segments.
    pub tukey_segments: f64,
    /// Steps on edges at the end.
    pub edges: usize,
    /// Noise of a colour, 0..255.
    pub edge_noise: f32,
    /// Neighbouring edges that share one error.
    pub edges_per_error: f64,
    /// Width of Tukey's loss on edges, pixels of the image.
    pub edge_tukey_px: f64,
    /// Standard deviation of an edge that its colours do not know of, pixels of the image.
    pub edge_sigma_px: f64,
    /// Standard deviation of an offset that all lines share (blur, mesh), pixels of the image.
    pub common_px: f64,
    /// Fewer lines are no contour.
    pub min_lines: usize,
    /// More overlap of the histograms is one colour, 0..1.
    pub max_overlap: f32,
    /// What is known of rough poses.
    pub prior: PriorConfig,
}

impl Default for RegionConfig {
    fn default() -> Self {
        Self {
            object_px: 127.0,
            margin: 1.5,
            scales_px: vec![8.0, 5.0, 3.0, 2.0, 1.0],
            iterations: 2,
            amplitude: 0.36,
            shortest: 3.0,
            colours_from_px: 0.5,
            colours_to_px: 20.0,
            renewal: 0.8,
            lines_per_error: 8.0,
            sigma_px: 0.5,
            tukey_segments: 4.0,
            edges: 3,
            edge_noise: 8.0,
            edges_per_error: 8.0,
            edge_tukey_px: 2.0,
            edge_sigma_px: 0.5,
            common_px: 0.3,
            min_lines: 20,
            max_overlap: 0.9,
            prior: PriorConfig::default(),
        }
    }
}

impl RegionConfig {
    /// Checks every range.
    ///
    /// # Errors
    /// Names the first setting that is out of range.
    pub fn validate(&self) -> Result<(), ContourError> {
        let positive = |name, value: f64| (name, value, value > 0.0, "positive");
        let checks = [
            ("object_px", self.object_px, (32.0..=512.0).contains(&self.object_px), "in 32..=512"),
            ("margin", self.margin, (1.0..=4.0).contains(&self.margin), "in 1..=4"),
            ("scales_px", self.scales_px.len() as f64, !self.scales_px.is_empty(), "a list of at least one"),
            (
                "scales_px",
                self.scales_px.iter().copied().fold(f64::INFINITY, f64::min),
                self.scales_px.iter().all(|s| (1.0..=64.0).contains(s)),
                "in 1..=64",
            ),
            ("iterations", self.iterations as f64, self.iterations > 0, "at least 1"),
            ("amplitude", f64::from(self.amplitude), self.amplitude > 0.0 && self.amplitude < 0.5, "in 0..0.5"),
            ("renewal", f64::from(self.renewal), self.renewal > 0.0 && self.renewal <= 1.0, "in 0..=1, not 0"),
            ("colours_to_px", f64::from(self.colours_to_px), self.colours_to_px > self.colours_from_px, "further out"),
            positive("lines_per_error", self.lines_per_error),
            positive("sigma_px", self.sigma_px),
            positive("tukey_segments", self.tukey_segments),
            positive("edges_per_error", self.edges_per_error),
            positive("edge_tukey_px", self.edge_tukey_px),
            positive("edge_sigma_px", self.edge_sigma_px),
            positive("common_px", self.common_px),
            positive("prior.rotation_deg", self.prior.rotation_deg),
            positive("prior.xy", self.prior.xy),
            positive("prior.z", self.prior.z),
            positive("prior.freedom", self.prior.freedom),
        ];
        match checks.into_iter().find(|(_, value, good, _)| !good || !value.is_finite()) {
            Some((name, got, _, must)) => Err(ContourError::Setting { name, got, must }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_setting_out_of_range_is_named() {
        assert!(RegionConfig::default().validate().is_ok());
        let bad = RegionConfig { scales_px: vec![4.0, 0.5], ..RegionConfig::default() };
        assert!(bad.validate().unwrap_err().to_string().contains("scales_px"));
        let bad = RegionConfig { common_px: f64::NAN, ..RegionConfig::default() };
        assert!(bad.validate().unwrap_err().to_string().contains("common_px"));
        assert!(serde_json::from_str::<RegionConfig>(r#"{"scale_px": 3}"#).is_err());
    }
}
