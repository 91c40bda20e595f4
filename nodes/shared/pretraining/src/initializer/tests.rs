use super::augment::example;
use super::*;
use crate::offline::Silent;
use pseudoflow_synthetic::write_sample_objects;
use pseudoflow_synthetic::{SceneConfig, SceneGenerator};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

const NETWORK: &str = "name: tiny\ninput_px: [96, 64]\nwidths: [16, 24]\npyramid: 16\n";

fn tiny(folder: &Path) -> InitializerTraining {
    let network = folder.join("tiny.yaml");
    std::fs::write(&network, NETWORK).unwrap();
    let scenes = SceneConfig { most_objects: 3, projected_px: [20.0, 40.0], ..SceneConfig::for_images(96, 64) };
    InitializerTraining {
        steps: 6,
        batch: 2,
        block: 4,
        uses: 2,
        warm_start: WarmStart::Random,
        device: ComputeDevice::Cpu,
        scenes: Some(scenes),
        ..InitializerTraining::new(
            write_sample_objects(folder).unwrap(),
            &network.to_string_lossy(),
            folder.join("w.safetensors"),
        )
    }
}

/// Stops after some steps.
struct StopAt(u64, u64);

impl Progress for StopAt {
    fn start(&mut self, _: u64, _: u64) {}
    fn step(&mut self, step: u64, _: &str) {
        self.1 = step;
    }
    fn should_stop(&self) -> bool {
        self.1 >= self.0
    }
}

#[test]
fn a_training_that_knows_its_objects_freezes_nothing_and_resumes_without_its_start() {
    let (one, two) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let start = train_initializer(&tiny(one.path()), &mut Silent).unwrap().written;
    let mut config = InitializerTraining { warm_start: WarmStart::File(start.clone()), ..tiny(two.path()) };
    assert!(config.frozen_trunk > 0.0);
    assert!(!train_initializer(&config, &mut StopAt(2, 0)).unwrap().finished);
    assert_eq!(config.begun().unwrap().frozen_trunk, 0.0);
    std::fs::remove_file(start).unwrap();
    config.resume = true;
    assert!(train_initializer(&config, &mut Silent).unwrap().finished);
}

#[test]
fn an_interrupted_run_ends_with_the_bytes_of_an_unbroken_one() {
    let (one, two) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let whole = train_initializer(&tiny(one.path()), &mut Silent).unwrap();
    assert!(whole.finished && whole.step == 6 && whole.loss.is_finite());
    let mut config = InitializerTraining { objects: one.path().to_owned(), ..tiny(two.path()) };
    config.network = one.path().join("tiny.yaml").to_string_lossy().into();
    // Interrupted in the middle of a block; the threads do not matter.
    let part = train_initializer(&config, &mut StopAt(3, 0)).unwrap();
    assert!(!part.finished && !config.out.exists());
    (config.resume, config.data_threads) = (true, 3);
    let rest = train_initializer(&config, &mut Silent).unwrap();
    assert!(rest.finished);
    let bytes = |path: &Path| std::fs::read(path).unwrap();
    assert!(bytes(&whole.written) == bytes(&rest.written), "the weights differ");
    assert_eq!(Weights::read_info(&rest.written).unwrap().object_ids, [1, 4]);
    config.seed = 9;
    assert!(train_initializer(&config, &mut Silent).unwrap_err().to_string().contains("seed"));
}

/// The label of a cell and the colour of the pixel below it come from the same place: where the owner is nobody's the
/// boxes end, and a box's corners project around its cells.
#[test]
fn labels_lie_where_the_objects_are() {
    let folder = tempfile::tempdir().unwrap();
    let config = tiny(folder.path());
    let objects = Arc::new(ObjectSet::load(&config.objects).unwrap());
    let generator = SceneGenerator::new(Arc::clone(&objects), config.scenes.clone().unwrap(), 3).unwrap();
    let grid = Grid::new(96, 64);
    let mut owned = 0;
    for index in 0..30 {
        let scene = generator.scene(index).unwrap();
        assert_eq!(scene, generator.scene(index).unwrap());
        let truth = example(&scene, &objects, &grid, &mut ChaCha8Rng::seed_from_u64(index)).truth;
        let [fx, fy, cx, cy] = truth.intrinsics;
        let cells = grid.cells.iter().zip(&truth.owner).zip(&truth.surface);
        for ((cell, owner), surface) in cells.filter(|((_, owner), _)| **owner > 0) {
            let instance = &truth.instances[usize::from(*owner) - 1];
            let corners = instance.corners_m;
            let [x, y, z] = on_box(&corners, surface.map(|v| v * instance.diameter_m));
            let seen = [fx * x / z + cx, fy * y / z + cy];
            let off = (seen[0] - cell.centre_px[0]).hypot(seen[1] - cell.centre_px[1]);
            // Read at the nearest pixel of the scene, zoomed by up to 1.3.
            assert!(off < 1.3, "scene {index}: {cell:?} shows {seen:?}");
            let at = corners.map(|[x, y, z]| [fx * x / z + cx, fy * y / z + cy]);
            for k in 0..2 {
                let (low, high) = (0..8).fold((f32::MAX, f32::MIN), |(l, h), i| (l.min(at[i][k]), h.max(at[i][k])));
                // Owners are read at the nearest pixel.
                assert!((low - 1.0..=high + 1.0).contains(&cell.centre_px[k]), "scene {index}: {cell:?} {at:?}");
            }
            owned += 1;
        }
    }
    assert!(owned > 100, "{owned}");
}

/// The point at an offset (metres) from the middle of a box, along its own axes.
fn on_box(corners: &[[f32; 3]; 8], offset: [f32; 3]) -> [f32; 3] {
    let middle = |k: usize| corners.iter().map(|c| c[k]).sum::<f32>() / 8.0;
    let mut point = [middle(0), middle(1), middle(2)];
    for (axis, along) in offset.into_iter().enumerate() {
        let edge: [f32; 3] = std::array::from_fn(|k| corners[1 << axis][k] - corners[0][k]);
        let length = edge.iter().map(|e| e * e).sum::<f32>().sqrt();
        (0..3).for_each(|k| point[k] += along * edge[k] / length);
    }
    point
}

#[test]
fn bad_settings_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let good = tiny(folder.path());
    for (bad, field) in [
        (InitializerTraining { steps: 0, ..good.clone() }, "steps"),
        (InitializerTraining { block: 5, ..good.clone() }, "block"),
        (InitializerTraining { uses: 0, ..good.clone() }, "uses"),
    ] {
        assert!(bad.check().unwrap_err().to_string().contains(field));
    }
    let sheet = scene_sheet(&good, 3).unwrap();
    assert_eq!(sheet.dimensions(), (4 * 96, 64));
}
