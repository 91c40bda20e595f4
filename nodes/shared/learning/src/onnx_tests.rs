//! What the ONNX export writes computes what burn computes.

use crate::Raft;
use crate::model::Trainable;
use burn::tensor::Device;
use pseudoflow_network::{
    DetectorConfig, ExportOptions, FlowNetwork, NetworkConfig, Pictures, RefinerConfig, Weights, export_detector,
    export_onnx, export_refiner,
};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rten_tensor::prelude::*;
use std::path::Path;

fn images(n: usize, size: usize, seed: u64) -> [Vec<f32>; 2] {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    [(); 2].map(|()| (0..n * 3 * size * size).map(|_| rng.random_range(-1.0..1.0)).collect())
}

/// Largest difference between the exported graph in rten and the network in burn, px.
fn difference(weights: &Weights, config: &NetworkConfig, options: ExportOptions, n: usize) -> f32 {
    let (size, device) = (options.size_px, Device::flex());
    let model = rten::Model::load(export_onnx(weights, config, options).unwrap()).unwrap();
    let [reference, real] = images(n, size, 1);
    let input = |name: &str, data: &[f32]| {
        let tensor = rten_tensor::Tensor::from_data(&[n, 3, size, size], data.to_vec());
        (model.node_id(name).unwrap(), rten::ValueOrView::from(tensor))
    };
    let inputs = vec![input("reference", &reference), input("real", &real)];
    let mut outputs = model.run(inputs, &[model.node_id("flow").unwrap()], None).unwrap();
    let flow: rten_tensor::Tensor<f32> = outputs.remove(0).try_into().unwrap();
    assert_eq!(flow.shape(), [n, 2, size, size]);
    let raft = Raft::new(weights, config, &device).unwrap();
    let ours = raft.infer_slices(&reference, &real, n, size, options.iterations, &device).unwrap();
    let theirs = flow.to_vec();
    ours.iter().zip(theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn small_network_equals_burn() {
    let config = NetworkConfig::small();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/weights/raft_small.safetensors");
    let weights = Weights::load(&path, &config).unwrap();
    for (batch, n) in [(Some(2), 2), (None, 3)] {
        let options = ExportOptions { size_px: 64, iterations: 3, batch };
        let worst = difference(&weights, &config, options, n);
        assert!(worst < 1e-3, "{worst} px with batch {batch:?}");
    }
}

#[test]
fn basic_network_equals_burn() {
    let config = NetworkConfig::paper();
    let mut weights = Weights::random(&config, 4);
    // Statistics as a trained network has them, so that the folding is tested.
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for tensor in weights.tensors_mut().filter(|t| t.name.contains("running_") || t.name.contains("norm")) {
        tensor.data.iter_mut().for_each(|v| *v += rng.random_range(0.0..0.5));
    }
    for (batch, n) in [(Some(1), 1), (None, 2)] {
        let worst = difference(&weights, &config, ExportOptions { size_px: 64, iterations: 2, batch }, n);
        assert!(worst < 1e-3, "{worst} px with batch {batch:?}");
    }
}

#[test]
fn bad_options_are_named() {
    let config = NetworkConfig::nano();
    let weights = Weights::random(&config, 1);
    let good = ExportOptions { size_px: 128, iterations: 6, batch: None };
    for (options, field) in [
        (ExportOptions { size_px: 100, ..good }, "size_px"),
        (ExportOptions { iterations: 0, ..good }, "iterations"),
        (ExportOptions { batch: Some(0), ..good }, "batch"),
    ] {
        let text = export_onnx(&weights, &config, options).unwrap_err().to_string();
        assert!(text.contains(field), "{text}");
    }
    let text = export_onnx(&weights, &NetworkConfig::paper(), good).unwrap_err().to_string();
    assert!(text.contains("fnet.conv1.weight"), "{text}");
    assert_eq!(export_onnx(&weights, &config, good).unwrap(), export_onnx(&weights, &config, good).unwrap());
}

#[test]
fn detector_equals_burn() {
    let config = DetectorConfig { name: "tiny".into(), input_px: [96, 64], widths: [16, 24], pyramid: 16, objects: 3 };
    let weights = Weights::random(&config, 3);
    let model = rten::Model::load(export_detector(&weights, &config).unwrap()).unwrap();
    let image = images(1, 96, 5)[0][..3 * 64 * 96].to_vec();
    let input = rten::ValueOrView::from(rten_tensor::Tensor::from_data(&[1, 3, 64, 96], image.clone()));
    let names = ["classes", "corners", "surface", "rectangles"].map(|name| model.node_id(name).unwrap());
    let theirs = model.run(vec![(model.node_id("image").unwrap(), input)], &names, None).unwrap();
    let network = config.build(&weights, &Device::flex()).unwrap();
    let image = burn::tensor::TensorData::new(image, [1, 3, 64, 96]);
    let ours = network.forward(burn::tensor::Tensor::from_data(image, &Device::flex()));
    for (ours, theirs) in ours.into_iter().zip(theirs) {
        let theirs: rten_tensor::Tensor<f32> = theirs.try_into().unwrap();
        assert_eq!(theirs.shape(), ours.dims());
        let ours = ours.into_data().try_into_vec::<f32>().unwrap();
        let worst = ours.iter().zip(theirs.to_vec()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 1e-3, "{worst}");
    }
}

#[test]
fn refiner_equals_burn() {
    let config = RefinerConfig::default();
    let weights = Weights::random(&config, 7);
    let (size, device) = (64, Device::flex());
    for (batch, n) in [(Some(2), 2), (None, 1)] {
        let options = ExportOptions { size_px: size, iterations: 3, batch };
        let model = rten::Model::load(export_refiner(&weights, &config, options).unwrap()).unwrap();
        let [real, first] = images(n, size, 1);
        let reference = [first, images(n, size, 2).concat()].concat()[..n * 5 * size * size].to_vec();
        let input = |name: &str, channels: usize, data: &[f32]| {
            let tensor = rten_tensor::Tensor::from_data(&[n, channels, size, size], data.to_vec());
            (model.node_id(name).unwrap(), rten::ValueOrView::from(tensor))
        };
        let inputs = vec![input("reference", 5, &reference), input("real", 3, &real)];
        let wanted = ["flow", "certainty"].map(|name| model.node_id(name).unwrap());
        let outputs = model.run(inputs, &wanted, None).unwrap();
        let [flow, certainty]: [rten_tensor::Tensor<f32>; 2] =
            outputs.into_iter().map(|o| o.try_into().unwrap()).collect::<Vec<_>>().try_into().unwrap();
        let refiner = config.build(&weights, &device).unwrap();
        let ours = refiner.infer_slices(&reference, &real, n, size, 3, &device).unwrap();
        let (area, sigmoid) = (size * size, |x: f32| 1.0 / (1.0 + (-x).exp()));
        let (flow, certainty) = (flow.to_vec(), certainty.to_vec());
        for image in 0..n {
            for i in 0..area {
                let ours = |channel: usize| ours[(5 * image + channel) * area + i];
                let theirs = |plane: &[f32], channel: usize| plane[(2 * image + channel) * area + i];
                for (a, b) in [
                    (ours(0), theirs(&flow, 0)),
                    (ours(1), theirs(&flow, 1)),
                    (sigmoid(ours(4)), theirs(&certainty, 0)),
                    (sigmoid(ours(2)), theirs(&certainty, 1)),
                ] {
                    assert!((a - b).abs() < 1e-3, "{a} and {b} at pixel {i} of image {image}, batch {batch:?}");
                }
            }
        }
    }
}

/// Features that a network exports for pictures of this many channels, by rten.
fn features(network: &FlowNetwork, weights: &Weights, pictures: Pictures, planes: &[f32]) -> Vec<f32> {
    let onnx = network.export_features(weights, 64, pictures).unwrap();
    let model = rten::Model::load(onnx).unwrap();
    let tensor = rten_tensor::Tensor::from_data(&[1, planes.len() / (64 * 64), 64, 64], planes.to_vec());
    let inputs = vec![(model.node_id("image").unwrap(), rten::ValueOrView::from(tensor))];
    let mut outputs = model.run(inputs, &[model.node_id("features").unwrap()], None).unwrap();
    let features: rten_tensor::Tensor<f32> = outputs.remove(0).try_into().unwrap();
    assert_eq!(features.shape(), [1, network.feature_channels(), 8, 8]);
    features.to_vec()
}

#[test]
fn features_of_renderings_know_their_geometry_and_are_else_those_of_photographs() {
    let network = FlowNetwork::named("refiner").unwrap();
    let mut weights = Weights::random(&network, 3);
    let [photograph, geometry] = images(1, 64, 5);
    let rendering: Vec<f32> = photograph.iter().chain(&geometry[..2 * 64 * 64]).copied().collect();
    let photographed = features(&network, &weights, Pictures::Photographs, &photograph);
    let away = |features: Vec<f32>| features.iter().zip(&photographed).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    // What geometry adds begins at nothing; what is left is the order of the sums.
    assert!(away(features(&network, &weights, Pictures::Renderings, &rendering)) < 1e-3);
    let trained = weights.tensors_mut().find(|t| t.name == "stem.geometry.weight").unwrap();
    trained.data.iter_mut().for_each(|v| *v = 0.3);
    assert!(away(features(&network, &weights, Pictures::Renderings, &rendering)) > 0.1);
}
