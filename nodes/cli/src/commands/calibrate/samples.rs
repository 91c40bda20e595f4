//! Refinements of synthetic images with what became of them.

use super::pipeline::{Frame, Pipeline};
use super::starts::draw_start;
use anyhow::{Context as _, Result};
use nalgebra::Vector6;
use pseudoflow_evaluator::EvalModel;
use pseudoflow_geometry::{Crop, Pose, quaternion_xyzw};
use pseudoflow_imaging::raster::{Rasteriser, SoftwareRasteriser, View};
use pseudoflow_imaging::{Object, ObjectSet, RgbImage};
use pseudoflow_metrics::{MatrixPose, add_m, adi_m, nearest_symmetric, pose_error};
use pseudoflow_msgs::{CameraFrameHeader, FRAME_ID_BYTES, ObjectPose, PoseSource, PoseStatus};
use pseudoflow_pnp::gate::{Feature, Features, Stage};
use pseudoflow_pnp::{Look, Refinement};
use pseudoflow_runtime::Context;
use pseudoflow_synthetic::{SceneConfig, SceneGenerator, SceneSample};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// One refinement, and how wrong the poses before and after it were.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Sample {
    /// What was solved from.
    #[serde(default)]
    pub(super) stage: Stage,
    /// Folder and number of the object.
    pub(super) object: String,
    /// Visible share of the object.
    pub(super) visible: f64,
    /// ADD(-S) of the initial pose, diameters.
    pub(super) before: f64,
    /// ADD(-S) of the refined pose, diameters.
    pub(super) after: f64,
    /// From the refined pose to the truth: translation (m), rotation (rad), camera axes.
    pub(super) error: [f64; 6],
    /// The solver's covariance, row-major 6 x 6.
    pub(super) covariance: Vec<f64>,
    /// What the refinement says about itself.
    pub(super) features: BTreeMap<Feature, f64>,
}

impl Sample {
    pub(super) fn is_better(&self) -> bool {
        self.after < self.before
    }

    pub(super) fn features(&self) -> Features {
        self.features.iter().fold(Features::default(), |all, (feature, value)| all.with(*feature, *value))
    }

    pub(super) fn error(&self) -> Vector6<f64> {
        self.error.into()
    }

    /// 36 numbers; zeros where the file has another count, which no covariance test passes.
    pub(super) fn covariance(&self) -> [f64; 36] {
        self.covariance.as_slice().try_into().unwrap_or([0.0; 36])
    }
}

/// Less visible objects are not looked for (as in the benchmark).
const MIN_VISIBLE: f64 = 0.1;
/// Side of the rendering that visible shares are measured with, pixels.
const SHARE_PX: u32 = 96;

/// Makes samples of an object set.
pub(super) struct Maker {
    folder: String,
    objects: Arc<ObjectSet>,
    models: BTreeMap<u32, EvalModel>,
    scenes: SceneGenerator,
    rasteriser: SoftwareRasteriser,
    context: Context,
    stage: Stage,
}

/// Crowded, often hidden, from small in the image to large: what is easy teaches the gate nothing.
fn scene_config() -> SceneConfig {
    SceneConfig {
        projected_px: [55.0, 260.0],
        most_objects: 7,
        most_others: 9,
        occluded: 0.5,
        ..SceneConfig::for_images(640, 480)
    }
}

impl Maker {
    pub(super) fn open(folder: &Path, seed: u64, stage: Stage) -> Result<Self> {
        let objects = Arc::new(ObjectSet::load(folder)?);
        let models = objects.iter().map(|o| Ok((o.id, EvalModel::new(o)?))).collect::<Result<_>>()?;
        let mut rasteriser = SoftwareRasteriser::new();
        for object in objects.iter() {
            rasteriser.add_object(object.id, &object.mesh)?;
        }
        let scenes = SceneGenerator::new(Arc::clone(&objects), scene_config(), seed)?;
        let out_dir = std::env::temp_dir();
        let context = Context { name: "calibrate".into(), seed, out_dir, restarts: 0, replay: true };
        Ok(Self { folder: folder.display().to_string(), objects, models, scenes, rasteriser, context, stage })
    }

    /// Makes a scene, refines a rough pose of everything in it that can be seen, and says what became of each.
    pub(super) fn scene(&self, index: u64, pipeline: &mut Pipeline) -> Result<Vec<Sample>> {
        let mut scene = self.scenes.scene(index)?;
        let mut rng = self.context.rng(index, "rough poses");
        fade(&mut scene.image, &mut rng);
        let mut rough = Vec::new();
        let mut truth = Vec::new();
        for (number, instance) in scene.instances.iter().enumerate() {
            let object = self.objects.get(instance.object_id)?;
            let visible = self.visible_share(&scene, number, object)?;
            if visible >= MIN_VISIBLE {
                let pose = draw_start(&instance.camera_from_object, object.diameter_m, &mut rng);
                rough.push(given(object.id, number as u32, &pose));
                truth.push((number as u32, instance.camera_from_object, visible));
            }
        }
        let looks = pipeline.refine(&frame(&scene, index), &rough)?;
        looks.iter().filter_map(|look| self.sample(look, &truth).transpose()).collect()
    }

    /// `None` where nothing was solved: there is nothing to decide.
    fn sample(&self, look: &Look, truth: &[(u32, Pose, f64)]) -> Result<Option<Sample>> {
        let Some(refinement) = &look.refinement else { return Ok(None) };
        let found = truth.iter().find(|(number, ..)| *number == look.pose.instance);
        let (_, truth, visible) = found.context("a pose came back that was not sent")?;
        let model = &self.models[&look.pose.object_id];
        let Refinement { before, after, .. } = refinement;
        let error =
            pose_error(&(*after).into(), &nearest_symmetric(&(*after).into(), &(*truth).into(), &model.symmetries));
        Ok(Some(Sample {
            stage: self.stage,
            object: format!("{}/{}", self.folder, look.pose.object_id),
            visible: *visible,
            before: add_s_of_diameter(model, before, truth),
            after: add_s_of_diameter(model, after, truth),
            error: error.into(),
            covariance: refinement.solver_covariance.to_vec(),
            features: refinement.features.known(),
        }))
    }

    /// The share of the object's projection that is seen in the image.
    fn visible_share(&self, scene: &SceneSample, number: usize, object: &Object) -> Result<f64> {
        let pose = scene.instances[number].camera_from_object;
        let Some(crop) = Crop::around(&object.hull_m, &pose, &scene.intrinsics, 1.05, SHARE_PX) else { return Ok(0.0) };
        let view = View {
            object_id: object.id,
            camera_from_object: pose,
            intrinsics: crop.intrinsics(&scene.intrinsics),
            width: SHARE_PX,
            height: SHARE_PX,
        };
        let rendered = self.rasteriser.render(&[view])?;
        let scale = crop.side / f64::from(SHARE_PX);
        let whole = rendered.iter().map(|r| r.foreground_px()).sum::<usize>() as f64 * scale * scale;
        let seen = scene.owner.iter().filter(|owner| usize::from(**owner) == number + 1).count() as f64;
        Ok((seen / whole.max(1.0)).min(1.0))
    }
}

fn add_s_of_diameter(model: &EvalModel, est: &Pose, gt: &Pose) -> f64 {
    let (est, gt): (MatrixPose, MatrixPose) = ((*est).into(), (*gt).into());
    let error_m = if model.symmetric { adi_m(&model.points, &est, &gt) } else { add_m(&model.points, &est, &gt) };
    error_m / model.diameter_m
}

/// A third of the images have other colours than the meshes would make: paler or stronger, darker or brighter, tinted.
fn fade(image: &mut RgbImage, rng: &mut ChaCha8Rng) {
    if rng.random::<f64>() > 0.35 {
        return;
    }
    let (saturation, gamma) = (rng.random_range(0.0..1.3_f32), rng.random_range(0.55..1.8_f32));
    let tint: [f32; 3] = std::array::from_fn(|_| rng.random_range(0.75..1.2_f32));
    for pixel in image.pixels_mut() {
        let value = pixel.0.map(|c| f32::from(c) / 255.0);
        let grey = 0.299 * value[0] + 0.587 * value[1] + 0.114 * value[2];
        for k in 0..3 {
            let pale = (grey + saturation * (value[k] - grey)).clamp(0.0, 1.0);
            pixel.0[k] = (255.0 * (tint[k] * pale.powf(gamma)).clamp(0.0, 1.0) + 0.5) as u8;
        }
    }
}

fn frame(scene: &SceneSample, index: u64) -> Frame<'_> {
    let k = &scene.intrinsics;
    let header = CameraFrameHeader {
        width: scene.image.width(),
        height: scene.image.height(),
        scene_id: 0,
        image_id: index as u32,
        intrinsics: [k.fx, k.fy, k.cx, k.cy],
        frame_id: [0; FRAME_ID_BYTES],
    };
    Frame { header, rgb: scene.image.as_raw(), index }
}

fn given(object_id: u32, instance: u32, pose: &Pose) -> ObjectPose {
    ObjectPose {
        object_id,
        instance,
        status: PoseStatus::Ok as u32,
        source: PoseSource::Given as u32,
        score: 1.0,
        rotation_xyzw: quaternion_xyzw(pose),
        translation_m: pose.translation.vector.into(),
        covariance: [0.0; 36],
    }
}

pub(super) fn write(path: &Path, samples: &[Sample]) -> Result<()> {
    let lines = samples.iter().map(|s| Ok(serde_json::to_string(s)? + "\n")).collect::<Result<String>>()?;
    std::fs::write(path, lines).with_context(|| format!("{}: cannot be written", path.display()))
}

pub(super) fn read(path: &Path) -> Result<Vec<Sample>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("`--samples {}`", path.display()))?;
    let line = |(i, line): (usize, &str)| {
        serde_json::from_str(line).with_context(|| format!("{}, line {}", path.display(), i + 1))
    };
    text.lines().enumerate().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn samples_survive_their_file() {
        let sample = Sample {
            stage: Stage::Joint,
            object: "pool/7".into(),
            visible: 0.7,
            before: 0.2,
            after: 0.05,
            error: [0.01, 0.0, -0.02, 0.1, 0.2, 0.3],
            covariance: (0..36).map(f64::from).collect(),
            features: [(Feature::InlierRatio, 0.8)].into(),
        };
        let file = tempfile::tempdir().unwrap().keep().join("a.samples.jsonl");
        write(&file, &[sample.clone(), sample.clone()]).unwrap();
        assert_eq!(read(&file).unwrap(), [sample.clone(), sample.clone()]);
        assert!(sample.is_better() && sample.covariance()[35] == 35.0);
        assert!(sample.features().get(Feature::InlierRms).is_nan());
        std::fs::write(&file, "{}").unwrap();
        assert!(format!("{:#}", read(&file).unwrap_err()).contains("line 1"));
    }

    #[test]
    fn a_third_of_the_images_are_faded() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut image = RgbImage::from_pixel(4, 4, image::Rgb([200, 100, 50]));
        let changed = (0..100).filter(|_| {
            image = RgbImage::from_pixel(4, 4, image::Rgb([200, 100, 50]));
            fade(&mut image, &mut rng);
            image.get_pixel(0, 0).0 != [200, 100, 50]
        });
        assert!((20..50).contains(&changed.count()));
    }
}
