//! Weights that come while the node runs: swapped between two frames, at the frame that lockstep says.

use pseudoflow_flow::{FlowConfig, FlowNode, Lockstep, Network};
use pseudoflow_inference::{Backend, EngineConfig};
use pseudoflow_msgs::{
    AlignedBytes, FlowFields, FrameKey, Message, NetworkWeights, NetworkWeightsHeader, Partner, ReferenceViews,
    ReferenceViewsHeader,
};
use pseudoflow_network::{ComputeDevice, NetworkConfig, Weights};
use pseudoflow_runtime::{Context, InMemory, Node};
use std::path::Path;

const SIZE: u32 = 64;

fn weights(seed: u64) -> Weights {
    Weights::random(&NetworkConfig::nano(), seed)
}

fn file(seed: u64) -> Vec<u8> {
    weights(seed).to_bytes()
}

/// One instance with two views and two partners, the second of them absent.
fn views() -> AlignedBytes {
    let header = ReferenceViewsHeader {
        instances: 1,
        views_per_instance: 2,
        size_px: SIZE,
        scene_id: 0,
        image_id: 0,
        skipped: 0,
        partners_per_instance: 2,
        reserved: 0,
    };
    let mut bytes = AlignedBytes::zeroed(ReferenceViews::byte_len(&header));
    let message = ReferenceViews::write(&mut bytes, header);
    message.partners[0] = Partner { scene_id: 0, image_id: 1, present: 1, reserved: 0 };
    for (i, value) in message.rgb.iter_mut().chain(message.real_rgb).chain(message.partner_rgb).enumerate() {
        *value = (i * 31 % 253) as u8;
    }
    bytes
}

fn message(version: u64, seed: u64, previous: Option<u64>) -> AlignedBytes {
    let (newest, previous) = (file(seed), previous.map(file).unwrap_or_default());
    let header = NetworkWeightsHeader {
        version,
        step: 0,
        frames_per_version: 2,
        weights_bytes: newest.len() as u64,
        previous_bytes: previous.len() as u64,
    };
    let mut bytes = AlignedBytes::zeroed(NetworkWeights::byte_len(&header));
    NetworkWeights::write(&mut bytes, header, &newest, &previous);
    bytes
}

fn inputs(frame: u64, weights: Option<AlignedBytes>) -> InMemory {
    let mut inputs = InMemory::new(FrameKey { index: frame, stamp_ns: 0 });
    inputs.messages.push(("views".into(), views()));
    inputs.messages.extend(weights.map(|bytes| ("weights".to_owned(), bytes)));
    inputs
}

fn open(folder: &Path, engine: EngineConfig, lockstep: Option<Lockstep>) -> FlowNode {
    let model = folder.join("start.safetensors");
    weights(1).save(&model).unwrap();
    let config = FlowConfig {
        model,
        network: Network::Nano,
        size_px: SIZE,
        iterations: Some(2),
        max_batch: 2,
        device: ComputeDevice::Cpu,
        engine,
        lockstep,
    };
    FlowNode::check(&config).unwrap();
    FlowNode::create(config, &context()).unwrap()
}

fn context() -> Context {
    Context { name: "flow".into(), seed: 0, out_dir: "/".into(), restarts: 0, replay: true }
}

/// The weights' version that the node states, and its flow.
fn flow(node: &mut FlowNode, inputs: &InMemory) -> (u64, Vec<f32>) {
    let mut out = InMemory::default();
    node.process(inputs, &mut out, &context()).unwrap();
    let fields = FlowFields::view(&out.messages[0].1).unwrap();
    (fields.header.weights_version, fields.flow_px.to_vec())
}

fn engines() -> Vec<EngineConfig> {
    let rten = EngineConfig { backend: Backend::Rten, ..EngineConfig::default() };
    let library = std::env::var_os("PSEUDOFLOW_ONNXRUNTIME").map(Into::into);
    let onnxruntime =
        library.map(|file| EngineConfig { backend: Backend::OnnxRuntime, onnxruntime: Some(file), ..rten.clone() });
    let burn = EngineConfig { backend: Backend::Burn, ..EngineConfig::default() };
    [rten, burn].into_iter().chain(onnxruntime).collect()
}

#[test]
fn new_weights_are_used_from_the_next_frame_on() {
    let folder = tempfile::tempdir().unwrap();
    for engine in engines() {
        let mut node = open(folder.path(), engine, None);
        let (version, first) = flow(&mut node, &inputs(0, None));
        assert_eq!(version, 0);
        let (version, second) = flow(&mut node, &inputs(1, Some(message(3, 2, None))));
        assert_eq!(version, 3);
        assert_ne!(first, second);
        assert_eq!(flow(&mut node, &inputs(2, Some(message(4, 1, None)))), (4, first), "the first weights again");
    }
}

#[test]
fn partners_get_their_flow_from_view_0_and_absent_ones_none() {
    let folder = tempfile::tempdir().unwrap();
    let mut node = open(folder.path(), engines()[0].clone(), None);
    let (_, flow) = flow(&mut node, &inputs(0, None));
    let field = 2 * (SIZE * SIZE) as usize;
    assert_eq!(flow.len(), 4 * field, "two views, then two partners");
    assert!(flow[2 * field..3 * field].iter().any(|v| *v != 0.0));
    assert!(flow[3 * field..].iter().all(|v| *v == 0.0));
}

#[test]
fn lockstep_waits_for_its_publication_and_never_takes_a_newer_one() {
    let folder = tempfile::tempdir().unwrap();
    // Two frames a step, a publication every step: frames 0 to 3 want number 0, frames 4 and 5 number 1.
    let lockstep = Lockstep { frames_per_step: 2, publish_every: 1, first_step: 0 };
    assert_eq!((0..8).map(|frame| lockstep.publication_for(frame)).collect::<Vec<_>>(), [0, 0, 0, 0, 1, 1, 2, 2]);
    let mut node = open(folder.path(), engines()[0].clone(), Some(lockstep));
    assert!(!node.ready(&inputs(0, None)).unwrap());
    let start = inputs(0, Some(message(0, 1, None)));
    assert!(node.ready(&start).unwrap());
    assert_eq!(flow(&mut node, &start).0, 0);
    // Number 1 has come early: frame 3 still wants the one before.
    assert_eq!(flow(&mut node, &inputs(3, Some(message(1, 2, Some(1))))).0, 0);
    assert!(!node.ready(&inputs(4, Some(message(0, 1, None)))).unwrap(), "number 1 is not there yet");
    let late = inputs(4, Some(message(2, 3, Some(2))));
    assert!(node.ready(&late).unwrap());
    let (version, out) = flow(&mut node, &late);
    assert_eq!(version, 1);
    let mut other = open(folder.path(), engines()[0].clone(), None);
    assert_eq!(out, flow(&mut other, &inputs(0, Some(message(9, 2, None)))).1, "that of number 1, not of number 2");
    // A recorder's death brings frame 3 back: the engine that it had is still there, whatever has come since.
    let again = inputs(3, Some(message(2, 3, Some(2))));
    assert!(node.ready(&again).unwrap());
    assert_eq!(flow(&mut node, &again).0, 0);
    // Frame 4 comes again when the trainer, which has taken it, is two publications ahead: its acknowledgement is on
    // its way, and whoever computed the frame anew would do so with other weights.
    let node = open(folder.path(), engines()[0].clone(), Some(lockstep));
    assert!(!node.ready(&inputs(4, Some(message(3, 4, Some(3))))).unwrap());
    let other = Lockstep { frames_per_step: 3, ..lockstep };
    let node = open(folder.path(), engines()[0].clone(), Some(other));
    let error = node.ready(&inputs(4, Some(message(2, 3, Some(2))))).unwrap_err().to_string();
    assert!(error.contains("every 3 frames") && error.contains("every 2"), "{error}");
}
