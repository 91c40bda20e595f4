use super::*;
use crate::labels::ExtraLoss;
use crate::loss::{FlowBatch, values};
use crate::train::{TrainConfig, TrainState};
use pseudoflow_network::FlowNetwork;
use pseudoflow_network::reference_geometry;

pub(crate) fn tiny() -> RefinerConfig {
    RefinerConfig { name: "tiny".into(), size_px: 64, iterations_train: 2, iterations_infer: 2 }
}

pub(crate) struct Pairs {
    pub(crate) reference: Vec<f32>,
    pub(crate) real: Vec<f32>,
    flow: Vec<f32>,
    visible: Vec<f32>,
}

impl Pairs {
    /// A patterned square, shifted by whole pixels; its right third is covered in the photograph.
    pub(crate) fn new(n: usize, size: usize) -> Self {
        let area = size * size;
        let mut pairs = Self { reference: vec![], real: vec![], flow: vec![], visible: vec![] };
        for image in 0..n {
            let (dx, dy) = (3 - 2 * image as i32, image as i32 - 2);
            let inside = |x: i32, y: i32| {
                let low = size as i32 / 4;
                (low..3 * low).contains(&x) && (low..3 * low).contains(&y)
            };
            let texture = |c: usize, x: i32, y: i32| {
                if inside(x, y) { (x as f32 * 0.5 + c as f32).sin() * (y as f32 * 0.4).cos() } else { 0.0 }
            };
            let at = |p: usize| ((p % size) as i32, (p / size) as i32);
            let covered = |x: i32| x > 2 * size as i32 / 3;
            for c in 0..3 {
                pairs.reference.extend((0..area).map(at).map(|(x, y)| texture(c, x, y)));
                let real = |(x, y): (i32, i32)| if covered(x) { -0.5 } else { texture(c, x - dx, y - dy) };
                pairs.real.extend((0..area).map(at).map(real));
            }
            let depth: Vec<f32> = (0..area).map(at).map(|(x, y)| f32::from(u8::from(inside(x, y)))).collect();
            let mut planes = vec![0.0; 2 * area];
            reference_geometry(&depth, size, 100.0, &mut planes);
            pairs.reference.extend(planes);
            pairs.flow.extend(std::iter::repeat_n(dx as f32, area).chain(std::iter::repeat_n(dy as f32, area)));
            let visible = |(x, y): (i32, i32)| match (inside(x, y), covered(x + dx)) {
                (false, _) => -1.0,
                (true, hidden) => f32::from(u8::from(!hidden)),
            };
            pairs.visible.extend((0..area).map(at).map(visible));
        }
        pairs
    }

    pub(crate) fn batch(&self, n: usize) -> RefinerBatch<'_> {
        let Self { reference, real, flow, visible } = self;
        RefinerBatch { reference, real, flow, visible, n }
    }
}

#[test]
fn learns_flow_and_visibility_of_one_batch() {
    let config = tiny();
    let weights = Weights::random(&config, 1);
    let mut state = TrainState::new(config.clone(), TrainConfig::new(2e-3, 150), weights, &Device::flex()).unwrap();
    let pairs = Pairs::new(2, 64);
    let first = state.train_step(&pairs.batch(2)).unwrap();
    let last = (0..120).map(|_| state.train_step(&pairs.batch(2)).unwrap()).last().unwrap();
    assert!(last.loss < 0.5 * first.loss && last.epe < 1.0, "{first:?} to {last:?}");
    let device = Device::flex();
    let refiner = Refiner::new(&state.weights, &config, &device).unwrap();
    let out = refiner.infer_slices(&pairs.reference, &pairs.real, 2, 64, 2, &device).unwrap();
    let area = 64 * 64;
    let mean = |wanted: f32| {
        let of_first = (0..area).filter(|i| pairs.visible[*i] == wanted).map(|i| out[4 * area + i]);
        let (sum, n) = of_first.fold((0.0, 0), |(sum, n), logit| (sum + logit, n + 1));
        sum / n as f32
    };
    assert!(
        mean(1.0) > 1.0 && mean(1.0) > mean(0.0) + 1.5,
        "visibility of seen {} and hidden {}",
        mean(1.0),
        mean(0.0)
    );
}

#[test]
fn any_multiple_of_sixteen_fits_and_others_are_refused() {
    let (config, device) = (tiny(), Device::flex());
    let refiner = Refiner::new(&Weights::random(&config, 2), &config, &device).unwrap();
    for size in [64, 80, 144] {
        let pairs = Pairs::new(1, size);
        let out = refiner.infer_slices(&pairs.reference, &pairs.real, 1, size, 3, &device).unwrap();
        assert!(out.len() == 5 * size * size && out.iter().all(|v| v.is_finite()));
    }
    let error = refiner.infer_slices(&[], &[], 1, 72, 1, &device).unwrap_err().to_string();
    assert!(error.contains("72") && error.contains("16"), "{error}");
}

#[test]
fn bad_batches_are_refused() {
    let pairs = Pairs::new(1, 64);
    let device = Device::flex();
    let short = RefinerBatch { visible: &pairs.visible[1..], ..pairs.batch(1) };
    assert!(short.to_device(64, &device).unwrap_err().to_string().contains("visible"));
    let mut reference = pairs.reference.clone();
    reference[7] = f32::NAN;
    let text = RefinerBatch { reference: &reference, ..pairs.batch(1) }.to_device(64, &device).unwrap_err().to_string();
    assert!(text.contains("reference"), "{text}");
}

#[test]
fn the_coarse_target_is_the_mean_of_what_is_seen() {
    let pairs = Pairs::new(1, 64);
    let data = pairs.batch(1).to_device(64, &Device::flex()).unwrap();
    let (flow, weight) = (values(data.coarse_flow), values(data.coarse_weight));
    let (side, inside) = (8, 2 * 8 + 2);
    assert_eq!(weight[inside], 1.0);
    assert!((flow[inside] - 3.0 / 8.0).abs() < 1e-6 && (flow[side * side + inside] + 2.0 / 8.0).abs() < 1e-6);
    assert_eq!((weight[0], flow[0]), (0.0, 0.0));
}

/// The gradient of all but the iterations (they detach the flow) and of the loss against a central difference uphill.
#[test]
fn gradient_of_the_whole_loss_equals_differences() {
    let (config, device) = (tiny(), Device::flex().autodiff());
    let weights = Weights::random(&config, 5);
    let pairs = Pairs::new(1, 64);
    let loss = |weights: &Weights| {
        let refiner = Refiner::new(weights, &config, &device).unwrap();
        let data = pairs.batch(1).to_device(64, &device).unwrap();
        let refinement = refiner.forward(data.reference.clone(), data.real.clone(), 0);
        (train::refiner_loss(&refinement, &data, 0.8), refiner)
    };
    let (value, refiner) = loss(&weights);
    let read = crate::model::gradients_with::<RefinerConfig>(&refiner, &value.backward(), vec![]);
    let (gradient, _) = read.unwrap();
    let square: f64 = gradient.values().flatten().map(|g| f64::from(*g).powi(2)).sum();
    let step = 2e-4 / square.sqrt();
    let moved = |sign: f64| {
        let mut weights = weights.clone();
        for tensor in weights.tensors_mut() {
            let slope = &gradient[&tensor.name];
            tensor.data.iter_mut().zip(slope).for_each(|(v, g)| *v += (sign * step * f64::from(*g)) as f32);
        }
        f64::from(values(loss(&weights).0)[0])
    };
    let numeric = (moved(1.0) - moved(-1.0)) / (2.0 * step);
    assert!((numeric / square - 1.0).abs() < 0.03, "{numeric} against {square}");
}

/// Labels teach the flow; what is seen and what is sure is not theirs to say.
#[test]
fn labels_teach_the_flow_and_leave_the_certainty_alone() {
    let network = FlowNetwork::Refiner(tiny());
    let pairs = Pairs::new(2, 64);
    let mask: Vec<f32> = pairs.visible.iter().map(|v| v.max(0.0)).collect();
    let batch = FlowBatch { reference: &pairs.reference, real: &pairs.real, flow: &pairs.flow, mask: &mask, n: 2 };
    let config = TrainConfig::new(1e-3, 30);
    let mut state = TrainState::new(network.clone(), config, Weights::random(&network, 1), &Device::flex()).unwrap();
    let before = state.weights.clone();
    let none = |flow: &[f32]| ExtraLoss { value: 0.0, gradient: vec![0.0; flow.len()] };
    let errors: Vec<f32> = (0..30).map(|_| state.train_step_with(&batch, 64, 1.0, none).unwrap().epe).collect();
    assert!(errors[29] < 0.7 * errors[0], "{errors:?}");
    let heads = |weights: &Weights| -> Vec<Vec<f32>> {
        let own = weights.tensors().iter().filter(|t| t.name.contains("certainty") && t.name.ends_with("bias"));
        own.map(|t| t.data.clone()).collect()
    };
    // Weight decay is all that touches them.
    let pairs = heads(&before).concat().into_iter().zip(heads(&state.weights).concat());
    let moved: Vec<f32> = pairs.map(|(before, after)| (after - before).abs()).collect();
    assert!(!moved.is_empty() && moved.iter().all(|m| *m < 1e-5), "{moved:?}");
}

/// A loss from outside reaches the weights by its gradient alone.
#[test]
fn a_loss_from_outside_moves_the_flow_along_its_gradient() {
    for network in [FlowNetwork::Refiner(tiny()), FlowNetwork::named("nano").unwrap()] {
        let (pairs, channels) = (Pairs::new(1, 64), network.reference_channels());
        let (flow, mask) = (vec![0.0; 2 * 64 * 64], vec![0.0; 64 * 64]);
        let reference = &pairs.reference[..channels * 64 * 64];
        let batch = FlowBatch { reference, real: &pairs.real, flow: &flow, mask: &mask, n: 1 };
        let config = TrainConfig::new(1e-3, 10);
        let mut state =
            TrainState::new(network.clone(), config, Weights::random(&network, 1), &Device::flex()).unwrap();
        let mut mean_x = Vec::new();
        for _ in 0..6 {
            let push = |flow: &[f32]| {
                mean_x.push(flow[..64 * 64].iter().sum::<f32>() / 4096.0);
                // To the left everywhere: down the gradient is to the right.
                let gradient = (0..flow.len()).map(|i| if i < 4096 { -1e-4 } else { 0.0 }).collect();
                ExtraLoss { value: 0.0, gradient }
            };
            state.train_step_with(&batch, 64, 1.0, push).unwrap();
        }
        assert!(mean_x[5] > mean_x[0] + 0.05, "{}: {mean_x:?}", network.is_refiner());
    }
}
