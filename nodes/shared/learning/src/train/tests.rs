use super::*;
use crate::raft::Raft;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

pub(crate) fn tiny() -> NetworkConfig {
    NetworkConfig { name: "tiny".into(), size_px: 64, iterations_train: 2, ..NetworkConfig::nano() }
}

pub(crate) struct Data {
    pub(crate) reference: Vec<f32>,
    pub(crate) real: Vec<f32>,
    pub(crate) flow: Vec<f32>,
    pub(crate) mask: Vec<f32>,
}

/// A blob texture shifted by a whole number of px, so that the flow is exact.
pub(crate) fn data(n: usize, seed: u64) -> Data {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (size, area) = (64_usize, 64 * 64);
    let mut data = Data { reference: vec![], real: vec![], flow: vec![], mask: vec![0.0; n * area] };
    for i in 0..n {
        let (dx, dy) = (rng.random_range(-4..=4_i32), rng.random_range(-4..=4_i32));
        let phase: [f32; 3] = std::array::from_fn(|_| rng.random_range(0.0..6.0));
        let texture = |c: usize, x: i32, y: i32| (x as f32 * 0.5 + phase[c]).sin() * (y as f32 * 0.4 - phase[c]).cos();
        for c in 0..3 {
            for p in 0..area {
                let (x, y) = ((p % size) as i32, (p / size) as i32);
                data.reference.push(texture(c, x, y));
                data.real.push(texture(c, x - dx, y - dy));
            }
        }
        data.flow.extend(std::iter::repeat_n(dx as f32, area).chain(std::iter::repeat_n(dy as f32, area)));
        (0..area).filter(|p| p % size > 8).for_each(|p| data.mask[i * area + p] = 1.0);
    }
    data
}

pub(crate) fn batch(data: &Data, n: usize) -> FlowBatch<'_> {
    FlowBatch { reference: &data.reference, real: &data.real, flow: &data.flow, mask: &data.mask, n }
}

fn state(steps: u64) -> TrainState {
    let config = tiny();
    let weights = Weights::random(&config, 3);
    TrainState::new(config, TrainConfig::new(4e-4, steps), weights, &Device::flex()).unwrap()
}

fn run(state: &mut TrainState, steps: u64) -> Vec<StepStats> {
    (0..steps).map(|_| state.train_step(&batch(&data(2, state.step()), 2)).unwrap()).collect()
}

#[test]
fn resume_has_the_bits_of_an_unbroken_run() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.safetensors");
    let mut unbroken = state(6);
    run(&mut unbroken, 6);
    let mut first = state(6);
    run(&mut first, 3);
    first.save(&path).unwrap();
    let mut second = TrainState::load(&path, tiny(), &Device::flex()).unwrap();
    assert_eq!(second.step(), 3);
    run(&mut second, 3);
    assert_eq!(second.weights, unbroken.weights);
    assert_eq!(second.moments, unbroken.moments);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no partial file stays");
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let results: Vec<Weights> = [1, 2, 3]
        .into_iter()
        .map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut state = state(2);
                run(&mut state, 2);
                state.weights
            })
        })
        .collect();
    assert!(results[0] == results[1] && results[0] == results[2]);
}

#[test]
fn the_loss_falls_on_one_batch() {
    let mut state = state(60);
    let data = data(2, 1);
    let first = state.train_step(&batch(&data, 2)).unwrap();
    let last = (0..40).map(|_| state.train_step(&batch(&data, 2)).unwrap()).last().unwrap();
    assert!(last.loss < 0.7 * first.loss, "{} to {}", first.loss, last.loss);
    assert_eq!(last.step, 41);
}

/// The gradient of the whole network and loss against a central difference along random directions of the weights
/// that go uphill, so that the difference stands out of the rounding.
#[test]
fn gradient_of_the_whole_loss_equals_differences() {
    let config = tiny();
    let device = Device::flex().autodiff();
    let weights = Weights::random(&config, 5);
    let data = data(1, 2);
    let loss = |weights: &Weights| {
        let raft = Raft::new(weights, &config, &device).unwrap();
        let batch = batch(&data, 1).to_device(64, &device).unwrap();
        let flows = raft.forward(batch.reference.clone(), batch.real.clone(), 1);
        (sequence_loss(&flows, &batch, 0.8), raft)
    };
    let (value, raft) = loss(&weights);
    let (grads, _) = gradients_with::<NetworkConfig>(&raft, &value.backward(), vec![]).unwrap();
    for seed in 0..3 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut slope = 0.0_f64;
        let (mut up, mut down) = (weights.clone(), weights.clone());
        for (up, down) in up.tensors_mut().zip(down.tensors_mut()) {
            for i in 0..up.data.len() {
                let g = grads[&up.name][i];
                let d = g.signum() * up.data[i].abs().max(1e-3) * rng.random_range(0.0..1.0_f32) * 1e-3;
                slope += f64::from(d) * f64::from(g);
                up.data[i] += d;
                down.data[i] -= d;
            }
        }
        let at = |w: &Weights| f64::from(values(loss(w).0)[0]);
        let numeric = (at(&up) - at(&down)) / 2.0;
        assert!((numeric - slope).abs() < 0.02 * slope.abs(), "{numeric} against {slope}");
    }
}

#[test]
fn not_finite_leaves_the_weights() {
    let mut state = state(2);
    let before = state.weights.clone();
    let error = state.step_with(|raft| {
        let zero = Tensor::zeros([1, 3, 64, 64], &Device::flex().autodiff());
        raft.forward(zero.clone(), zero, 1)[0].clone().sum() * f32::NAN
    });
    assert!(error.unwrap_err().to_string().contains("step 0"));
    assert_eq!(state.weights, before);
}

#[test]
fn foreign_checkpoints_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("w.safetensors");
    state(2).weights.save(&path).unwrap();
    let text = TrainState::load(&path, tiny(), &Device::flex()).unwrap_err().to_string();
    assert!(text.contains("plain weights"), "{text}");
    state(2).save(&path).unwrap();
    let text = TrainState::load(&path, NetworkConfig::small(), &Device::flex()).unwrap_err().to_string();
    assert!(text.contains("tiny"), "{text}");
    std::fs::write(&path, b"nonsense").unwrap();
    let text = TrainState::load(&path, tiny(), &Device::flex()).unwrap_err().to_string();
    assert!(text.contains("safetensors"), "{text}");
}
