//! What synthetic scenes look like. Defaults fit household objects before a 640 x 480 camera.

use crate::SyntheticError;
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
    /// Range of the crop's side over the larger side of the projection (docs/method.md, step 2).
    pub crop_margin: [f64; 2],
    /// Pairs that one scene serves: same objects and light, other reference poses, crops and cameras.
    pub pairs_per_scene: usize,
    /// Cameras whose crops would be more than this often as wide as the network's input are replaced by ones of a lower
    /// resolution (with less blur and noise, as shrinking would leave).
    pub most_oversampled: f64,
    /// What scenes look like.
    pub look: LookConfig,
    /// The camera.
    pub camera: CameraConfig,
}

/// What scenes look like. Shares are parts of the scenes, things or pairs; 0 switches an ingredient off.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LookConfig {
    /// Share of the objects to be found that are procedural shapes.
    pub procedural: f64,
    /// How many different procedural shapes there are.
    pub procedural_shapes: usize,
    /// Share of walls, tables and cards that show a photograph, where some are given.
    pub photos: f64,
    /// Most other things around the object.
    pub most_neighbours: usize,
    /// Share of the objects that lie on the table as they would come to rest.
    pub resting: f64,
    /// Share of the scenes whose lamps cast shadows.
    pub shadows: f64,
    /// Share of the scenes that are lit mostly from one side.
    pub hard_light: f64,
    /// Strength of ambient occlusion, by the object itself and by what stands above a place.
    pub ambient_occlusion: f64,
    /// Share of the things that are glossy.
    pub gloss: f64,
    /// Share of the references whose colours are not quite those of the real object: gain, gamma, tint, saturation.
    pub wrong_colours: f64,
    /// Share of the references without colours, in one grey.
    pub plain_reference: f64,
}

impl Default for LookConfig {
    fn default() -> Self {
        Self {
            procedural: 0.3,
            procedural_shapes: 2000,
            photos: 0.75,
            most_neighbours: 12,
            resting: 0.5,
            shadows: 0.75,
            hard_light: 0.4,
            ambient_occlusion: 1.0,
            gloss: 0.6,
            wrong_colours: 0.5,
            plain_reference: 0.06,
        }
    }
}

impl LookConfig {
    fn in_range(&self) -> bool {
        let shares = [
            self.procedural,
            self.photos,
            self.resting,
            self.shadows,
            self.hard_light,
            self.ambient_occlusion,
            self.gloss,
            self.wrong_colours,
            self.plain_reference,
        ];
        let counts = self.most_neighbours <= 40 && self.procedural_shapes <= 1_000_000;
        counts
            && shares.iter().all(|v| (0.0..=1.0).contains(v))
            && (self.procedural == 0.0 || self.procedural_shapes > 0)
    }
}

/// The camera that takes the real-like images. Shares are parts of the images, strengths are relative to 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CameraConfig {
    /// Share of the cameras with a colour filter array (Bayer) that is interpolated.
    pub bayer: f64,
    /// Share with motion during the exposure.
    pub motion_blur: f64,
    /// Share that is out of focus.
    pub defocus: f64,
    /// Strength of the noise.
    pub noise: f64,
    /// Standard deviation of the exposure, stops.
    pub exposure_stops: f64,
    /// Share that sharpens.
    pub sharpening: f64,
    /// Share that writes JPEG.
    pub jpeg: f64,
    /// Strength of the variation of white balance, saturation and tone curve.
    pub colour: f64,
}

impl Default for CameraConfig {
    fn default() -> Self {
        Self {
            bayer: 0.6,
            motion_blur: 0.2,
            defocus: 0.1,
            noise: 1.0,
            exposure_stops: 0.75,
            sharpening: 0.4,
            jpeg: 0.7,
            colour: 1.0,
        }
    }
}

impl CameraConfig {
    /// A camera that adds nothing but the blur of its lens.
    #[must_use]
    pub fn ideal() -> Self {
        Self {
            bayer: 0.0,
            motion_blur: 0.0,
            defocus: 0.0,
            noise: 0.0,
            exposure_stops: 0.0,
            sharpening: 0.0,
            jpeg: 0.0,
            colour: 0.0,
        }
    }

    fn in_range(&self) -> bool {
        let shares = [self.bayer, self.motion_blur, self.defocus, self.sharpening, self.jpeg];
        let strengths = [self.noise, self.exposure_stops, self.colour];
        shares.iter().all(|v| (0.0..=1.0).contains(v)) && strengths.iter().all(|v| (0.0..=3.0).contains(v))
    }
}

/// How the numbers of a jitter are spread.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Spread {
    /// Normal in each Euler angle (resampled beyond [`MAX_JITTER_DEG`]) and each axis of the camera.
    #[default]
    Normal,
    /// About any axis by an angle that is uniform from 0 to `angle_deg`; x, y and z uniform within plus and minus the
    /// given diameters.
    Uniform,
}

/// Jitter from truth to reference pose, in the camera's axes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JitterConfig {
    /// How often this one is drawn, relative to the others.
    pub weight: f64,
    /// Standard deviation of each Euler angle, or the largest angle, degrees.
    pub angle_deg: f64,
    /// Standard deviation or largest offset in x and y, in diameters.
    pub xy_diameters: f64,
    /// Standard deviation or largest offset in z, in diameters.
    pub z_diameters: f64,
    /// How they are spread.
    #[serde(default)]
    pub spread: Spread,
}

/// The largest angle between reference and truth with normal jitter, degrees (docs/method.md).
pub const MAX_JITTER_DEG: f64 = 45.0;

impl JitterConfig {
    /// Normal jitter.
    #[must_use]
    pub fn normal(weight: f64, angle_deg: f64, xy_diameters: f64, z_diameters: f64) -> Self {
        Self { weight, angle_deg, xy_diameters, z_diameters, spread: Spread::Normal }
    }

    /// Uniform jitter.
    #[must_use]
    pub fn uniform(weight: f64, angle_deg: f64, xy_diameters: f64, z_diameters: f64) -> Self {
        Self { weight, angle_deg, xy_diameters, z_diameters, spread: Spread::Uniform }
    }

    fn in_range(&self) -> bool {
        let most_deg = if self.spread == Spread::Normal { 30.0 } else { 180.0 };
        let numbers = [self.weight, self.angle_deg, self.xy_diameters, self.z_diameters];
        numbers.iter().all(|v| v.is_finite() && *v >= 0.0) && self.angle_deg <= most_deg && self.z_diameters <= 2.0
    }
}

impl Default for SynthConfig {
    /// For one refiner of all objects: a fifth of the pairs with any rotation up to 90 deg and half a diameter in depth,
    /// the jitter of docs/method.md (15 deg, 15 mm, 50 mm for objects of about 0.2 m), that of rough initial poses, and a
    /// small one for the second pass.
    fn default() -> Self {
        Self {
            image_px: [640, 480],
            focal_px: [540.0, 680.0],
            projected_px: [40.0, 330.0],
            truncated: 0.2,
            occluded: 0.5,
            visible_min: 0.25,
            jitter: vec![
                JitterConfig::uniform(0.2, 90.0, 0.15, 0.5),
                JitterConfig::normal(0.25, 15.0, 0.07, 0.2),
                JitterConfig::normal(0.35, 9.0, 0.03, 0.14),
                JitterConfig::normal(0.2, 2.5, 0.01, 0.03),
            ],
            crop_margin: [1.0, 1.25],
            pairs_per_scene: 6,
            most_oversampled: 1.4,
            look: LookConfig::default(),
            camera: CameraConfig::default(),
        }
    }
}

impl SynthConfig {
    /// For a network of one object set that only refines rough poses: without the wide jitter.
    #[must_use]
    pub fn for_rough_poses() -> Self {
        let jitter = vec![
            JitterConfig::normal(0.35, 15.0, 0.07, 0.2),
            JitterConfig::normal(0.45, 9.0, 0.03, 0.14),
            JitterConfig::normal(0.2, 3.0, 0.01, 0.03),
        ];
        Self { jitter, ..Self::default() }
    }

    /// Checks the ranges.
    ///
    /// # Errors
    /// Names the first field out of range.
    pub fn check(&self) -> Result<(), SyntheticError> {
        let range = |[low, high]: [f64; 2], from: f64, to: f64| low >= from && high <= to && low <= high;
        let share = |v: f64| (0.0..=1.0).contains(&v);
        let rules = [
            ("image_px", self.image_px.iter().all(|v| (64..=4096).contains(v)), "two numbers from 64 to 4096"),
            ("focal_px", range(self.focal_px, 20.0, 20_000.0), "low, high from 20 to 20000"),
            ("projected_px", range(self.projected_px, 16.0, 2000.0), "low, high from 16 to 2000"),
            ("truncated", share(self.truncated), "a share from 0 to 1"),
            ("occluded", share(self.occluded), "a share from 0 to 1"),
            ("visible_min", (0.0..=0.9).contains(&self.visible_min), "a share from 0 to 0.9"),
            ("crop_margin", range(self.crop_margin, 1.0, 3.0), "low, high from 1 to 3"),
            ("pairs_per_scene", (1..=32).contains(&self.pairs_per_scene), "1 to 32"),
            (
                "look",
                self.look.in_range(),
                "shares from 0 to 1, at most 40 neighbours, procedural_shapes from 1 to 1000000",
            ),
            ("camera", self.camera.in_range(), "shares from 0 to 1 and strengths from 0 to 3"),
            ("most_oversampled", (0.5..=100.0).contains(&self.most_oversampled), "0.5 to 100"),
            (
                "jitter",
                self.jitter.iter().all(JitterConfig::in_range),
                "no negative number, angle_deg of at most 30 (uniform: 180), z_diameters of at most 2",
            ),
            ("jitter", self.jitter.iter().map(|j| j.weight).sum::<f64>() > 0.0, "at least one with a weight over 0"),
        ];
        match rules.iter().find(|(_, holds, _)| !holds) {
            Some((field, _, wanted)) => Err(SyntheticError::Config { field: format!("synth.{field}"), wanted }),
            None => Ok(()),
        }
    }
}
