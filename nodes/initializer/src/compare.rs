//! Render and compare, before there is a pose: the object seen from all sides, held against the image in the feature space of
//! the flow network.
//!
//! The flow network's encoder was trained so that the features of a rendering and of a real crop agree where they show the
//! same surface. A view scores the mean cosine between its features and the crop's over the cells that show the object, at
//! the best of a few shifts and sizes.

mod crops;
mod encoder;
mod views;

use crate::InitializerError;
use crate::detect::Rectangle;
use crops::{Crops, Scored};
use encoder::Encoder;
use nalgebra::{Point2, Translation3, UnitQuaternion, Vector3};
use pseudoflow_geometry::{Intrinsics, Pose};
use pseudoflow_imaging::raster::{Rasteriser, SoftwareRasteriser};
use pseudoflow_imaging::{Object, ObjectSet, RgbImage};
use pseudoflow_inference::EngineConfig;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;
use views::{View, rotations, summit, views};

/// How the views of an object are compared with an image.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CompareConfig {
    /// Weights of the flow network for the same objects (RAFT-small, `.safetensors`).
    pub model: PathBuf,
    /// Directions from which each object is rendered.
    #[serde(default = "default_directions")]
    pub directions: u32,
    /// Turns about the line of sight for each direction.
    #[serde(default = "default_turns")]
    pub turns: u32,
    /// Steps, in degrees, by which the best views are turned about each axis to find better ones between them.
    #[serde(default = "default_steps_deg")]
    pub steps_deg: Vec<f64>,
    /// And to measure them at twice the resolution.
    #[serde(default = "default_fine_steps_deg")]
    pub fine_steps_deg: Vec<f64>,
    /// Poses of an instance that are sent, the most similar first: the refiner tries them all, and pnp keeps the one that flow
    /// and picture agree with best.
    #[serde(default = "default_hypotheses")]
    pub hypotheses: u32,
}

fn default_hypotheses() -> u32 {
    4
}

fn default_steps_deg() -> Vec<f64> {
    vec![14.0, 7.0]
}

fn default_fine_steps_deg() -> Vec<f64> {
    vec![10.0, 5.0, 2.5]
}

fn default_directions() -> u32 {
    64
}

fn default_turns() -> u32 {
    12
}

impl CompareConfig {
    /// The defaults for a flow network.
    #[must_use]
    pub fn new(model: PathBuf) -> Self {
        Self {
            model,
            directions: default_directions(),
            turns: default_turns(),
            steps_deg: default_steps_deg(),
            fine_steps_deg: default_fine_steps_deg(),
            hypotheses: default_hypotheses(),
        }
    }

    /// Checks the ranges.
    ///
    /// # Errors
    /// Names the first setting out of range.
    pub fn check(&self) -> Result<(), InitializerError> {
        let count = |v: u32| (4..=1000).contains(&v);
        let rules = [("compare.directions", self.directions), ("compare.turns", self.turns)];
        match rules.into_iter().find(|(_, v)| !count(*v)) {
            Some((field, v)) => Err(InitializerError::Setting { field, got: f64::from(v), wanted: "4 to 1000" }),
            None if !(1..=20).contains(&self.hypotheses) => {
                let got = f64::from(self.hypotheses);
                Err(InitializerError::Setting { field: "compare.hypotheses", got, wanted: "1 to 20" })
            }
            None if !self.steps().all(|v| *v > 0.0 && *v <= 90.0) => {
                let got = self.steps().copied().fold(0.0, f64::max);
                Err(InitializerError::Setting { field: "compare.steps_deg", got, wanted: "numbers over 0, at most 90" })
            }
            None if !self.model.is_file() => {
                Err(InitializerError::Model { path: self.model.clone(), cause: "no such file".into() })
            }
            None => Ok(()),
        }
    }

    fn steps(&self) -> impl Iterator<Item = &f64> {
        self.steps_deg.iter().chain(&self.fine_steps_deg)
    }
}

/// Width and height of the crops in which an object is looked for from all sides, pixels.
const COARSE_PX: u32 = 96;
/// And of those in which what was found is measured.
const FINE_PX: u32 = 192;
/// Sizes of the object that are tried, relative to the one that was detected: a network that has not seen very many images
/// takes large objects for smaller than they are.
const SIZES: [f64; 4] = [0.9, 1.07, 1.27, 1.51];
/// Around a view that was found.
const NEAR_SIZES: [f64; 3] = [0.92, 1.0, 1.087];
/// And at the end.
const FINE_SIZES: [f64; 3] = [0.96, 1.0, 1.042];
/// So many different views are turned to find better ones.
const POLISHED: usize = 3;
/// Views that are turned less from each other than this count as one, radians.
const APART_RAD: f64 = 0.45;

/// The feature encoder and the views of all objects.
pub struct Comparer {
    coarse: Encoder,
    fine: Encoder,
    rasteriser: SoftwareRasteriser,
    views: BTreeMap<u32, Vec<View>>,
    config: CompareConfig,
}

/// How well a pose explains an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// The pose, metres.
    pub camera_from_object: Pose,
    /// Mean cosine of the features, -1 to 1.
    pub similarity: f64,
}

/// What a first look at a place says.
#[derive(Debug, Clone)]
pub struct Glance {
    detected: Rectangle,
    /// The best first, each turned from the others.
    views: Vec<Scored>,
}

impl Glance {
    /// That of the best view, less what another width or height than was detected costs.
    #[must_use]
    pub fn similarity(&self) -> f64 {
        self.views.first().map_or(0.0, |best| f64::from(best.similarity))
    }
}

impl Comparer {
    /// Renders all objects from all sides and encodes what is seen.
    ///
    /// # Errors
    /// When the weights are not those of a flow network, or the engine cannot be opened.
    pub fn open(config: &CompareConfig, objects: &ObjectSet, engine: &EngineConfig) -> Result<Self, InitializerError> {
        let mut coarse = Encoder::open(&config.model, COARSE_PX, engine)?;
        let fine = Encoder::open(&config.model, FINE_PX, engine)?;
        let mut rasteriser = SoftwareRasteriser::new();
        let start = std::time::Instant::now();
        let mut all = BTreeMap::new();
        for object in objects.iter() {
            rasteriser.add_object(object.id, &object.mesh).map_err(|e| InitializerError::Render(e.to_string()))?;
            all.insert(object.id, views(object, &rotations(object, config), &rasteriser, &mut coarse)?);
        }
        let count: usize = all.values().map(Vec::len).sum();
        log::info!("{count} views of {} objects in {:.1} s", all.len(), start.elapsed().as_secs_f64());
        Ok(Self { coarse, fine, rasteriser, views: all, config: config.clone() })
    }

    /// A first look at a place where an object may be: which of its views resemble what is there. Cheap, beside
    /// [`Self::best`].
    ///
    /// # Errors
    /// What the engine says.
    pub fn glance(
        &mut self,
        image: &RgbImage,
        object: &Object,
        detected: &Rectangle,
    ) -> Result<Glance, InitializerError> {
        let crops = Crops::look(&mut self.coarse, image, (detected.middle_px, detected.side_px()), &SIZES)?;
        let known = self.views.get(&object.id).map_or(&[][..], Vec::as_slice);
        let views = apart(crops.score(known, Some(detected)), self.kept());
        Ok(Glance { detected: *detected, views })
    }

    /// The views of an object that explain best what is seen at a place, the best first; at most
    /// [`CompareConfig::hypotheses`], each turned from the others.
    ///
    /// # Errors
    /// What the engine says.
    pub fn best(
        &mut self,
        image: &RgbImage,
        camera: &Intrinsics,
        object: &Object,
        glance: &Glance,
    ) -> Result<Vec<Match>, InitializerError> {
        let best = self.polished(image, object, glance)?;
        let best = self.measured(image, object, best)?;
        let found = best.iter().filter_map(|scored| {
            let pose = placed(object, &scored.rotation, camera, scored.place)?;
            Some(Match { camera_from_object: pose, similarity: f64::from(scored.similarity) })
        });
        Ok(found.collect())
    }

    /// Views that are carried along.
    fn kept(&self) -> usize {
        POLISHED.max(self.config.hypotheses as usize)
    }

    /// The views of a glance, turned to better ones between them.
    fn polished(
        &mut self,
        image: &RgbImage,
        object: &Object,
        glance: &Glance,
    ) -> Result<Vec<Scored>, InitializerError> {
        let (mut best, detected) = (glance.views.clone(), Some(&glance.detected));
        for step_deg in &self.config.steps_deg {
            let Some(first) = best.first() else { break };
            // Closer, where the best view has found the object.
            let crops = Crops::look(&mut self.coarse, image, first.place, &NEAR_SIZES)?;
            let around = best.iter().flat_map(|s| turned(&s.rotation, *step_deg));
            let around: Vec<UnitQuaternion<f64>> = best.iter().map(|s| s.rotation).chain(around).collect();
            let views = views(object, &around, &self.rasteriser, &mut self.coarse)?;
            best = apart(crops.score(&views, detected), self.kept());
        }
        best.truncate(self.config.hypotheses as usize);
        Ok(best)
    }

    /// The views at twice the resolution, the best first: all are measured once, and the better half of them again.
    fn measured(
        &mut self,
        image: &RgbImage,
        object: &Object,
        mut views: Vec<Scored>,
    ) -> Result<Vec<Scored>, InitializerError> {
        let mut count = views.len();
        for step_deg in self.config.fine_steps_deg.clone() {
            for view in &mut views[..count] {
                *view = self.measure(image, object, view, step_deg)?;
            }
            views.sort_by(better_first);
            count = count.div_ceil(2);
        }
        Ok(views)
    }

    /// A view turned about each axis of the camera to where the similarity is highest between the steps.
    fn measure(
        &mut self,
        image: &RgbImage,
        object: &Object,
        rough: &Scored,
        step_deg: f64,
    ) -> Result<Scored, InitializerError> {
        let crops = Crops::look(&mut self.fine, image, rough.place, &FINE_SIZES)?;
        let around: Vec<UnitQuaternion<f64>> =
            std::iter::once(rough.rotation).chain(turned(&rough.rotation, step_deg)).collect();
        let scores = crops.score(&views(object, &around, &self.rasteriser, &mut self.fine)?, None);
        let similarity = |i: usize| scores[i].similarity;
        let along = |k: usize| match [similarity(2 * k + 2), similarity(0), similarity(2 * k + 1)] {
            [less, here, more] if here >= less && here >= more => summit([less, here, more]),
            [less, _, more] if more > less => 1.0,
            _ => -1.0,
        };
        let turn = Vector3::new(along(0), along(1), along(2)) * step_deg.to_radians();
        let best = scores.iter().min_by(|a, b| better_first(a, b)).unwrap_or(rough);
        Ok(Scored { rotation: UnitQuaternion::from_scaled_axis(turn) * rough.rotation, ..*best })
    }
}

fn better_first(a: &Scored, b: &Scored) -> std::cmp::Ordering {
    b.similarity.total_cmp(&a.similarity)
}

/// The best views that are turned from each other; in the order of the views where they are equal.
fn apart(mut scores: Vec<Scored>, count: usize) -> Vec<Scored> {
    scores.sort_by(better_first);
    let mut kept: Vec<Scored> = Vec::new();
    for scored in scores {
        if kept.len() < count && kept.iter().all(|k| k.rotation.angle_to(&scored.rotation) > APART_RAD) {
            kept.push(scored);
        }
    }
    kept
}

/// A rotation turned by an angle about each axis of the camera, both ways.
fn turned(rotation: &UnitQuaternion<f64>, step_deg: f64) -> Vec<UnitQuaternion<f64>> {
    let axes = [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()];
    let both = |axis: nalgebra::Unit<Vector3<f64>>| {
        [step_deg, -step_deg].map(|deg| UnitQuaternion::from_axis_angle(&axis, deg.to_radians()) * rotation)
    };
    axes.into_iter().flat_map(both).collect()
}

/// The pose at which an object, turned as in a view, fills a place of the image: middle and larger side of its projection.
fn placed(
    object: &Object,
    view: &UnitQuaternion<f64>,
    camera: &Intrinsics,
    (at, side_px): (Point2<f64>, f64),
) -> Option<Pose> {
    let ray = camera.unproject(&at, 1.0).coords;
    let to_ray = UnitQuaternion::rotation_between(&Vector3::z(), &ray)?;
    let rotation = to_ray * view;
    let mut z_m = camera.fx * object.diameter_m / side_px.max(1.0);
    let mut at_px = at;
    for _ in 0..6 {
        let centre = rotation * object.box_centre_m();
        let middle = camera.unproject(&at_px, z_m);
        let pose = Pose::from_parts(Translation3::from(middle.coords - centre.coords), rotation);
        let seen = crate::detect::extent(object, &pose, camera)?;
        let larger = seen.side_px() / side_px;
        if (seen.middle_px - at).norm() < 0.1 && (larger - 1.0).abs() < 0.002 {
            return Some(pose);
        }
        at_px += at - seen.middle_px;
        z_m *= larger;
    }
    let centre = rotation * object.box_centre_m();
    Some(Pose::from_parts(Translation3::from(camera.unproject(&at_px, z_m).coords - centre.coords), rotation))
}
