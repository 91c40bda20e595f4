use super::*;
use crate::TrainConfig;
use pseudoflow_network::{CORNERS, Cell, NetworkConfig, SURFACE_UNIT};

pub(crate) fn tiny() -> DetectorConfig {
    DetectorConfig { name: "tiny".into(), input_px: [96, 64], widths: [16, 24], pyramid: 16, objects: 2 }
}

pub(crate) fn noise(len: usize, seed: u64) -> Vec<f32> {
    use rand::{Rng, SeedableRng};
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    (0..len).map(|_| rng.random_range(-1.0..1.0)).collect()
}

/// A box of class 1 before the camera that fills the cells from (32, 16) to (64, 48).
pub(crate) fn scene(grid: &Grid) -> SceneTruth {
    let corner = |i: usize| [0, 1, 2].map(|k| if i >> k & 1 == 0 { -0.1_f32 } else { 0.1 });
    let corners_m = std::array::from_fn(|i| {
        let [x, y, z] = corner(i);
        [x, y, z + 0.7]
    });
    let inside = |c: &Cell| (32.0..64.0).contains(&c.centre_px[0]) && (16.0..48.0).contains(&c.centre_px[1]);
    SceneTruth {
        intrinsics: [110.0, 112.0, 47.5, 31.5],
        owner: grid.cells.iter().map(|c| u8::from(inside(c))).collect(),
        surface: grid.cells.iter().map(|c| [0.004 * c.centre_px[0], -0.1, 0.2]).collect(),
        instances: vec![InstanceTruth {
            class: 1,
            corners_m,
            diameter_m: 0.35,
            side_px: 36.0,
            rectangle_px: [31.0, 15.0, 65.0, 50.0],
        }],
    }
}

#[test]
fn cells_cover_the_input_and_levels_share_sizes() {
    let grid = Grid::new(96, 64);
    assert_eq!(grid.cells.len(), 12 * 8 + 6 * 4 + 3 * 2);
    assert_eq!(grid.cells[0].centre_px, [3.5, 3.5]);
    assert_eq!(grid.cells.last().unwrap().centre_px, [79.5, 47.5]);
    for side in [3.0, 20.0, 40.0, 60.0, 100.0, 200.0, 900.0] {
        assert!((0..3).any(|level| Grid::takes(level, side)), "{side}");
    }
    assert!(Grid::takes(0, 40.0) && Grid::takes(1, 40.0) && !Grid::takes(2, 40.0));
}

#[test]
fn gradients_are_those_of_finite_differences() {
    let grid = Grid::new(96, 64);
    let (cells, objects) = (grid.cells.len(), 2);
    let truth = [scene(&grid), SceneTruth { owner: vec![0; cells], ..scene(&grid) }];
    let logits: Vec<f32> = noise(2 * objects * cells, 1).iter().map(|v| 2.0 * v).collect();
    let offsets = noise(2 * objects * 2 * CORNERS * cells, 2);
    let surface = noise(2 * objects * 3 * cells, 3);
    let rectangles = noise(2 * 4 * cells, 4);
    let weights = LossWeights { class: 1.5, space: 3.0, image: 2.0, surface: 1.5, rectangle: 2.5 };
    let loss = |logits: &[f32], offsets: &[f32], surface: &[f32], rectangles: &[f32]| {
        detection_loss(&DetectorOutput { logits, offsets, surface, rectangles, objects }, &truth, &grid, &weights)
    };
    let at = loss(&logits, &offsets, &surface, &rectangles);
    assert!(
        at.positives > 16
            && at.class > 0.0
            && at.space_diameters > 0.0
            && at.image_sides > 0.0
            && at.surface_diameters > 0.0
    );
    let step = 1e-2_f32;
    let mut checked = 0;
    let mut check = |gradient: &[f32], change: &dyn Fn(usize, f32) -> f32| {
        let touched: Vec<usize> = (0..gradient.len()).filter(|i| gradient[*i].abs() > 1e-4).collect();
        for &i in touched.iter().step_by((touched.len() / 40).max(1)) {
            let slope = (change(i, step) - change(i, -step)) / (2.0 * step);
            assert!((slope - gradient[i]).abs() < 2e-4 + 0.03 * gradient[i].abs(), "{i}: {slope} {}", gradient[i]);
            checked += 1;
        }
    };
    let moved = |values: &[f32], i: usize, by: f32| {
        let mut values = values.to_vec();
        values[i] += by;
        values
    };
    check(&at.logit_gradient, &|i, by| loss(&moved(&logits, i, by), &offsets, &surface, &rectangles).total);
    check(&at.offset_gradient, &|i, by| loss(&logits, &moved(&offsets, i, by), &surface, &rectangles).total);
    check(&at.surface_gradient, &|i, by| loss(&logits, &offsets, &moved(&surface, i, by), &rectangles).total);
    check(&at.rectangle_gradient, &|i, by| loss(&logits, &offsets, &surface, &moved(&rectangles, i, by)).total);
    assert!(checked > 60, "{checked}");
}

#[test]
fn a_perfect_answer_costs_nothing_and_a_wrong_class_does() {
    let grid = Grid::new(96, 64);
    let (cells, objects) = (grid.cells.len(), 2);
    let truth = [scene(&grid)];
    let mut logits = vec![-20.0; objects * cells];
    let mut offsets = vec![0.0; objects * 2 * CORNERS * cells];
    let mut surface = vec![0.0; objects * 3 * cells];
    let mut rectangles = vec![0.0; 4 * cells];
    let instance = &truth[0].instances[0];
    let [fx, fy, cx, cy] = truth[0].intrinsics;
    for (i, cell) in grid.cells.iter().enumerate().filter(|(i, _)| truth[0].owner[*i] == 1) {
        if Grid::takes(cell.level, instance.side_px) {
            logits[cells + i] = 20.0;
        }
        (0..3).for_each(|k| surface[(3 + k) * cells + i] = truth[0].surface[i][k] / SURFACE_UNIT);
        for (edge, px) in instance.rectangle_px.iter().enumerate() {
            rectangles[edge * cells + i] = (px - cell.centre_px[edge % 2]) / cell.unit_px;
        }
        for (corner, p) in instance.corners_m.iter().enumerate() {
            let pixel = [fx * p[0] / p[2] + cx, fy * p[1] / p[2] + cy];
            for k in 0..2 {
                offsets[(2 * CORNERS + 2 * corner + k) * cells + i] = (pixel[k] - cell.centre_px[k]) / cell.unit_px;
            }
        }
    }
    let weights = LossWeights::default();
    let output =
        DetectorOutput { logits: &logits, offsets: &offsets, surface: &surface, rectangles: &rectangles, objects };
    let good = detection_loss(&output, &truth, &grid, &weights);
    assert!(good.total < 1e-4, "{good:?}");
    let (background, object) = logits.split_at(cells);
    let swapped = [object, background].concat();
    let bad = detection_loss(&DetectorOutput { logits: &swapped, ..output }, &truth, &grid, &weights);
    assert!(bad.class > 1.0, "{}", bad.class);
}

#[test]
fn training_learns_a_scene_and_resumes_with_the_same_bits() {
    let config = tiny();
    let grid = Grid::new(96, 64);
    let truth = [scene(&grid)];
    let images = noise(3 * 96 * 64, 3);
    let device = Device::flex();
    let steps = 40;
    let training = TrainConfig::new(3e-3, steps);
    let mut state = TrainState::new(config.clone(), training, Weights::random(&config, 1), &device).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.checkpoint");
    let step = |state: &mut TrainState<DetectorConfig>| {
        state.detection_step(&images, &truth, &LossWeights::default(), Trunk::Trained).unwrap().1.total
    };
    let first = step(&mut state);
    state.save(&path).unwrap();
    let mut last = 0.0;
    (1..steps).for_each(|_| last = step(&mut state));
    assert!(last < 0.3 * first, "{first} {last}");
    let mut again = TrainState::load(&path, config, &device).unwrap();
    assert!((1..steps).map(|_| step(&mut again)).all(f32::is_finite));
    assert_eq!(again.weights, state.weights);
    let text =
        state.detection_step(&images[1..], &truth, &LossWeights::default(), Trunk::Trained).unwrap_err().to_string();
    assert!(text.contains("96 x 64"), "{text}");
}

#[test]
fn the_trunk_starts_from_raft() {
    let small = NetworkConfig::small();
    let raft = Weights::random(&small, 1);
    let config = tiny();
    let weights = Weights::detector_from_raft(&config, &raft, 2).unwrap();
    assert_eq!(
        weights.get("trunk.layer3.1.conv2.weight").unwrap().data,
        raft.get("fnet.layer3.1.conv2.weight").unwrap().data
    );
    assert!(weights.get("class.bias").unwrap().data.iter().all(|v| *v == -4.6));
    let paper = Weights::random(&NetworkConfig::paper(), 1);
    assert!(Weights::detector_from_raft(&config, &paper, 2).unwrap_err().to_string().contains("fnet."));
    assert!(DetectorConfig { input_px: [320, 240], ..config }.check().unwrap_err().to_string().contains("input_px"));
}

#[test]
fn other_objects_start_from_an_initializer_that_knows_some() {
    let (two, three) = (DetectorConfig { objects: 2, ..tiny() }, DetectorConfig { objects: 3, ..tiny() });
    let known = Weights::random(&two, 4);
    let weights = Weights::detector_from_known(&three, &known).unwrap();
    let data = |weights: &Weights, name: &str| weights.get(name).unwrap().data.clone();
    for name in ["trunk.conv1.weight", "stage2.1.conv1.weight", "tower.1.weight", "rectangle.weight"] {
        assert_eq!(data(&weights, name), data(&known, name), "{name}");
    }
    for name in ["class.weight", "corners.weight", "surface.bias"] {
        let (old, new) = (data(&known, name), data(&weights, name));
        let (first, second) = old.split_at(old.len() / 2);
        assert_eq!(new.len() / 3, first.len());
        for (i, value) in new.iter().enumerate() {
            let at = i % first.len();
            assert!((value - (first[at] + second[at]) / 2.0).abs() < 1e-6, "{name} at {i}");
        }
    }
    let wider = DetectorConfig { pyramid: 32, ..three };
    let text = Weights::detector_from_known(&wider, &known).unwrap_err().to_string();
    assert!(text.contains("only the number of objects may differ"), "{text}");
}
