//! Synthetic pairs for pre-training (docs/method.md, "Synthetic pre-training").
//!
//! A pair is what the flow network sees at run time: the reference, rendered at a wrong pose with the rasteriser of
//! the renderer node, and the crop of a camera's image at the same place. The camera's image is imitated at the
//! camera's resolution (a far object is a *magnified* crop), in linear light, with other things before and behind
//! the object, shadows, lens, noise and JPEG; only then it is resampled by the very function that crops real frames.
//!
//! Begin with [`SampleGenerator`]. One scene (objects, light, camera) is shaded once and serves several pairs, each with its own reference pose, crop,
//! colours of the reference and settings of the sensor. Everything is a function of the seed and an index.
//!
//! ```
//! use pseudoflow_synthetic::{ObjectPool, SampleGenerator, SynthConfig};
//! use std::sync::Arc;
//!
//! let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../config/objects/tabletop");
//! let objects = Arc::new(ObjectPool::load(&[folder.into()])?);
//! let generator = SampleGenerator::new(objects, SynthConfig::default(), 7)?; // the same seed, the same pairs
//! let pairs = generator.batch(0, 2, 64)?;
//! assert_eq!((pairs.len(), pairs[0].reference.dimensions()), (2, (64, 64)));
//! # Ok::<(), pseudoflow_synthetic::SyntheticError>(())
//! ```

mod card;
mod config;
mod error;
mod label;
mod light;
mod pattern;
mod photo;
mod picture;
mod pool;
mod pose;
mod preview;
mod random;
mod recolour;
mod rest;
mod sample_objects;
mod scene;
mod scene_images;
mod sensor;
mod shapes;
mod simple_shapes;
mod window;

#[cfg(test)]
pub(crate) mod tests;

pub use card::{Card, Origin, Ship};
pub use config::{CameraConfig, JitterConfig, LookConfig, MAX_JITTER_DEG, Spread, SynthConfig};
pub use error::SyntheticError;
pub use label::SyntheticFlow;
pub use pool::ObjectPool;
pub use preview::preview_sheet;
pub use sample_objects::write_sample_objects;
pub use scene_images::{SceneConfig, SceneGenerator, SceneInstance, SceneSample};

use label::Geometry;
use photo::PhotoBank;
use picture::{Picture, samples_alone};
use pose::{Placement, Stand};
use pseudoflow_geometry::{Crop, Intrinsics, Pose};
use pseudoflow_imaging::raster::{
    Background, Headlight, Item, Rendering, Scene, Scratch, Shader, normals_from_depth, render_scene,
};
use pseudoflow_imaging::{BACKGROUND_GREY, Object, RgbImage, resample};
use random::stream;
use rayon::prelude::*;
use recolour::{Plain, Recolour};
use scene::{Stock, SyntheticScene};
use sensor::{Sensor, mean_light};
use shapes::ShapeBank;
use std::path::PathBuf;
use std::sync::Arc;
use window::Window;

/// One synthetic pair.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// The object's place: that in the pool, or after it the number of the procedural shape ([`SampleGenerator::object`]).
    pub object: usize,
    /// The reference rendered at the wrong pose, `S x S`.
    pub reference: RgbImage,
    /// What the camera sees in the same crop, `S x S`.
    pub real_like: RgbImage,
    /// The true flow from the former to the latter, and the reference's depth and normals.
    pub label: SyntheticFlow,
    /// K' of the crop.
    pub intrinsics: Intrinsics,
    /// The object's diameter, metres.
    pub diameter_m: f64,
    /// The pose at which the reference was rendered, metres.
    pub reference_camera_from_object: Pose,
    /// The true pose, metres.
    pub truth_camera_from_object: Pose,
    /// The crop in the camera's image.
    pub crop: Crop,
}

/// Makes samples of a pool of objects. A sample depends on the seed, its index and its size only: sample i is the
/// `i % n`-th of scene `i / n`, where n is `pairs_per_scene`.
#[derive(Debug, Clone)]
pub struct SampleGenerator {
    objects: Arc<ObjectPool>,
    shapes: Arc<ShapeBank>,
    photos: Arc<PhotoBank>,
    config: Arc<SynthConfig>,
    seed: u64,
}

/// How often a scene whose object is hardly visible is drawn again.
const ATTEMPTS: u64 = 16;

/// Samples that show the object on less than this share of the crop teach nothing.
const LEAST_SHARE: f64 = 0.005;

impl SampleGenerator {
    /// # Errors
    /// When the configuration is out of range.
    pub fn new(objects: Arc<ObjectPool>, config: SynthConfig, seed: u64) -> Result<Self, SyntheticError> {
        config.check()?;
        let shapes = Arc::new(ShapeBank::new(seed, config.look.procedural_shapes));
        Ok(Self { objects, shapes, photos: Arc::default(), config: Arc::new(config), seed })
    }

    /// Takes photographs from folders (and the folders in them) for walls, tables and cards; `only_shippable`: without those
    /// of which `meta.json` says that they may not be shipped, or nothing clear.
    ///
    /// # Errors
    /// When a folder cannot be read or holds no usable picture.
    pub fn with_backgrounds(self, folders: &[PathBuf], only_shippable: bool) -> Result<Self, SyntheticError> {
        Ok(Self { photos: Arc::new(PhotoBank::load(folders, only_shippable)?), ..self })
    }

    /// What the scenes are made from.
    #[must_use]
    pub fn card(&self) -> Card {
        let shapes = if self.config.look.procedural > 0.0 { self.shapes.len() } else { 0 };
        Card::new(self.objects.origins().to_vec(), self.photos.origins().to_vec(), shapes)
    }

    /// Scenes of the same kind with other objects and another seed.
    #[must_use]
    pub fn of_other_objects(&self, objects: Arc<ObjectPool>, seed: u64) -> Self {
        let shapes = Arc::new(ShapeBank::new(seed, self.config.look.procedural_shapes));
        Self { objects, shapes, seed, ..self.clone() }
    }

    /// The object of a sample.
    ///
    /// # Errors
    /// When a procedural shape cannot be made.
    pub fn object(&self, place: usize) -> Result<Arc<Object>, SyntheticError> {
        Ok(Arc::clone(self.stock().at(place)?))
    }

    fn stock(&self) -> Stock<'_> {
        Stock { objects: &self.objects, shapes: &self.shapes, photos: &self.photos, look: &self.config.look }
    }

    /// The objects.
    #[must_use]
    pub fn objects(&self) -> &ObjectPool {
        &self.objects
    }

    /// How many samples a scene serves.
    #[must_use]
    pub fn pairs_per_scene(&self) -> usize {
        self.config.pairs_per_scene
    }

    /// All samples of a scene, with crops of `size_px` pixels.
    ///
    /// # Errors
    /// When the object set is such that no visible sample can be drawn.
    pub fn scene(&self, index: u64, size_px: u32) -> Result<Vec<Sample>, SyntheticError> {
        for attempt in 0..ATTEMPTS {
            if let Some(samples) = self.attempt(index, attempt, size_px)? {
                return Ok(samples);
            }
        }
        Err(SyntheticError::Invisible { seed: self.seed, index })
    }

    /// The sample with an index. It costs the whole scene.
    ///
    /// # Errors
    /// As [`SampleGenerator::scene`].
    pub fn sample(&self, index: u64, size_px: u32) -> Result<Sample, SyntheticError> {
        let n = self.pairs_per_scene() as u64;
        Ok(self.scene(index / n, size_px)?.swap_remove((index % n) as usize))
    }

    /// `count` samples from `first` on, made in parallel, in order.
    ///
    /// # Errors
    /// As [`SampleGenerator::scene`].
    pub fn batch(&self, first: u64, count: usize, size_px: u32) -> Result<Vec<Sample>, SyntheticError> {
        let n = self.pairs_per_scene() as u64;
        let scenes = first / n..(first + count as u64).div_ceil(n);
        let made: Vec<_> = scenes.into_par_iter().map(|i| self.scene(i, size_px)).collect::<Result<_, _>>()?;
        Ok(made.into_iter().flatten().skip((first % n) as usize).take(count).collect())
    }

    fn attempt(&self, index: u64, attempt: u64, size_px: u32) -> Result<Option<Vec<Sample>>, SyntheticError> {
        let mut rng = stream(self.seed, index * ATTEMPTS + attempt);
        let (config, stock) = (&*self.config, self.stock());
        let (place, object) = stock.any(&mut rng, config.look.procedural)?;
        let stand = Stand::draw(&mut rng, object, config, size_px);
        let placements: Vec<Placement> = (0..config.pairs_per_scene)
            .map(|_| Placement::draw(&mut rng, object, &stand, &config.jitter, config, size_px))
            .collect();
        let at_truth = Crop::around(
            &object.hull_m,
            &stand.truth_camera_from_object,
            &stand.intrinsics,
            config.crop_margin[1],
            size_px,
        );
        let crops = placements.iter().map(|p| &p.crop).chain(&at_truth);
        let window = Window::of_crops(crops, &stand.intrinsics, stand.image_px);
        let mut scene = SyntheticScene::draw(&mut rng, &stock, object, &stand, config)?;
        let mut picture = scene.render(&window);
        let alone = samples_alone(scene.target(), &window);
        if (picture.visible.of_object() as f64) < config.visible_min * alone as f64 {
            scene.remove_occluders();
            picture = scene.render(&window);
        }
        let mut samples = Vec::with_capacity(placements.len());
        for placement in placements {
            let rendered = RenderedScene { place, object, stand: &stand, window: &window, picture: &picture };
            let Some(sample) = rendered.pair(&mut rng, placement, config) else { return Ok(None) };
            samples.push(sample);
        }
        Ok(Some(samples))
    }
}

/// A rendered scene, from which pairs are made.
struct RenderedScene<'a> {
    place: usize,
    object: &'a Object,
    stand: &'a Stand,
    window: &'a Window,
    picture: &'a Picture,
}

impl RenderedScene<'_> {
    /// A pair; where its crop shows too little of the object, one at the true pose instead. `None` when that shows too
    /// little as well.
    fn pair(&self, rng: &mut impl rand::Rng, placement: Placement, config: &SynthConfig) -> Option<Sample> {
        let size_px = placement.crop.size_px;
        let least = LEAST_SHARE * f64::from(size_px * size_px);
        let (mut placement, mut reference) = (placement.clone(), render_reference(self.object, &placement));
        let mut label = self.label(&placement, &mut reference);
        if (label.visible_px() as f64) < least {
            placement = Placement::draw(rng, self.object, self.stand, &[], config, size_px);
            reference = render_reference(self.object, &placement);
            label = self.label(&placement, &mut reference);
        }
        if (label.visible_px() as f64) < least {
            return None;
        }
        match Recolour::draw(rng, &config.look) {
            Some(Recolour::Plain(grey)) => reference = render_with(self.object, &placement, &Plain(grey)),
            Some(Recolour::Changed(change)) => change.apply(&mut reference.rgb, &reference.mask),
            None => {}
        }
        let near = Window::of_crop(&placement.crop, &placement.intrinsics, self.stand.image_px).within(self.window);
        let light = near.part_of(self.window, &self.picture.light);
        let sensor = Sensor::draw(rng, &config.camera).scaled(self.stand.scale as f32);
        let camera_image = sensor.expose(&light, mean_light(&light), rng);
        Some(Sample {
            object: self.place,
            real_like: resample(&camera_image, &near.crop(&placement.crop)),
            reference: reference.rgb,
            label,
            intrinsics: placement.crop.intrinsics(&placement.intrinsics),
            diameter_m: self.object.diameter_m,
            reference_camera_from_object: placement.reference_camera_from_object,
            truth_camera_from_object: placement.truth_camera_from_object,
            crop: placement.crop,
        })
    }

    fn label(&self, placement: &Placement, reference: &mut Rendering) -> SyntheticFlow {
        let k = placement.crop.intrinsics(&placement.intrinsics);
        let depth_m = std::mem::take(&mut reference.depth_m);
        let normals = normals_from_depth(&depth_m, placement.crop.size_px as usize, &k);
        let geometry = Geometry { depth_m, normals };
        SyntheticFlow::of(geometry, &self.picture.visible, placement, self.window, self.object.diameter_m)
    }
}

/// The reference, as the renderer node makes it.
fn render_reference(object: &Object, placement: &Placement) -> Rendering {
    render_with(object, placement, &Headlight::default())
}

fn render_with(object: &Object, placement: &Placement, shader: &impl Shader) -> Rendering {
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
    render_scene(&scene, shader, &mut Scratch::default(), &mut rendering);
    rendering
}
