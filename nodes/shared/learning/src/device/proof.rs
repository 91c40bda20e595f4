//! Proof on a Vulkan adapter, at small shapes: flow, gradients and training steps are those of the processor's kernels up
//! to rounding. In f32 both sum in another order; the bounds are what is asked, no device has been measured yet.
#![allow(clippy::print_stdout, reason = "it says how far apart they are")]

use super::*;
use crate::detector::tests as detector;
use crate::model::{Trainable, gradients_with};
use crate::refiner::tests as refiner;
use crate::refiner::train::refiner_loss;
use crate::train::tests::{batch, data, tiny};
use crate::{LossWeights, Raft, Refiner, TrainConfig, TrainState, Trunk, sequence_loss};
use burn::tensor::Tensor;
use pseudoflow_network::{Grid, NetworkConfig, Weights};

/// Flow, px: largest difference.
const FLOW_PX: f32 = 2e-3;
/// Gradients: norm of the difference over the norm.
const GRADIENT: f64 = 1e-3;
/// A step of the weights: norm of the difference over the norm of the step. AdamW's first steps have the size of the
/// rate wherever the gradient is more than rounding, also where that decides its sign.
const STEP: f64 = 0.02;

/// The first adapter, also one that computes on the processor.
fn adapter() -> Device {
    let open = OpenDevice::open(ComputeDevice::Vulkan(Some(0)));
    open.unwrap_or_else(|error| panic!("these tests want a Vulkan adapter (Debian: mesa-vulkan-drivers): {error}"))
        .device
}

fn distance(a: &[f32], b: &[f32]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>().sqrt()
}

fn all_values(weights: &Weights) -> Vec<f32> {
    weights.tensors().iter().flat_map(|t| t.data.iter().copied()).collect()
}

fn flow_on(device: &Device, config: &NetworkConfig, weights: &Weights) -> Vec<f32> {
    let data = data(1, 4);
    let raft = Raft::new(weights, config, device).unwrap();
    raft.infer_slices(&data.reference, &data.real, 1, 64, 2, device).unwrap()
}

#[test]
fn flow_of_both_architectures_is_that_of_the_processor() {
    for config in [tiny(), NetworkConfig { size_px: 64, ..NetworkConfig::paper() }] {
        let weights = Weights::random(&config, 3);
        let (here, there) = (flow_on(&Device::flex(), &config, &weights), flow_on(&adapter(), &config, &weights));
        let worst = here.iter().zip(&there).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        let largest = here.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
        println!("{}: flow up to {largest} px differs by up to {worst} px", config.name);
        assert!(worst < FLOW_PX && largest > 100.0 * FLOW_PX, "{}: {worst} of {largest} px", config.name);
    }
}

#[test]
fn a_refiner_says_what_it_does_on_the_processor() {
    let (config, pairs) = (refiner::tiny(), refiner::Pairs::new(1, 64));
    let weights = Weights::random(&config, 3);
    let on = |device: &Device| {
        let refiner = Refiner::new(&weights, &config, device).unwrap();
        refiner.infer_slices(&pairs.reference, &pairs.real, 1, 64, 2, device).unwrap()
    };
    let (here, there) = (on(&Device::flex()), on(&adapter()));
    let worst = here.iter().zip(&there).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    println!("refiner: differs by up to {worst}");
    assert!(worst < FLOW_PX && here.iter().any(|v| v.abs() > 100.0 * FLOW_PX), "{worst}");
}

/// Gradients by name, in the network's order.
type Gradients = Vec<(String, Vec<f32>)>;

fn gradient_on(device: &Device, config: &NetworkConfig, weights: &Weights) -> Gradients {
    let device = device.clone().autodiff();
    let data = data(2, 5);
    let raft = Raft::new(weights, config, &device).unwrap();
    let batch = batch(&data, 2).to_device(64, &device).unwrap();
    let flows = raft.forward(batch.reference.clone(), batch.real.clone(), 2);
    in_order(config, &raft, sequence_loss(&flows, &batch, 0.8))
}

fn in_order<M: Trainable>(config: &M, network: &M::Network, loss: Tensor<1>) -> Gradients {
    let (mut by_name, _) = gradients_with::<M>(network, &loss.backward(), vec![]).unwrap();
    let names = config.layout().into_iter().map(|spec| spec.name);
    names.filter_map(|name| by_name.remove(&name).map(|grad| (name, grad))).collect()
}

#[test]
fn gradients_are_those_of_the_processor() {
    let config = tiny();
    let weights = Weights::random(&config, 3);
    assert_same_gradients(
        &gradient_on(&Device::flex(), &config, &weights),
        &gradient_on(&adapter(), &config, &weights),
    );
}

#[test]
fn gradients_of_a_refiner_are_those_of_the_processor() {
    let (config, pairs) = (refiner::tiny(), refiner::Pairs::new(2, 64));
    let weights = Weights::random(&config, 3);
    let on = |device: &Device| {
        let device = device.clone().autodiff();
        let refiner = Refiner::new(&weights, &config, &device).unwrap();
        let batch = pairs.batch(2).to_device(64, &device).unwrap();
        let refinement = refiner.forward(batch.reference.clone(), batch.real.clone(), 2);
        in_order(&config, &refiner, refiner_loss(&refinement, &batch, 0.8))
    };
    assert_same_gradients(&on(&Device::flex()), &on(&adapter()));
}

fn assert_same_gradients(here: &Gradients, there: &Gradients) {
    assert_eq!(here.len(), there.len());
    let flat = |all: &[(String, Vec<f32>)]| all.iter().flat_map(|(_, g)| g.iter().copied()).collect::<Vec<f32>>();
    let (a, b) = (flat(here), flat(there));
    let (apart, norm) = (distance(&a, &b), distance(&a, &vec![0.0; a.len()]));
    println!("gradient of norm {norm} differs by {apart}");
    assert!(norm > 0.1 && apart < GRADIENT * norm, "{apart} of {norm}");
    for ((name, a), (_, b)) in here.iter().zip(there) {
        let own = distance(a, &vec![0.0; a.len()]);
        // A bias before an instance norm has no gradient but rounding.
        assert!(distance(a, b) < 0.01 * own + 1e-5 * norm, "{name}: {} of {own}", distance(a, b));
    }
}

fn state(device: &Device) -> TrainState {
    let config = tiny();
    let weights = Weights::random(&config, 3);
    TrainState::new(config, TrainConfig::new(4e-4, 100), weights, device).unwrap()
}

fn assert_same_step(start: &Weights, here: &Weights, there: &Weights) {
    let (start, here, there) = (all_values(start), all_values(here), all_values(there));
    let (apart, step) = (distance(&here, &there), distance(&here, &start));
    println!("a step of norm {step} differs by {apart}");
    assert!(step > 0.0 && apart < STEP * step, "{apart} of {step}");
}

#[test]
fn training_goes_on_on_another_device_and_a_device_that_fails_takes_nothing_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.safetensors");
    let train = |state: &mut TrainState| state.train_step(&batch(&data(2, state.step()), 2)).unwrap();
    let (mut here, mut there) = (state(&Device::flex()), state(&adapter()));
    let start = here.weights.clone();
    let (a, b) = (train(&mut here), train(&mut there));
    assert!((a.loss - b.loss).abs() < 1e-3 && (a.epe - b.epe).abs() < 1e-3, "{a:?} {b:?}");
    assert!((a.grad_norm - b.grad_norm).abs() < GRADIENT * a.grad_norm, "{a:?} {b:?}");
    assert_same_step(&start, &here.weights, &there.weights);
    // The adapter vanishes in the second step.
    let before = there.weights.clone();
    let lost = there.step_with(|raft| {
        let zero = Tensor::zeros([1, 3, 64, 64], &adapter().autodiff());
        drop(raft.forward(zero.clone(), zero, 1));
        panic!("device lost")
    });
    let message = lost.unwrap_err().to_string();
    assert!(message.contains("device lost") && message.contains("--device cpu"), "{message}");
    assert_eq!((there.step(), &there.weights), (1, &before));
    // It goes on on the processor.
    there.save(&path).unwrap();
    let mut there = TrainState::load(&path, tiny(), &Device::flex()).unwrap();
    train(&mut here);
    train(&mut there);
    assert_eq!(there.step(), 2);
    assert_same_step(&start, &here.weights, &there.weights);
}

#[test]
fn an_initializer_learns_as_on_the_processor() {
    let config = detector::tiny();
    let weights = Weights::random(&config, 3);
    let images = detector::noise(3 * 96 * 64, 7);
    let truth = [detector::scene(&Grid::new(96, 64))];
    let step = |device: &Device| {
        let training = TrainConfig::new(4e-4, 100);
        let mut state = TrainState::new(config.clone(), training, weights.clone(), device).unwrap();
        let (stats, _) = state.detection_step(&images, &truth, &LossWeights::default(), Trunk::Trained).unwrap();
        (stats, state.weights)
    };
    let ((a, here), (b, there)) = (step(&Device::flex()), step(&adapter()));
    assert!((a.loss - b.loss).abs() < 1e-3 * a.loss.abs(), "{a:?} {b:?}");
    assert_same_step(&weights, &here, &there);
}
