//! Synthetic pairs for pre-training (method.md, "Synthetic pre-training").
//!
//! A pair is what the flow network sees at run time: the reference, rendered at a wrong pose with the rasteriser of
//! the renderer node, and the crop of a camera's image at the same place. The camera's image is imitated at the
//! camera's resolution (a far object is a *magnified* crop), in linear light, with other things before and behind
//! the object, shadows, lens, noise and JPEG; only then it is resampled by the very function that crops real frames.

mod config;
mod label;
mod light;
mod pattern;
mod pose;
mod random;
mod scene;
mod sensor;
mod things;
mod whole;
mod window;

#[cfg(test)]
pub(crate) mod tests;

pub use config::{JitterConfig, MAX_JITTER_DEG, SynthConfig};
pub use label::SyntheticFlow;
pub use whole::{SceneConfig, SceneGenerator, SceneInstance, SceneSample};

use crate::TrainerError;
use pose::Placement;
use pseudoflow_geometry::{Crop, Pose};
use pseudoflow_imaging::raster::{Background, Headlight, Item, Rendering, Scene, Scratch, render_scene};
use pseudoflow_imaging::{BACKGROUND_GREY, Object, ObjectSet, RgbImage, resample};
use random::{Draw, stream};
use rayon::prelude::*;
use scene::SyntheticScene;
use sensor::Sensor;
use std::sync::Arc;
use window::Window;

/// One synthetic pair.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// The object.
    pub object_id: u32,
    /// The reference rendered at the wrong pose, `S x S`.
    pub reference: RgbImage,
    /// What the camera sees in the same crop, `S x S`.
    pub real_like: RgbImage,
    /// The true flow from the former to the latter.
    pub label: SyntheticFlow,
    /// The pose at which the reference was rendered, metres.
    pub reference_camera_from_object: Pose,
    /// The true pose, metres.
    pub truth_camera_from_object: Pose,
    /// The crop in the camera's image.
    pub crop: Crop,
}

/// Makes samples of an object set. A sample depends on the seed, its index and its size only.
#[derive(Debug, Clone)]
pub struct SampleGenerator {
    objects: Arc<ObjectSet>,
    config: SynthConfig,
    seed: u64,
}

/// How often a sample whose object is hardly visible is drawn again.
const ATTEMPTS: u64 = 16;

/// Samples that show the object on less than this share of the crop teach nothing.
const LEAST_SHARE: f64 = 0.005;

impl SampleGenerator {
    /// # Errors
    /// When the configuration is out of range.
    pub fn new(objects: Arc<ObjectSet>, config: SynthConfig, seed: u64) -> Result<Self, TrainerError> {
        config.check()?;
        Ok(Self { objects, config, seed })
    }

    /// The sample with an index, with crops of `size_px` pixels.
    ///
    /// # Errors
    /// When the image codec fails, or the object set is such that no visible sample can be drawn.
    pub fn sample(&self, index: u64, size_px: u32) -> Result<Sample, TrainerError> {
        for attempt in 0..ATTEMPTS {
            let sample = self.attempt(index, attempt, size_px)?;
            let (visible, foreground) = (sample.label.visible_px() as f64, sample.label.foreground_px() as f64);
            let least = LEAST_SHARE * f64::from(size_px * size_px);
            if visible >= least.max(self.config.visible_min * foreground) {
                return Ok(sample);
            }
        }
        Err(TrainerError::Invisible { seed: self.seed, index })
    }

    /// `count` samples from `first` on, made in parallel, in order.
    ///
    /// # Errors
    /// As [`SampleGenerator::sample`].
    pub fn batch(&self, first: u64, count: usize, size_px: u32) -> Result<Vec<Sample>, TrainerError> {
        (0..count as u64).into_par_iter().map(|i| self.sample(first + i, size_px)).collect()
    }

    fn attempt(&self, index: u64, attempt: u64, size_px: u32) -> Result<Sample, TrainerError> {
        let mut rng = stream(self.seed, index * ATTEMPTS + attempt);
        let object = self.draw_object(&mut rng)?;
        let placement = Placement::draw(&mut rng, object, &self.config, size_px);
        let window = Window::of_crop(&placement.crop, &placement.intrinsics, self.config.image_px);
        let reference = render_reference(object, &placement);
        let mut scene = SyntheticScene::draw(&mut rng, &self.objects, object, &placement, &self.config)?;
        let mut picture = scene.render(&window);
        let label =
            |visible: &Rendering| SyntheticFlow::of(&reference, visible, &placement, &window, object.diameter_m);
        let mut truth = label(&picture.visible);
        if (truth.visible_px() as f64) < self.config.visible_min * truth.foreground_px() as f64 {
            scene.remove_occluders();
            picture = scene.render(&window);
            truth = label(&picture.visible);
        }
        let camera_image = Sensor::draw(&mut rng).expose(&picture.light, &mut rng)?;
        Ok(Sample {
            object_id: object.id,
            real_like: resample(&camera_image, &window.crop(&placement.crop)),
            reference: reference.rgb,
            label: truth,
            reference_camera_from_object: placement.reference_camera_from_object,
            truth_camera_from_object: placement.truth_camera_from_object,
            crop: placement.crop,
        })
    }

    fn draw_object(&self, rng: &mut impl rand::Rng) -> Result<&Object, TrainerError> {
        let chosen = rng.below(self.objects.len());
        self.objects
            .iter()
            .nth(chosen)
            .ok_or_else(|| TrainerError::NoObjects { folder: self.objects.folder().to_owned() })
    }
}

/// The reference, as the renderer node makes it.
fn render_reference(object: &Object, placement: &Placement) -> Rendering {
    let size = placement.crop.size_px;
    let item = Item { mesh: &object.mesh, camera_from_object: placement.reference_camera_from_object };
    let scene = Scene {
        items: &[item],
        intrinsics: placement.crop.intrinsics(&placement.intrinsics),
        width: size,
        height: size,
        background: Background::Colour([BACKGROUND_GREY; 3]),
    };
    let mut rendering = Rendering::new(size, size);
    render_scene(&scene, &Headlight::default(), &mut Scratch::default(), &mut rendering);
    rendering
}
