//! All engines give the same flow up to rounding: at most 0.02 px apart after four iterations on flow of some pixels.
//! burn runs on the processor here, and with the feature `vulkan` on an adapter as well (`tests/run gpu`).
#![allow(clippy::print_stdout, reason = "it says how far apart they are")]

use pseudoflow_flow::{FlowConfig, FlowNode, Network};
use pseudoflow_inference::{Backend, EngineConfig};
use pseudoflow_msgs::{AlignedBytes, FlowFields, FrameKey, Message, ReferenceViews, ReferenceViewsHeader};
use pseudoflow_network::ComputeDevice;
use pseudoflow_runtime::{Context, InMemory, Node};
use std::path::Path;

const SIZE: u32 = 64;
const TOLERANCE_PX: f32 = 0.02;

/// Three instances: not a power of two, which GPUs are asked for.
fn views() -> AlignedBytes {
    let header = ReferenceViewsHeader {
        instances: 3,
        views_per_instance: 1,
        size_px: SIZE,
        scene_id: 0,
        image_id: 0,
        skipped: 0,
        partners_per_instance: 0,
        reserved: 0,
    };
    let mut bytes = AlignedBytes::zeroed(ReferenceViews::byte_len(&header));
    let message = ReferenceViews::write(&mut bytes, header);
    let side = SIZE as usize;
    let shade = |x: f32, y: f32, c: usize| (127.0 + 90.0 * (0.31 * x + c as f32).sin() * (0.23 * y).cos()) as u8;
    for (i, (rgb, real)) in message.rgb.iter_mut().zip(message.real_rgb).enumerate() {
        let (c, x, y) = (i % 3, (i / 3 % side) as f32, (i / 3 / side) as f32);
        (*rgb, *real) = (shade(x, y, c), shade(x - 2.0, y + 1.0, c));
    }
    bytes
}

fn config(device: ComputeDevice, engine: EngineConfig) -> FlowConfig {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    FlowConfig {
        model: root.join("config/weights/raft_small.safetensors"),
        network: Network::Small,
        size_px: SIZE,
        iterations: Some(4),
        max_batch: 16,
        device,
        engine,
        lockstep: None,
    }
}

fn flow(config: FlowConfig) -> Vec<f32> {
    let context = Context { name: "flow".into(), seed: 0, out_dir: "/".into(), restarts: 0, replay: true };
    FlowNode::check(&config).unwrap();
    let mut node = FlowNode::create(config, &context).unwrap();
    let mut inputs = InMemory::new(FrameKey { index: 0, stamp_ns: 0 });
    inputs.messages.push(("views".into(), views()));
    let mut out = InMemory::default();
    node.process(&inputs, &mut out, &context).unwrap();
    FlowFields::view(&out.messages[0].1).unwrap().flow_px.to_vec()
}

fn backend(backend: Backend) -> EngineConfig {
    EngineConfig { backend, ..EngineConfig::default() }
}

/// Burn on the given devices, and ONNX Runtime where its library is.
fn others(devices: &[ComputeDevice]) -> Vec<(String, FlowConfig)> {
    let burn = devices.iter().map(|d| (format!("burn on {d}"), config(*d, backend(Backend::Burn))));
    let library = std::env::var_os("PSEUDOFLOW_ONNXRUNTIME").map(|file| {
        let engine = EngineConfig { onnxruntime: Some(file.into()), ..backend(Backend::OnnxRuntime) };
        ("ONNX Runtime".to_owned(), config(ComputeDevice::Cpu, engine))
    });
    burn.chain(library).collect()
}

fn assert_equal_to_rten(devices: &[ComputeDevice]) {
    let rten = flow(config(ComputeDevice::Cpu, backend(Backend::Rten)));
    let largest = rten.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
    assert!(largest > 1.0, "the pictures are apart by pixels, the flow by {largest}");
    for (name, config) in others(devices) {
        let other = flow(config);
        let worst = rten.iter().zip(&other).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        println!("{name}: flow up to {largest} px, at most {worst} px apart");
        assert!(other.len() == rten.len() && worst < TOLERANCE_PX, "{name}: {worst} px");
    }
}

#[test]
fn engines_on_the_processor_agree() {
    assert_equal_to_rten(&[ComputeDevice::Cpu]);
}

#[cfg(feature = "vulkan")]
#[test]
fn burn_on_vulkan_agrees() {
    assert_equal_to_rten(&[ComputeDevice::Vulkan(Some(0))]);
}

#[test]
fn an_onnx_file_does_not_run_on_burn_and_a_missing_device_is_an_error() {
    let context = Context { name: "flow".into(), seed: 0, out_dir: "/".into(), restarts: 0, replay: true };
    let refused = |config: FlowConfig| match FlowNode::create(config, &context) {
        Ok(_) => panic!("must be refused"),
        Err(error) => error.to_string(),
    };
    let missing = refused(config(ComputeDevice::Vulkan(Some(999)), EngineConfig::default()));
    assert!(missing.contains("vulkan:999"), "{missing}");
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("network.onnx");
    std::fs::write(&file, b"an ONNX file, for all that matters").unwrap();
    let onnx = FlowConfig { model: file, ..config(ComputeDevice::Cpu, backend(Backend::Burn)) };
    let message = refused(onnx);
    assert!(message.contains("safetensors"), "{message}");
}
