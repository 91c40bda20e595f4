use crate::EvalError;
use pseudoflow_geometry::Pose;
use pseudoflow_imaging::{BopFrame, BopScene, Mesh, Object, ObjectSet, list_scenes};
use pseudoflow_metrics::{
    Estimate, KnownIds, MAX_SYM_DISC_STEP, ModelPoints, SceneTruth, Target, TruthInstance, VISIB_GT_MIN, read_targets,
};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// A split of a BOP dataset with its ground truth.
#[derive(Debug, Clone)]
pub struct EvalDataset {
    /// Name of the dataset's folder, e.g. `ycbv`.
    pub name: String,
    /// Split, e.g. `test`.
    pub split: String,
    /// The objects (of `models_eval` where that exists).
    pub objects: ObjectSet,
    /// Folder of the meshes to render: those with textures or colours, which `models_eval` has not always.
    pub render_dir: PathBuf,
    /// What the errors of each object are measured with.
    pub models: BTreeMap<u32, EvalModel>,
    /// The images that have something to look for, by scene and image.
    pub images: Vec<EvalImage>,
    /// Every object, scene and image of the split, for the check of result files.
    pub known: KnownIds,
    /// What a reader of the scores should know about the dataset.
    pub notes: Vec<String>,
}

/// An object as the metrics see it.
#[derive(Debug, Clone)]
pub struct EvalModel {
    /// Vertices.
    pub points: ModelPoints,
    /// The mesh without colours, for depth.
    pub depth_mesh: Mesh,
    /// All symmetry transforms, identity first, continuous ones in steps of 0.01 diameters.
    pub symmetries: Vec<Pose>,
    /// Diameter of `models_info.json`, metres.
    pub diameter_m: f64,
    /// Whether ADD(-S) means ADI.
    pub symmetric: bool,
}

/// An image with its ground truth.
#[derive(Debug, Clone)]
pub struct EvalImage {
    /// Scene.
    pub scene_id: u32,
    /// Files, camera and initial poses.
    pub frame: BopFrame,
    /// Width and height, pixels.
    pub size_px: (u32, u32),
    /// All true instances.
    pub truth: Vec<TruthInstance>,
    /// Which of them are to be found.
    pub valid: Vec<bool>,
    /// How many estimates of each object count (those of highest score).
    pub targets: BTreeMap<u32, u32>,
}

/// Loads `DIR/SPLIT` with its models and ground truth. `targets` is a list such as `test_targets_bop19.json`; then the
/// `inst_count` most visible instances of each target count (bop_toolkit with `visib_gt_min = -1`). Without it every
/// instance counts that is visible to 10 % or more, or whose visibility is not given.
///
/// # Errors
/// When files are missing or malformed, or there is nothing to look for.
pub fn load_dataset(dir: &Path, split: &str, targets: Option<&Path>) -> Result<EvalDataset, EvalError> {
    let first_of = |names: &[&str]| {
        let found = names.iter().map(|name| dir.join(name)).find(|path| path.is_dir());
        found.ok_or_else(|| EvalError::NoModels { dir: dir.to_owned() })
    };
    let models_dir = first_of(&["models_eval", "models", "models_cad"])?;
    // T-LESS has CAD models and reconstructed ones, the latter with colours.
    let render_dir = first_of(&["models", "models_reconst", "models_cad", "models_eval"])?;
    let info = models_dir.join("models_info.json");
    if !info.is_file() {
        return Err(EvalError::NoModelsInfo { path: info });
    }
    let objects = ObjectSet::load(&models_dir)?;
    let models =
        objects.iter().map(|o| Ok((o.id, EvalModel::new(o)?))).collect::<Result<BTreeMap<_, _>, EvalError>>()?;
    let split_dir = dir.join(split);
    let mut reader = Reader { dir: &split_dir, wanted: targets.map(wanted).transpose()?, ..Reader::new(&split_dir) };
    for scene_dir in list_scenes(&split_dir)? {
        reader.read_scene(&scene_dir)?;
    }
    reader.check()?;
    check_objects(&reader.images, &objects)?;
    let name =
        |path: &Path| path.file_name().map_or_else(|| "dataset".to_owned(), |n| n.to_string_lossy().into_owned());
    Ok(EvalDataset {
        name: dir.canonicalize().map_or_else(|_| name(dir), |d| name(&d)),
        split: split.to_owned(),
        notes: reader.notes(),
        known: KnownIds { objects: objects.ids().into_iter().collect(), images: reader.scenes_and_images },
        images: reader.images,
        objects,
        render_dir,
        models,
    })
}

impl EvalDataset {
    /// The initial poses of the scenes' `init_poses.json`, for the objects that are to be found.
    #[must_use]
    pub fn initial_estimates(&self) -> Vec<Estimate> {
        let of_image = |image: &EvalImage| {
            let wanted = image.frame.initial_poses.iter().filter(|p| image.targets.contains_key(&p.object_id));
            let estimate = |p: &pseudoflow_imaging::InitialPose| Estimate {
                scene_id: image.scene_id,
                image_id: image.frame.image_id,
                object_id: p.object_id,
                score: 1.0,
                camera_from_object: p.camera_from_object.into(),
                image_time_s: None,
            };
            wanted.map(estimate).collect::<Vec<_>>()
        };
        self.images.iter().flat_map(of_image).collect()
    }

    /// How many true instances are to be found.
    #[must_use]
    pub fn target_count(&self) -> usize {
        self.images.iter().map(|image| image.valid.iter().filter(|v| **v).count()).sum()
    }
}

impl EvalModel {
    /// The points and symmetries of an object.
    ///
    /// # Errors
    /// When its mesh cannot be measured with.
    pub fn new(object: &Object) -> Result<Self, EvalError> {
        let points = ModelPoints::new(&object.mesh.points());
        Ok(Self {
            points: points.map_err(|source| EvalError::Points { object_id: object.id, source })?,
            depth_mesh: Mesh { texture: None, texcoords: Vec::new(), colours: Vec::new(), ..Mesh::clone(&object.mesh) },
            symmetries: object.symmetries.transforms(MAX_SYM_DISC_STEP),
            diameter_m: object.diameter_m,
            symmetric: !object.symmetries.is_trivial(),
        })
    }
}

/// Instance counts by object, by scene and image.
type Wanted = BTreeMap<(u32, u32), BTreeMap<u32, u32>>;

fn wanted(path: &Path) -> Result<Wanted, EvalError> {
    let mut wanted = Wanted::new();
    for Target { scene_id, image_id, object_id, inst_count } in read_targets(path)? {
        wanted.entry((scene_id, image_id)).or_default().insert(object_id, inst_count);
    }
    Ok(wanted)
}

struct Reader<'a> {
    dir: &'a Path,
    wanted: Option<Wanted>,
    images: Vec<EvalImage>,
    scenes_and_images: BTreeSet<(u32, u32)>,
    without_truth: usize,
    unknown_visibility: usize,
    too_few: usize,
}

impl<'a> Reader<'a> {
    fn new(dir: &'a Path) -> Self {
        let images = Vec::new();
        let scenes_and_images = BTreeSet::new();
        Self { dir, wanted: None, images, scenes_and_images, without_truth: 0, unknown_visibility: 0, too_few: 0 }
    }

    fn read_scene(&mut self, scene_dir: &Path) -> Result<(), EvalError> {
        let scene_id = scene_dir.file_name().and_then(|n| n.to_str()).and_then(|n| n.parse().ok()).unwrap_or(0);
        let is_wanted = |id: u32| self.wanted.as_ref().is_none_or(|wanted| wanted.contains_key(&(scene_id, id)));
        let scene = BopScene::open_where(scene_dir, &is_wanted)?;
        let mut truth = SceneTruth::read(scene_dir)?;
        self.scenes_and_images.extend(truth.images.keys().map(|id| (scene.scene_id, *id)));
        for frame in scene.frames {
            self.scenes_and_images.insert((scene.scene_id, frame.image_id));
            match truth.images.remove(&frame.image_id) {
                Some(truth) => self.add_image(scene.scene_id, frame, truth)?,
                None => self.without_truth += 1,
            }
        }
        Ok(())
    }

    fn add_image(&mut self, scene_id: u32, frame: BopFrame, truth: Vec<TruthInstance>) -> Result<(), EvalError> {
        let wanted = self.wanted.as_ref().and_then(|wanted| wanted.get(&(scene_id, frame.image_id)));
        self.unknown_visibility += truth.iter().filter(|t| t.visible_fraction.is_none()).count();
        let valid = match wanted {
            Some(targets) => most_visible(&truth, targets),
            None => truth.iter().map(|t| t.visible_fraction.is_none_or(|v| v >= VISIB_GT_MIN)).collect(),
        };
        let found = counts(&truth, &valid);
        let targets = wanted.cloned().unwrap_or_else(|| found.clone());
        self.too_few += targets.iter().filter(|(id, n)| found.get(id).copied().unwrap_or(0) < **n).count();
        if valid.contains(&true) {
            let size_px = size_px(&frame)?;
            self.images.push(EvalImage { scene_id, frame, size_px, truth, valid, targets });
        }
        Ok(())
    }

    fn check(&self) -> Result<(), EvalError> {
        let mut targets = self.wanted.iter().flat_map(BTreeMap::keys);
        if let Some(&(scene_id, image_id)) = targets.find(|id| !self.scenes_and_images.contains(id)) {
            return Err(EvalError::UnknownTarget { dir: self.dir.to_owned(), scene_id, image_id });
        }
        if self.images.is_empty() {
            return Err(EvalError::NoTargets { dir: self.dir.to_owned() });
        }
        Ok(())
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.without_truth > 0 {
            notes.push(format!(
                "{} images of {} have no ground truth and do not count.",
                self.without_truth,
                self.dir.display()
            ));
        }
        if self.unknown_visibility > 0 {
            notes.push(format!(
                "{} true instances have no visibility in scene_gt_info.json: they count as visible.",
                self.unknown_visibility
            ));
        }
        if self.too_few > 0 {
            notes.push(format!("{} targets name more instances than the ground truth has.", self.too_few));
        }
        notes
    }
}

fn size_px(frame: &BopFrame) -> Result<(u32, u32), EvalError> {
    image::image_dimensions(&frame.image_path)
        .map_err(|source| EvalError::ImageSize { path: frame.image_path.clone(), source })
}

/// Marks the `inst_count` most visible instances of each target; unknown visibility counts as full.
fn most_visible(truth: &[TruthInstance], targets: &BTreeMap<u32, u32>) -> Vec<bool> {
    let mut order: Vec<usize> = (0..truth.len()).collect();
    let visible = |i: usize| truth[i].visible_fraction.unwrap_or(1.0);
    order.sort_by(|a, b| visible(*b).total_cmp(&visible(*a)));
    let (mut valid, mut left) = (vec![false; truth.len()], targets.clone());
    for i in order {
        if let Some(n) = left.get_mut(&truth[i].object_id).filter(|n| **n > 0) {
            *n -= 1;
            valid[i] = true;
        }
    }
    valid
}

fn counts(truth: &[TruthInstance], valid: &[bool]) -> BTreeMap<u32, u32> {
    let mut counts = BTreeMap::new();
    for (instance, _) in truth.iter().zip(valid).filter(|(_, valid)| **valid) {
        *counts.entry(instance.object_id).or_insert(0) += 1;
    }
    counts
}

fn check_objects(images: &[EvalImage], objects: &ObjectSet) -> Result<(), EvalError> {
    let known: BTreeSet<u32> = objects.ids().into_iter().collect();
    for image in images {
        if let Some(object_id) = image.targets.keys().find(|id| !known.contains(id)) {
            return Err(EvalError::UnknownObject {
                models: objects.folder().to_owned(),
                scene_id: image.scene_id,
                image_id: image.frame.image_id,
                object_id: *object_id,
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn instance(object_id: u32, visible_fraction: Option<f64>) -> TruthInstance {
        TruthInstance { object_id, camera_from_object: Pose::identity().into(), visible_fraction }
    }

    #[test]
    fn the_most_visible_instances_of_the_targets_count() {
        let truth = [instance(1, Some(0.3)), instance(1, Some(0.9)), instance(2, Some(1.0)), instance(1, Some(0.5))];
        assert_eq!(most_visible(&truth, &[(1, 2)].into()), [false, true, false, true]);
        assert_eq!(most_visible(&truth, &[(1, 9), (2, 0)].into()), [true, true, false, true]);
        let unknown = [instance(1, Some(0.9)), instance(1, None)];
        assert_eq!(most_visible(&unknown, &[(1, 1)].into()), [false, true]);
    }
}
