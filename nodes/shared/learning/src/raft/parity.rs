//! Layer-by-layer parity with the authors' network on the fixture that they never saw here: an image pair with the
//! intermediate tensors of RAFT-small as its authors trained it.

use super::*;
use burn::tensor::TensorData;
use pseudoflow_network::Model as _;
use pseudoflow_network::NamedTensor;
use pseudoflow_network::storage::parse;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..")
}

fn fixture() -> BTreeMap<String, NamedTensor> {
    let path = root().join("tests/fixtures/raft/raft_small_parity.safetensors");
    parse(&std::fs::read(&path).unwrap(), &path).unwrap().1
}

fn tensor(from: &NamedTensor, device: &Device) -> Tensor<4> {
    Tensor::from_data(TensorData::new(from.data.clone(), from.shape.clone()), device)
}

fn assert_close(what: &str, ours: Tensor<4>, theirs: &NamedTensor, tolerance: f32) {
    assert_eq!(ours.dims().to_vec(), theirs.shape, "{what}");
    let ours = ours.into_data().try_into_vec::<f32>().unwrap();
    let worst = ours.iter().zip(&theirs.data).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst < tolerance, "{what} differs by {worst}");
}

#[test]
fn raft_small_equals_the_authors_layer_by_layer() {
    let device = Device::flex();
    let config = NetworkConfig::small();
    let path = root().join("config/weights/raft_small.safetensors");
    let weights = Weights::load(&path, &config).unwrap();
    assert!(weights.info.origin.contains("BSD"), "{:?}", weights.info);
    let raft = Raft::new(&weights, &config, &device).unwrap();
    let parity = fixture();
    let image = |name: &str| tensor(&parity[name], &device) / 255.0 * 2.0 - 1.0;
    let (a, b) = (image("image_a"), image("image_b"));

    assert_close("fnet a", raft.feature_encoder.forward(a.clone()), &parity["fnet_a"], 1e-4);
    assert_close("fnet b", raft.feature_encoder.forward(b.clone()), &parity["fnet_b"], 1e-4);
    assert_close("cnet", raft.context_encoder.forward(a.clone()), &parity["cnet"], 1e-4);

    let pyramid = raft.pyramid(a.clone(), b.clone());
    let (hidden, context) = raft.context(a.clone());
    let zero = Tensor::zeros([1, 2, 16, 16], &device);
    let motion = raft.update.motion(pyramid.lookup(&zero), zero);
    assert_close("motion encoder", motion.clone(), &parity["motion_encoder_iter0"], 1e-4);
    let hidden = raft.update.hidden(hidden, &motion, &raft.update.context(&context));
    assert_close("GRU", hidden.clone(), &parity["gru_iter0"], 1e-4);
    assert_close("flow head", raft.update.delta(&hidden), &parity["flow_head_iter0"], 1e-4);

    let flows = raft.forward(a.clone(), b.clone(), 6);
    for (i, flow) in flows.into_iter().enumerate() {
        assert_close(&format!("flow {i}"), flow, &parity[&format!("flow_up_iter{i}")], 1e-3);
    }
    assert_close("last flow alone", raft.infer(a, b, 6), &parity["flow_up_iter5"], 1e-3);
}

#[test]
fn weights_of_another_network_are_named() {
    let path = root().join("config/weights/raft_small.safetensors");
    let message = Weights::load(&path, &NetworkConfig::paper()).unwrap_err().to_string();
    for part in ["raft_small.safetensors", "`paper`", "fnet.conv1.weight", "[32, 3, 7, 7]", "[64, 3, 7, 7]"] {
        assert!(message.contains(part), "{message}");
    }
    let small = Weights::random(&NetworkConfig::small(), 1);
    let error = Raft::new(&small, &NetworkConfig::paper(), &Device::flex()).unwrap_err();
    assert!(error.to_string().contains("fnet.conv1.weight"), "{error}");
}

#[test]
fn basic_network_runs_and_has_the_published_size() {
    let mut config = NetworkConfig::paper();
    config.size_px = 64;
    let weights = Weights::random(&config, 7);
    let trained = config.layout().into_iter().filter(|t| !t.name.contains(".running_"));
    let count: usize = trained.map(|t| t.shape.iter().product::<usize>()).sum();
    // 5,257,536 in the authors' code (their shared norm3 / downsample.1 counted once).
    assert_eq!(count, 5_257_536);
    let raft = Raft::new(&weights, &config, &Device::flex()).unwrap();
    let image = vec![0.25; 3 * 64 * 64];
    let flow = raft.infer_slices(&image, &image, 1, 64, 2, &Device::flex()).unwrap();
    assert_eq!(flow.len(), 2 * 64 * 64);
    assert!(flow.iter().all(|v| v.is_finite()));
}
