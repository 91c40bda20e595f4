//! Render and compare, before there is a pose: the object seen from all sides, held against the image in the feature space of
//! the flow network.
//!
//! The flow network's encoder was trained so that the features of a rendering and of a real crop agree where they show the
//! same surface. A view scores the mean cosine between its features and the crop's over the cells that show the object, at
//! the best of a few shifts and sizes.

mod views;

use crate::InitializerError;
use crate::detect::Rectangle;
use nalgebra::{Point2, Translation3, UnitQuaternion, Vector2, Vector3};
use pseudoflow_geometry::{Crop, Intrinsics, Pose};
use pseudoflow_imaging::raster::{Rasteriser, SoftwareRasteriser};
use pseudoflow_imaging::{Object, ObjectSet, RgbImage, resample};
use pseudoflow_inference::{Engine, EngineConfig, Input, Output, normalise, open};
use pseudoflow_network::{NetworkConfig, Weights, export_features};
use rayon::prelude::*;
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
        let (directions, turns, steps_deg) = (default_directions(), default_turns(), default_steps_deg());
        Self { model, directions, turns, steps_deg, hypotheses: default_hypotheses() }
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
            None if !self.steps_deg.iter().all(|v| *v > 0.0 && *v <= 90.0) => {
                let got = self.steps_deg.iter().copied().fold(0.0, f64::max);
                Err(InitializerError::Setting { field: "compare.steps_deg", got, wanted: "numbers over 0, at most 90" })
            }
            None if !self.model.is_file() => {
                Err(InitializerError::Model { path: self.model.clone(), cause: "no such file".into() })
            }
            None => Ok(()),
        }
    }
}

/// Width and height of the crops that are compared, pixels.
pub(crate) const SIZE_PX: u32 = 96;
/// Cells across a crop.
pub(crate) const CELLS: usize = SIZE_PX as usize / 8;
/// Side of a crop over the larger side of the object's projection.
pub(crate) const MARGIN: f64 = 1.25;
/// Sizes of the object that are tried, relative to the one that was detected: a network that has not seen very many images
/// takes large objects for smaller than they are.
const SIZES: [f64; 4] = [0.9, 1.07, 1.27, 1.51];
/// And around a view that was found.
const FINE_SIZES: [f64; 3] = [0.92, 1.0, 1.087];
/// Objects are larger than the network says, in the middle.
const LARGER: f64 = 1.08;
/// Weight of the squared logarithms of the ratios of width and height.
const UNLIKE: f64 = 0.5;
/// Their largest sum that counts.
const MOST_UNLIKE: f64 = 0.5;

/// The feature encoder and the views of all objects.
pub struct Comparer {
    encoder: Encoder,
    rasteriser: SoftwareRasteriser,
    views: BTreeMap<u32, Vec<View>>,
    steps_deg: Vec<f64>,
    hypotheses: usize,
}

/// How well a pose explains an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// The pose, metres.
    pub camera_from_object: Pose,
    /// Mean cosine of the features, -1 to 1.
    pub similarity: f64,
}

/// The encoder of a flow network.
pub(crate) struct Encoder {
    engine: Box<dyn Engine>,
    channels: usize,
    planes: Vec<f32>,
    features: Vec<f32>,
}

impl Encoder {
    /// Features of each cell of `n` crops (interleaved RGB), each of length one: n x CELLS^2 x channels.
    pub(crate) fn encode(&mut self, rgb: &[u8]) -> Result<Vec<f32>, InitializerError> {
        let (area, cells) = ((SIZE_PX * SIZE_PX) as usize, CELLS * CELLS);
        let n = rgb.len() / (3 * area);
        self.planes.resize(rgb.len(), 0.0);
        normalise(rgb, area, &mut self.planes);
        self.features.resize(n * self.channels * cells, 0.0);
        let shape = [n, 3, SIZE_PX as usize, SIZE_PX as usize];
        let image = Input { name: "image", shape: &shape, data: &self.planes };
        self.engine.run(&[image], &mut [Output { name: "features", data: &mut self.features }])?;
        let channels = self.channels;
        let mut by_cell = vec![0.0; self.features.len()];
        let planes = self.features.par_chunks_exact(channels * cells);
        by_cell.par_chunks_exact_mut(channels * cells).zip(planes).for_each(|(out, planes)| {
            for (cell, feature) in out.chunks_exact_mut(channels).enumerate() {
                (0..channels).for_each(|c| feature[c] = planes[c * cells + cell]);
                let norm = feature.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-6);
                feature.iter_mut().for_each(|v| *v /= norm);
            }
        });
        Ok(by_cell)
    }
}

impl Comparer {
    /// Renders all objects from all sides and encodes what is seen.
    ///
    /// # Errors
    /// When the weights are not those of a flow network, or the engine cannot be opened.
    pub fn open(config: &CompareConfig, objects: &ObjectSet, engine: &EngineConfig) -> Result<Self, InitializerError> {
        let failed = |cause: String| InitializerError::Model { path: config.model.clone(), cause };
        let network = NetworkConfig::nano();
        let weights = Weights::load(&config.model, &network).map_err(|e| failed(e.to_string()))?;
        let onnx = export_features(&weights, &network, SIZE_PX as usize).map_err(|e| failed(e.to_string()))?;
        let channels = network.feature_channels();
        let engine = open(&onnx, engine)?;
        let mut encoder = Encoder { engine, channels, planes: Vec::new(), features: Vec::new() };
        let mut rasteriser = SoftwareRasteriser::new();
        let start = std::time::Instant::now();
        let mut all = BTreeMap::new();
        for object in objects.iter() {
            rasteriser.add_object(object.id, &object.mesh).map_err(|e| InitializerError::Render(e.to_string()))?;
            all.insert(object.id, views(object, &rotations(object, config), &rasteriser, &mut encoder)?);
        }
        let count: usize = all.values().map(Vec::len).sum();
        log::info!("{count} views of {} objects in {:.1} s", all.len(), start.elapsed().as_secs_f64());
        Ok(Self {
            encoder,
            rasteriser,
            views: all,
            steps_deg: config.steps_deg.clone(),
            hypotheses: config.hypotheses as usize,
        })
    }

    /// Crops around a place (middle and larger side of a projection, pixels of the image), for objects of these sizes.
    fn look(
        &mut self,
        image: &RgbImage,
        (at, side_px): (Point2<f64>, f64),
        sizes: &[f64],
    ) -> Result<Crops, InitializerError> {
        let crop = |size: &f64| {
            let side = MARGIN * size * side_px;
            Crop { x0: at.x - side / 2.0, y0: at.y - side / 2.0, side, size_px: SIZE_PX }
        };
        let crops: Vec<Crop> = sizes.iter().map(crop).collect();
        let rgb: Vec<u8> = crops.iter().flat_map(|crop| resample(image, crop).into_raw()).collect();
        Ok(Crops { crops, features: self.encoder.encode(&rgb)? })
    }

    /// The views of an object that explain best what is seen where it was detected, the best first; at most
    /// [`CompareConfig::hypotheses`], each turned from the others.
    ///
    /// # Errors
    /// What the engine says.
    pub fn best(
        &mut self,
        image: &RgbImage,
        camera: &Intrinsics,
        object: &Object,
        detected: &Rectangle,
    ) -> Result<Vec<Match>, InitializerError> {
        let mut crops = self.look(image, (detected.middle_px, detected.side_px()), &SIZES)?;
        let known = self.views.get(&object.id).map_or(&[][..], Vec::as_slice);
        let count = self.hypotheses.max(POLISHED);
        let mut best = apart(crops.score(known, detected), count);
        for step_deg in self.steps_deg.clone() {
            let Some(first) = best.first() else { break };
            // Closer, where the best view has found the object.
            crops = self.look(image, crops.place(first), &FINE_SIZES)?;
            let around = best.iter().flat_map(|s| turned(&s.rotation, step_deg));
            let around: Vec<UnitQuaternion<f64>> = best.iter().map(|s| s.rotation).chain(around).collect();
            best = apart(crops.score(&views(object, &around, &self.rasteriser, &mut self.encoder)?, detected), count);
        }
        let found = best.iter().filter_map(|scored| {
            let pose = placed(object, &scored.rotation, camera, crops.place(scored))?;
            Some(Match { camera_from_object: pose, similarity: f64::from(scored.similarity) })
        });
        Ok(found.take(self.hypotheses).collect())
    }
}

/// So many different views are turned to find better ones.
const POLISHED: usize = 3;
/// Views that are turned less from each other than this count as one, radians.
const APART_RAD: f64 = 0.45;

/// The image around a detection at several sizes.
struct Crops {
    crops: Vec<Crop>,
    features: Vec<f32>,
}

/// A view and where in the crops it fits best.
#[derive(Debug, Clone, Copy)]
struct Scored {
    rotation: UnitQuaternion<f64>,
    similarity: f32,
    /// The crop, and how much larger the object is than it would be there.
    crop: usize,
    size: f64,
    shift: [f64; 2],
}

impl Scored {
    fn better_first(a: &Self, b: &Self) -> std::cmp::Ordering {
        b.similarity.total_cmp(&a.similarity)
    }
}

impl Crops {
    /// All views, the best first.
    fn score(&self, views: &[View], detected: &Rectangle) -> Vec<Scored> {
        let per_crop = self.features.len() / self.crops.len();
        let step = self.crops[2].side / self.crops[1].side;
        let score = |view: &View| {
            let of_crop = |(features, crop): (&[f32], &Crop)| {
                let (similarity, shift) = view.similarity(features);
                (similarity - unlike(view.shape * (crop.side / MARGIN), detected), shift)
            };
            let tries: Vec<(f32, [f64; 2])> =
                self.features.chunks_exact(per_crop).zip(&self.crops).map(of_crop).collect();
            let crop = (0..tries.len()).max_by(|a, b| tries[*a].0.total_cmp(&tries[*b].0)).unwrap_or(0);
            // Between the sizes, where it is not the least or the largest.
            let inside = (1..tries.len() - 1).contains(&crop);
            let away = if inside { summit([crop - 1, crop, crop + 1].map(|i| tries[i].0)) } else { 0.0 };
            Scored {
                rotation: view.rotation,
                similarity: tries[crop].0,
                crop,
                size: step.powf(away),
                shift: tries[crop].1,
            }
        };
        // In the order of the views where equal, whatever the threads.
        let mut scores: Vec<Scored> = views.par_iter().map(score).collect();
        scores.sort_by(Scored::better_first);
        scores
    }

    /// Middle and larger side of the object's projection, pixels of the image.
    fn place(&self, scored: &Scored) -> (Point2<f64>, f64) {
        let crop = &self.crops[scored.crop];
        let cell_px = crop.side / CELLS as f64;
        let along = |k: usize| [crop.x0, crop.y0][k] + crop.side / 2.0 + scored.shift[k] * cell_px;
        (Point2::new(along(0), along(1)), scored.size * crop.side / MARGIN)
    }
}

/// What a projection of another width or height than was detected costs, in units of the similarity. The features alone do
/// not tell the size of an object without texture: a smaller one fits anywhere inside.
fn unlike(size_px: Vector2<f64>, detected: &Rectangle) -> f32 {
    let off = size_px.component_div(&detected.size_px).map(|ratio| (ratio / LARGER).ln());
    (UNLIKE * off.norm_squared().min(MOST_UNLIKE)) as f32
}

/// The best views that are turned from each other.
fn apart(sorted: Vec<Scored>, count: usize) -> Vec<Scored> {
    let mut kept: Vec<Scored> = Vec::new();
    for scored in sorted {
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
