//! What synthetic scenes look like. Defaults fit household objects before a 640 x 480 camera.

use crate::TrainerError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Ranges of the synthetic scenes. Unknown keys are rejected.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SynthConfig {
    /// Width and height of the camera's images, pixels.
    pub image_px: [u32; 2],
    /// Range of the focal length, pixels; drawn for each sample.
    pub focal_px: [f64; 2],
    /// Range of the projected diameter `f d / z`, pixels; drawn evenly in its logarithm. It stands for the distance.
    pub projected_px: [f64; 2],
    /// Share of the objects that may reach over the image border.
    pub truncated: f64,
    /// Share of the scenes with something in front of the object.
    pub occluded: f64,
    /// Least visible part of the object; scenes with less are shown without what stands in front.
    pub visible_min: f64,
    /// Kinds of jitter from truth to reference pose; one is drawn for each sample.
    pub jitter: Vec<JitterConfig>,
    /// Range of the crop's side over the larger side of the projection (method.md, step 2).
    pub crop_margin: [f64; 2],
}

/// Jitter from truth to reference pose: normal in each Euler angle and each axis of the camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JitterConfig {
    /// How often this one is drawn, relative to the others.
    pub weight: f64,
    /// Standard deviation of each Euler angle, degrees.
    pub angle_deg: f64,
    /// Standard deviation in x and y, in diameters.
    pub xy_diameters: f64,
    /// Standard deviation in z, in diameters.
    pub z_diameters: f64,
}

/// The largest angle between reference and truth, degrees (method.md).
pub const MAX_JITTER_DEG: f64 = 45.0;

impl Default for SynthConfig {
    /// The jitter of method.md (15 deg, 15 mm, 50 mm for objects of about 0.2 m), that of rough initial poses, and a
    /// small one for the second pass.
    fn default() -> Self {
        let jitter = |weight, angle_deg, xy_diameters, z_diameters| JitterConfig {
            weight,
            angle_deg,
            xy_diameters,
            z_diameters,
        };
        Self {
            image_px: [640, 480],
            focal_px: [540.0, 680.0],
            projected_px: [50.0, 330.0],
            truncated: 0.2,
            occluded: 0.45,
            visible_min: 0.3,
            jitter: vec![jitter(0.35, 15.0, 0.07, 0.2), jitter(0.45, 9.0, 0.03, 0.14), jitter(0.2, 3.0, 0.01, 0.03)],
            crop_margin: [1.0, 1.25],
        }
    }
}

impl SynthConfig {
    /// Checks the ranges.
    ///
    /// # Errors
    /// Names the first field out of range.
    pub fn check(&self) -> Result<(), TrainerError> {
        let range = |[low, high]: [f64; 2], from: f64, to: f64| low >= from && high <= to && low <= high;
        let share = |v: f64| (0.0..=1.0).contains(&v);
        let positive = |j: &JitterConfig| {
            [j.weight, j.angle_deg, j.xy_diameters, j.z_diameters].iter().all(|v| v.is_finite() && *v >= 0.0)
                && j.angle_deg <= 30.0
        };
        let rules = [
            ("image_px", self.image_px.iter().all(|v| (64..=4096).contains(v)), "two numbers from 64 to 4096"),
            ("focal_px", range(self.focal_px, 20.0, 20_000.0), "low, high from 20 to 20000"),
            ("projected_px", range(self.projected_px, 16.0, 2000.0), "low, high from 16 to 2000"),
            ("truncated", share(self.truncated), "a share from 0 to 1"),
            ("occluded", share(self.occluded), "a share from 0 to 1"),
            ("visible_min", (0.0..=0.9).contains(&self.visible_min), "a share from 0 to 0.9"),
            ("crop_margin", range(self.crop_margin, 1.0, 3.0), "low, high from 1 to 3"),
            ("jitter", self.jitter.iter().all(positive), "no negative number, and angle_deg of at most 30"),
            ("jitter", self.jitter.iter().map(|j| j.weight).sum::<f64>() > 0.0, "at least one with a weight over 0"),
        ];
        match rules.iter().find(|(_, holds, _)| !holds) {
            Some((field, _, wanted)) => Err(TrainerError::Config { field: format!("synth.{field}"), wanted }),
            None => Ok(()),
        }
    }
}
