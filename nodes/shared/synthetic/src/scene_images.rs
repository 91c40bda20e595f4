//! Synthetic images of whole scenes, for the initializer (docs/method.md, pipeline step 1).

use super::card::Card;
use super::config::{CameraConfig, LookConfig};
use super::photo::PhotoBank;
use super::picture::Picture;
use super::pool::ObjectPool;
use super::random::{Draw, stream};
use super::scene::{Stock, SyntheticScene};
use super::sensor::{Sensor, mean_light};
use super::shapes::ShapeBank;
use super::window::{SAMPLES, Window};
use crate::SyntheticError;
use pseudoflow_geometry::{Intrinsics, Pose};
use pseudoflow_imaging::{ObjectSet, RgbImage};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;

/// Ranges of the synthetic scenes. Unknown keys are rejected.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneConfig {
    /// Width and height of the camera's images, pixels, as the network sees them.
    pub image_px: [u32; 2],
    /// Range of the focal length, pixels.
    pub focal_px: [f64; 2],
    /// Range of an average object's projected diameter at the middle of the scene, pixels.
    pub projected_px: [f64; 2],
    /// Most objects of the set in a scene; at least two are tried where it allows.
    pub most_objects: u32,
    /// Most other things in a scene.
    pub most_others: u32,
    /// Share of the scenes with something close to the camera.
    pub occluded: f64,
    /// Share of the scenes in which an arm reaches before one of the objects.
    #[serde(default)]
    pub reached_into: f64,
}

impl SceneConfig {
    /// Ranges for household objects seen by a camera whose images are this wide and high, pixels.
    #[must_use]
    pub fn for_images(width: u32, height: u32) -> Self {
        let scale = f64::from(width) / 640.0;
        Self {
            image_px: [width, height],
            focal_px: [540.0 * scale, 680.0 * scale],
            projected_px: [90.0 * scale, 250.0 * scale],
            most_objects: 8,
            most_others: 6,
            occluded: 0.25,
            reached_into: 0.4,
        }
    }

    /// Checks the ranges.
    ///
    /// # Errors
    /// Names the first field out of range.
    pub fn check(&self) -> Result<(), SyntheticError> {
        let range = |[low, high]: [f64; 2], from: f64, to: f64| low >= from && high <= to && low <= high;
        let rules = [
            ("image_px", self.image_px.iter().all(|v| (64..=2048).contains(v)), "two numbers from 64 to 2048"),
            ("focal_px", range(self.focal_px, 20.0, 20_000.0), "low, high from 20 to 20000"),
            ("projected_px", range(self.projected_px, 8.0, 2000.0), "low, high from 8 to 2000"),
            ("most_objects", (1..=64).contains(&self.most_objects), "1 to 64"),
            ("most_others", self.most_others <= 64, "0 to 64"),
            ("occluded", (0.0..=1.0).contains(&self.occluded), "a share from 0 to 1"),
            ("reached_into", (0.0..=1.0).contains(&self.reached_into), "a share from 0 to 1"),
        ];
        match rules.iter().find(|(_, holds, _)| !holds) {
            Some((field, _, wanted)) => Err(SyntheticError::Config { field: format!("scenes.{field}"), wanted }),
            None => Ok(()),
        }
    }
}

/// One object in a [`SceneSample`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneInstance {
    /// The object.
    pub object_id: u32,
    /// Its true pose, metres.
    pub camera_from_object: Pose,
}

/// One synthetic image and what it shows.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneSample {
    /// The camera's image.
    pub image: RgbImage,
    /// Its camera.
    pub intrinsics: Intrinsics,
    /// The objects of the set.
    pub instances: Vec<SceneInstance>,
    /// For each pixel the instance that is seen there, counted from 1; 0 for anything else.
    pub owner: Vec<u8>,
    /// Depth of each pixel, metres; 0 where nothing is.
    pub depth_m: Vec<f32>,
}

/// Makes scenes of an object set. A scene depends on the seed and its index only.
#[derive(Debug, Clone)]
pub struct SceneGenerator {
    objects: Arc<ObjectPool>,
    clutter: Option<Arc<Clutter>>,
    config: SceneConfig,
    seed: u64,
}

/// What stands between the objects of a scene and behind them.
#[derive(Debug)]
struct Clutter {
    others: ObjectPool,
    shapes: ShapeBank,
    photos: PhotoBank,
    look: LookConfig,
}

impl Clutter {
    fn stock(&self) -> Stock<'_> {
        Stock { objects: &self.others, shapes: &self.shapes, photos: &self.photos, look: &self.look }
    }
}

impl SceneGenerator {
    /// # Errors
    /// When the configuration is out of range, or the `meta.json` of the set's folder is damaged.
    pub fn new(objects: Arc<ObjectSet>, config: SceneConfig, seed: u64) -> Result<Self, SyntheticError> {
        config.check()?;
        let objects = Arc::new(ObjectPool::of_sets(std::slice::from_ref(&*objects))?);
        Ok(Self { objects, clutter: None, config, seed })
    }

    /// Puts other things between the objects, as rooms have them: meshes of BOP `models/` folders (none of them may be of the set),
    /// procedural shapes, and photographs on cards, tables and walls. `only_shippable`: without meshes and photographs of which
    /// `meta.json` says that they may not be shipped, or nothing clear.
    ///
    /// # Errors
    /// When a folder cannot be read or holds nothing usable.
    pub fn with_clutter(
        self,
        others: &[PathBuf],
        backgrounds: &[PathBuf],
        only_shippable: bool,
    ) -> Result<Self, SyntheticError> {
        let others = match others.is_empty() {
            true => ObjectPool::of_sets(&[])?,
            false if only_shippable => ObjectPool::load(others)?.only_shippable()?,
            false => ObjectPool::load(others)?,
        };
        let photos = PhotoBank::load(backgrounds, only_shippable)?;
        let look = LookConfig::default();
        let shapes = ShapeBank::new(self.seed, look.procedural_shapes);
        Ok(Self { clutter: Some(Arc::new(Clutter { others, shapes, photos, look })), ..self })
    }

    /// What the scenes are made from.
    #[must_use]
    pub fn card(&self) -> Card {
        let objects = self.objects.origins().iter();
        let Some(clutter) = &self.clutter else { return Card::new(objects.cloned().collect(), vec![], 0) };
        let objects = objects.chain(clutter.others.origins()).cloned().collect();
        Card::new(objects, clutter.photos.origins().to_vec(), clutter.shapes.len())
    }

    /// The scene with an index.
    ///
    /// # Errors
    /// When the image codec fails.
    pub fn scene(&self, index: u64) -> Result<SceneSample, SyntheticError> {
        let mut rng = stream(self.seed ^ 0x5ce7_e5ce, index);
        let [width, height] = self.config.image_px;
        let focal = rng.uniform(self.config.focal_px[0], self.config.focal_px[1]);
        let centre =
            |size: u32, rng: &mut _| (f64::from(size) - 1.0) / 2.0 + Draw::uniform(rng, -0.02, 0.02) * f64::from(size);
        let intrinsics = Intrinsics { fx: focal, fy: focal, cx: centre(width, &mut rng), cy: centre(height, &mut rng) };
        let (photos, look) = (PhotoBank::default(), LookConfig::default());
        let shapes = ShapeBank::new(self.seed, 0);
        let stock = Stock { objects: &self.objects, shapes: &shapes, photos: &photos, look: &look };
        let clutter = self.clutter.as_ref().map(|clutter| clutter.stock());
        let (scene, placed) = SyntheticScene::draw_set(&mut rng, &stock, clutter.as_ref(), &intrinsics, &self.config)?;
        let window = Window::whole(&intrinsics, self.config.image_px);
        let picture = scene.render(&window);
        // Sensors are drawn for images of 640 pixels.
        let sensor = Sensor::draw(&mut rng, &CameraConfig::default()).scaled((width as f32 / 640.0).min(1.0));
        let image = sensor.expose(&picture.light, mean_light(&picture.light), &mut rng);
        let (owner, depth_m) = owners(&picture, &window, placed.len());
        let instance = |p: &super::scene::Placed| SceneInstance {
            object_id: p.object_id,
            camera_from_object: p.camera_from_object,
        };
        Ok(SceneSample { image, intrinsics, instances: placed.iter().map(instance).collect(), owner, depth_m })
    }
}

/// Owner and depth of each image pixel, read at its first sample.
fn owners(picture: &Picture, window: &Window, objects: usize) -> (Vec<u8>, Vec<f32>) {
    let (n, width, height) = (SAMPLES as usize, window.width as usize, window.height as usize);
    let place = |i: usize| (i / width * n) * width * n + i % width * n;
    let known = |owner: u8| if usize::from(owner) <= objects { owner } else { 0 };
    let seen = &picture.visible;
    (0..width * height).map(place).map(|at| (known(seen.owner[at]), seen.depth_m(at))).unzip()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arm_hides_some_of_what_it_reaches_before_and_changes_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let objects = Arc::new(ObjectSet::load(&crate::write_sample_objects(folder.path()).unwrap()).unwrap());
        let scene = |reached_into, index| {
            let config = SceneConfig { reached_into, ..SceneConfig::for_images(96, 72) };
            SceneGenerator::new(Arc::clone(&objects), config, 5).unwrap().scene(index).unwrap()
        };
        let mut hidden = 0;
        for index in 0..12 {
            let (free, reached) = (scene(0.0, index), scene(1.0, index));
            assert_eq!(free.instances, reached.instances);
            let pixels = free.owner.iter().zip(&reached.owner);
            assert!(pixels.clone().all(|(free, reached)| free == reached || *reached == 0));
            hidden += usize::from(pixels.clone().filter(|(free, reached)| free != reached).count() > 20);
        }
        assert!(hidden >= 6, "an arm hides something in {hidden} of 12 scenes");
    }

    #[test]
    fn the_card_says_where_the_objects_come_from() {
        let folder = tempfile::tempdir().unwrap();
        let models = crate::write_sample_objects(folder.path()).unwrap();
        let objects = Arc::new(ObjectSet::load(&models).unwrap());
        let card = || SceneGenerator::new(Arc::clone(&objects), SceneConfig::for_images(96, 72), 1).map(|g| g.card());
        assert!(card().unwrap().to_json().contains("not stated"));
        let stated = |id| format!(r#""{id}": {{"source": "a shop", "licence": "CC0", "ship": true}}"#);
        let meta: Vec<String> = objects.ids().into_iter().map(stated).collect();
        std::fs::write(models.join("meta.json"), format!("{{{}}}", meta.join(","))).unwrap();
        let told = card().unwrap().to_json();
        assert!(told.contains("a shop") && told.contains(r#""may_ship": true"#), "{told}");
        std::fs::write(models.join("meta.json"), "{").unwrap();
        assert!(card().unwrap_err().to_string().contains("meta.json"));
    }
}
