//! Render and compare, before there is a pose: the object seen from all sides, held against the image in the feature space of
//! the flow network.
//!
//! The flow network's encoder was trained so that the features of a rendering and of a real crop agree where they show the
//! same surface. A view scores the mean cosine between its features and the crop's over the cells that show the object, at
//! the best of a few shifts and sizes.

mod cache;
mod config;
mod crops;
mod encoder;
mod library;
mod likeness;
mod turned_camera;
mod views;

pub use config::CompareConfig;
pub use turned_camera::Photograph;

use crate::InitializerError;
use crate::detect::Rectangle;
use crops::{Crops, Scored};
use encoder::Encoder;
use library::Library;
use nalgebra::{Translation3, UnitQuaternion, Vector2, Vector3};
use pseudoflow_geometry::Pose;
use pseudoflow_imaging::raster::{Rasteriser, SoftwareRasteriser};
use pseudoflow_imaging::{Object, ObjectSet};
use pseudoflow_inference::EngineConfig;
use turned_camera::TurnedCamera;
use views::{UNIT, centred, summit, views};

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
/// At least so many different views are turned to find better ones, and measured.
const POLISHED: usize = 5;
/// Views that are turned less from each other than this count as one, radians.
const APART_RAD: f64 = 0.45;

/// The feature encoder and the views of all objects.
pub struct Comparer {
    coarse: Encoder,
    fine: Encoder,
    rasteriser: SoftwareRasteriser,
    library: Library,
    config: CompareConfig,
}

/// An object that cannot be searched for yet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Preparing {
    /// The object.
    pub object_id: u32,
    /// Share of its views that are there, 0..1.
    pub share: f64,
}

/// How well a pose explains an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// The pose, metres.
    pub camera_from_object: Pose,
    /// Mean cosine of the features, -1 to 1.
    pub similarity: f64,
}

/// Which views resemble what is seen at a place, in a first pass over all of them.
#[derive(Debug, Clone)]
pub struct CoarseMatch {
    /// Width and height at unit distance.
    detected: Vector2<f64>,
    /// The best first, each turned from the others.
    views: Vec<Scored>,
}

impl CoarseMatch {
    /// That of the best view, less what another width or height than was detected costs.
    #[must_use]
    pub fn similarity(&self) -> f64 {
        self.views.first().map_or(0.0, |best| f64::from(best.similarity))
    }
}

impl Comparer {
    /// Renders all objects from all sides and encodes what is seen, as far as that is not kept on disk.
    ///
    /// # Errors
    /// When the weights are not those of a flow network, or the engine cannot be opened.
    pub fn open(config: &CompareConfig, objects: &ObjectSet, engine: &EngineConfig) -> Result<Self, InitializerError> {
        let mut comparer = Self::open_unprepared(config, objects, engine)?;
        while comparer.prepare_some(objects)? {}
        Ok(comparer)
    }

    /// With the views that are kept on disk; [`Self::prepare_some`] makes the others.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_unprepared(
        config: &CompareConfig,
        objects: &ObjectSet,
        engine: &EngineConfig,
    ) -> Result<Self, InitializerError> {
        let coarse = Encoder::open(&config.model, COARSE_PX, engine)?;
        let fine = Encoder::open(&config.model, FINE_PX, engine)?;
        let mut rasteriser = SoftwareRasteriser::new();
        for object in objects.iter() {
            rasteriser.add_object(object.id, &object.mesh).map_err(|e| InitializerError::Render(e.to_string()))?;
        }
        let library = Library::open(config, objects, &coarse)?;
        let (views, count) = library.counts();
        log::info!("{views} views of {count} objects were kept");
        Ok(Self { coarse, fine, rasteriser, library, config: config.clone() })
    }

    /// Makes some of the views that are missing; `false` when none are.
    ///
    /// # Errors
    /// What renderer and engine say.
    pub fn prepare_some(&mut self, objects: &ObjectSet) -> Result<bool, InitializerError> {
        self.library.prepare_some(objects, &self.rasteriser, &mut self.coarse)
    }

    /// The objects that cannot be searched for yet.
    #[must_use]
    pub fn preparing(&self) -> Vec<Preparing> {
        self.library.unprepared().collect()
    }

    /// A first look at a place where an object may be: which of its views resemble what is there. Cheap, beside
    /// [`Self::best`].
    ///
    /// # Errors
    /// What the engine says.
    pub fn coarse_match(
        &mut self,
        photograph: &Photograph<'_>,
        object: &Object,
        detected: &Rectangle,
    ) -> Result<CoarseMatch, InitializerError> {
        let (camera, detected) = TurnedCamera::at(photograph.camera, detected);
        let crops = Crops::look(&mut self.coarse, photograph, &camera, &SIZES)?;
        let promising = crops.promising(self.library.views(object.id), &detected);
        let views = apart(crops.score(promising, Some(&detected)), self.kept());
        Ok(CoarseMatch { detected, views })
    }

    /// The views of an object that explain best what is seen at a place, the best first; at most
    /// [`CompareConfig::hypotheses`], each turned from the others.
    ///
    /// # Errors
    /// What the engine says.
    pub fn best(
        &mut self,
        photograph: &Photograph<'_>,
        object: &Object,
        coarse_match: &CoarseMatch,
    ) -> Result<Vec<Match>, InitializerError> {
        let best = self.polished(photograph, object, coarse_match)?;
        let best = self.measured(photograph, object, best)?;
        let found = best.iter().filter_map(|scored| {
            let pose = placed(object, &scored.rotation, &scored.camera)?;
            Some(Match { camera_from_object: pose, similarity: f64::from(scored.similarity) })
        });
        Ok(found.collect())
    }

    /// Views that are carried along.
    fn kept(&self) -> usize {
        POLISHED.max(self.config.hypotheses as usize)
    }

    /// The views of a coarse match, turned to better ones between them.
    fn polished(
        &mut self,
        photograph: &Photograph<'_>,
        object: &Object,
        coarse_match: &CoarseMatch,
    ) -> Result<Vec<Scored>, InitializerError> {
        let (mut best, detected) = (coarse_match.views.clone(), Some(&coarse_match.detected));
        for step_deg in &self.config.steps_deg {
            let Some(first) = best.first() else { break };
            // Closer, where the best view has found the object.
            let crops = Crops::look(&mut self.coarse, photograph, &first.camera, &NEAR_SIZES)?;
            let around = best.iter().flat_map(|s| turned(&s.rotation, *step_deg));
            let around: Vec<UnitQuaternion<f64>> = best.iter().map(|s| s.rotation).chain(around).collect();
            let views = views(object, &around, Some(first.camera.side), &self.rasteriser, &mut self.coarse)?;
            best = apart(crops.score(&views, detected), self.kept());
        }
        Ok(best)
    }

    /// The views at twice the resolution, the best first: all are measured once, and the better half of them again.
    fn measured(
        &mut self,
        photograph: &Photograph<'_>,
        object: &Object,
        mut views: Vec<Scored>,
    ) -> Result<Vec<Scored>, InitializerError> {
        let mut count = views.len();
        for step_deg in self.config.fine_steps_deg.clone() {
            for view in &mut views[..count] {
                *view = self.measure(photograph, object, view, step_deg)?;
            }
            views.sort_by(better_first);
            count = count.div_ceil(2);
        }
        views.truncate(self.config.hypotheses as usize);
        Ok(views)
    }

    /// A view turned about each axis of the camera to where the similarity is highest between the steps.
    fn measure(
        &mut self,
        photograph: &Photograph<'_>,
        object: &Object,
        rough: &Scored,
        step_deg: f64,
    ) -> Result<Scored, InitializerError> {
        let crops = Crops::look(&mut self.fine, photograph, &rough.camera, &FINE_SIZES)?;
        let around: Vec<UnitQuaternion<f64>> =
            std::iter::once(rough.rotation).chain(turned(&rough.rotation, step_deg)).collect();
        let views = views(object, &around, Some(rough.camera.side), &self.rasteriser, &mut self.fine)?;
        let scores = crops.score(&views, None);
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

/// The pose at which an object, turned as in a view, has its projection where a turned camera looks, as large.
fn placed(object: &Object, view: &UnitQuaternion<f64>, camera: &TurnedCamera) -> Option<Pose> {
    let mut middle_m = Vector3::new(0.0, 0.0, object.diameter_m / camera.side);
    for _ in 0..6 {
        let seen = crate::detect::extent(object, &centred(object, view, middle_m), &UNIT)?;
        let larger = seen.side_px() / camera.side;
        let off = seen.middle_px.coords;
        if off.norm() < 1e-3 * camera.side && (larger - 1.0).abs() < 0.002 {
            break;
        }
        middle_m.z *= larger;
        middle_m -= Vector3::new(off.x, off.y, 0.0) * middle_m.z;
    }
    Some(Pose::from_parts(Translation3::identity(), camera.camera_from_turned) * centred(object, view, middle_m))
}
