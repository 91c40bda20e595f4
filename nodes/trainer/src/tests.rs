//! The trainer on messages: a rendered pattern and the same pattern moved, with the motion as label.

use super::{AdaptState, TrainerConfig, TrainerNode, files};
use pseudoflow_msgs::{
    AlignedBytes, FlowFields, FlowFieldsHeader, FrameKey, InstanceLabels, Message, NetworkWeights, Partner,
    PseudoLabels, PseudoLabelsHeader, ReferenceViews, ReferenceViewsHeader,
};
use pseudoflow_network::{ComputeDevice, FlowNetwork, NetworkConfig, Weights};
use pseudoflow_runtime::{Context, InMemory, Node};
use std::path::Path;

const SIZE: u32 = 64;
const AREA: usize = (SIZE * SIZE) as usize;
const VIEWS: usize = 2;

fn context() -> Context {
    Context { name: "trainer".into(), seed: 5, out_dir: "/".into(), restarts: 0, replay: true }
}

fn config(folder: &Path, steps: u64) -> TrainerConfig {
    let weights = folder.join("start.safetensors");
    if !weights.exists() {
        Weights::random(&NetworkConfig::nano(), 3).save(&weights).unwrap();
    }
    let network = folder.join("tiny.yaml");
    std::fs::write(&network, "{name: nano, arch: small, size_px: 128, iterations_train: 2, iterations_infer: 2}")
        .unwrap();
    TrainerConfig {
        network: network.display().to_string(),
        size_px: SIZE,
        device: ComputeDevice::Cpu,
        frames_per_step: 2,
        publish_every: 2,
        max_lr: 4e-4,
        ..TrainerConfig::new(weights, folder.join("out"), steps)
    }
}

/// The flow that moves the pattern of a frame.
fn motion(frame: u64) -> [f32; 2] {
    [1.0 + (frame % 3) as f32, -(frame as f32 % 2.0)]
}

fn pattern(x: f32, y: f32) -> u8 {
    (127.0 + 60.0 * (0.5 * x).sin() + 50.0 * (0.35 * y + 0.2 * x).cos()) as u8
}

fn picture(by: [f32; 2]) -> Vec<u8> {
    (0..AREA).flat_map(|p| [pattern((p % 64) as f32 - by[0], (p / 64) as f32 - by[1]); 3]).collect()
}

/// Views, flow and labels of a frame; `usable` labels or none.
fn inputs(frame: u64, usable: bool) -> InMemory {
    let header = ReferenceViewsHeader {
        instances: 1,
        views_per_instance: VIEWS as u32,
        size_px: SIZE,
        scene_id: 0,
        image_id: frame as u32,
        skipped: 0,
        partners_per_instance: 1,
        reserved: 0,
    };
    let mut views = AlignedBytes::zeroed(ReferenceViews::byte_len(&header));
    let message = ReferenceViews::write(&mut views, header);
    message.mask.fill(255);
    message.depth_m.fill(1.0);
    message.views.iter_mut().for_each(|view| view.crop_intrinsics = [100.0, 100.0, 31.5, 31.5]);
    message.rgb.chunks_exact_mut(3 * AREA).for_each(|view| view.copy_from_slice(&picture([0.0; 2])));
    message.real_rgb.copy_from_slice(&picture(motion(frame)));
    message.partner_rgb.copy_from_slice(&picture([2.0, 1.0]));
    message.partners[0] = Partner { scene_id: 0, image_id: 99, present: 1, reserved: 0 };

    let header =
        FlowFieldsHeader { fields: VIEWS as u32 + 1, size_px: SIZE, weights_version: 0, has_certainty: 0, reserved: 0 };
    let mut flow = AlignedBytes::zeroed(FlowFields::byte_len(&header));
    let fields = FlowFields::write(&mut flow, header).flow_px;
    fields[VIEWS * 2 * AREA..].chunks_exact_mut(2).for_each(|v| v.copy_from_slice(&[2.0, 1.0]));

    let header = PseudoLabelsHeader {
        weights_version: 0,
        instances: 1,
        views_per_instance: VIEWS as u32,
        size_px: SIZE,
        scene_id: 0,
        image_id: frame as u32,
        tau_px: 1.0,
    };
    let mut labels = AlignedBytes::zeroed(PseudoLabels::byte_len(&header));
    let message = PseudoLabels::write(&mut labels, header);
    let pixels = (VIEWS * AREA) as u32;
    message.info[0] = InstanceLabels {
        object_id: 1,
        usable: u32::from(usable),
        visible_px: pixels,
        voted_px: pixels,
        valid_px: if usable { pixels } else { 0 },
        median_sigma_px: 0.1,
    };
    message.valid.fill(if usable { 255 } else { 0 });
    message.label_px.chunks_exact_mut(2).for_each(|v| v.copy_from_slice(&motion(frame)));

    let mut inputs = InMemory::new(FrameKey { index: frame, stamp_ns: 0 });
    inputs.messages = vec![("views".into(), views), ("flow".into(), flow), ("labels".into(), labels)];
    inputs
}

fn open(config: &TrainerConfig) -> TrainerNode {
    TrainerNode::check(config).unwrap();
    TrainerNode::create(config.clone(), &context()).unwrap()
}

/// Feeds frames; returns the publications that went out.
fn feed(node: &mut TrainerNode, frames: impl IntoIterator<Item = u64>) -> Vec<(u64, usize, usize)> {
    let mut sent = Vec::new();
    for frame in frames {
        let mut out = InMemory::default();
        node.process(&inputs(frame, true), &mut out, &context()).unwrap();
        for (_, bytes) in &out.messages {
            let weights = NetworkWeights::view(bytes).unwrap();
            sent.push((weights.header.version, weights.weights.len(), weights.previous.len()));
        }
    }
    sent
}

fn bytes(config: &TrainerConfig, file: &str) -> Vec<u8> {
    std::fs::read(config.out.join(file)).unwrap()
}

#[test]
fn training_is_a_function_of_its_frames_also_across_a_crash() {
    let (one, two) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (whole, broken) = (config(one.path(), 4), config(two.path(), 4));
    let mut node = open(&whole);
    feed(&mut node, 0..8);
    // Dies in the middle of step 3 and twice of step 2; what is unsafe comes again, and more than that.
    let mut node = open(&broken);
    feed(&mut node, 0..3);
    assert_eq!(node.safe_until(3), 2, "frame 2 waits for its step");
    drop(node);
    let mut node = open(&broken);
    assert_eq!(node.safe_until(2), 2);
    feed(&mut node, 2..5);
    drop(node);
    let mut node = open(&broken);
    feed(&mut node, 4..6);
    // Another node's death repeats frames that this one has.
    feed(&mut node, 4..8);
    assert_eq!(node.safe_until(8), 8);
    // What lies behind the last step is passed over, and nobody waits for it.
    assert!(feed(&mut node, 8..11).is_empty());
    assert_eq!(node.safe_until(11), 11);
    for file in [files::TEACHER, files::STUDENT, files::CHECKPOINT] {
        assert!(bytes(&whole, file) == bytes(&broken, file), "{file} differs");
    }
    let steps = |config: &TrainerConfig| String::from_utf8(bytes(config, files::LOG)).unwrap().lines().count();
    assert_eq!((steps(&whole), steps(&broken)), (5, 5));
}

#[test]
fn a_resumed_run_begins_with_frame_0_and_has_the_same_bits() {
    let (one, two) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (whole, part) = (config(one.path(), 4), config(two.path(), 4));
    feed(&mut open(&whole), 0..8);
    feed(&mut open(&part), 0..5);
    assert_eq!(super::steps_taken(&part.out.join(files::CHECKPOINT), 1).unwrap(), 2);
    let resumed = TrainerConfig { first_step: 2, ..part.clone() };
    let mut node = open(&resumed);
    // The player sends what it would have sent: samples 4 to 7, as frames 0 to 3.
    for frame in 0..4 {
        let mut again = inputs(frame + 4, true);
        again.key = Some(FrameKey { index: frame, stamp_ns: 0 });
        node.process(&again, &mut InMemory::default(), &context()).unwrap();
    }
    assert!(bytes(&whole, files::TEACHER) == bytes(&part, files::TEACHER));
}

#[test]
fn a_step_may_hold_several_updates_and_the_same_bits_across_a_crash() {
    let (one, two) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let thrice = |folder: &Path| TrainerConfig { repeats: 3, ..config(folder, 2) };
    let (whole, broken) = (thrice(one.path()), thrice(two.path()));
    feed(&mut open(&whole), 0..4);
    feed(&mut open(&broken), 0..3);
    assert_eq!(super::steps_taken(&broken.out.join(files::CHECKPOINT), 3).unwrap(), 1);
    feed(&mut open(&broken), 2..4);
    assert!(bytes(&whole, files::TEACHER) == bytes(&broken, files::TEACHER));
    let network = whole.resolve_network().unwrap();
    let updates = |config: &TrainerConfig| Weights::load(&config.out.join(files::STUDENT), &network).unwrap().info.step;
    assert_eq!(updates(&whole), 6);
    // Steps without labels keep the count.
    let empty = tempfile::tempdir().unwrap();
    let config = thrice(empty.path());
    let mut node = open(&config);
    (0..4).for_each(|f| node.process(&inputs(f, false), &mut InMemory::default(), &context()).unwrap());
    assert_eq!(updates(&config), 6);
}

#[test]
fn teachers_are_kept_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let config = TrainerConfig { keep_every: Some(2), ..config(folder.path(), 4) };
    feed(&mut open(&config), 0..8);
    let kept = |step| bytes(&config, &format!("{}/{step:06}.safetensors", files::TEACHERS));
    assert!(kept(4) == bytes(&config, files::TEACHER) && kept(2) != kept(4));
}

#[test]
fn weights_go_out_at_the_start_and_every_so_many_steps_with_those_before() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path(), 4);
    let mut node = open(&config);
    let mut out = InMemory::default();
    node.begin(&mut out, &context()).unwrap();
    let first = NetworkWeights::view(&out.messages[0].1).unwrap();
    assert_eq!((first.header.version, first.previous.len(), first.header.frames_per_version), (0, 0, 4));
    let sent = feed(&mut node, 0..8);
    assert_eq!(sent.iter().map(|s| s.0).collect::<Vec<_>>(), [1, 2]);
    assert!(sent.iter().all(|(_, weights, previous)| *weights > 0 && *previous > 0));
}

#[test]
fn a_step_without_usable_labels_counts_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path(), 2);
    let mut node = open(&config);
    let before = AdaptState::new(&config).unwrap();
    for frame in 0..4 {
        node.process(&inputs(frame, false), &mut InMemory::default(), &context()).unwrap();
    }
    let after = Weights::load(&config.out.join(files::TEACHER), &config.resolve_network().unwrap()).unwrap();
    assert_eq!(before.teacher().tensors(), after.tensors());
    let log = String::from_utf8(bytes(&config, files::LOG)).unwrap();
    assert!(log.lines().nth(1).unwrap().starts_with("1,NaN"), "{log}");
}

#[test]
fn the_loss_falls_and_the_teacher_follows_its_student() {
    let folder = tempfile::tempdir().unwrap();
    let config = TrainerConfig { augment: false, ema_alpha: Some(0.5), ..config(folder.path(), 14) };
    let mut node = open(&config);
    feed(&mut node, 0..28);
    let log = String::from_utf8(bytes(&config, files::LOG)).unwrap();
    let losses: Vec<f64> = log.lines().skip(1).map(|line| line.split(',').nth(1).unwrap().parse().unwrap()).collect();
    let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
    assert!(mean(&losses[10..]) < 0.9 * mean(&losses[..4]), "{losses:?}");
    let network = config.resolve_network().unwrap();
    let load = |file: &str| Weights::load(&config.out.join(file), &network).unwrap();
    let start = Weights::load(&config.weights, &network).unwrap();
    let apart = |a: &Weights, b: &Weights| -> f64 {
        let pairs = a.tensors().iter().zip(b.tensors()).flat_map(|(a, b)| a.data.iter().zip(&b.data));
        pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>().sqrt()
    };
    let (teacher, student) = (load(files::TEACHER), load(files::STUDENT));
    assert!(apart(&teacher, &start) > 0.0 && apart(&teacher, &student) < apart(&start, &student));
}

#[test]
fn the_refiner_learns_from_labels_too_and_resumes_to_the_bit() {
    let refiner = |folder: &Path| {
        let weights = folder.join("refiner.safetensors");
        Weights::random(&FlowNetwork::named("refiner").unwrap(), 3).save(&weights).unwrap();
        TrainerConfig { weights, network: "auto".into(), augment: false, ..config(folder, 8) }
    };
    let (one, two) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (whole, broken) = (refiner(one.path()), refiner(two.path()));
    feed(&mut open(&whole), 0..16);
    feed(&mut open(&broken), 0..7);
    feed(&mut open(&broken), 6..16);
    assert!(bytes(&whole, files::TEACHER) == bytes(&broken, files::TEACHER));
    let log = String::from_utf8(bytes(&whole, files::LOG)).unwrap();
    let losses: Vec<f64> = log.lines().skip(1).map(|line| line.split(',').nth(1).unwrap().parse().unwrap()).collect();
    assert!(losses[7] < losses[0], "{losses:?}");
}

#[test]
fn frames_out_of_turn_and_bad_settings_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path(), 4);
    let mut node = open(&config);
    let error = node.process(&inputs(1, true), &mut InMemory::default(), &context()).unwrap_err().to_string();
    assert!(error.contains("frame 1"), "{error}");
    let error = TrainerNode::check(&TrainerConfig { ema_alpha: Some(1.0), ..config.clone() }).unwrap_err().to_string();
    assert!(error.contains("ema_alpha"), "{error}");
    let error =
        TrainerNode::check(&TrainerConfig { weights: "nowhere".into(), ..config.clone() }).unwrap_err().to_string();
    assert!(error.contains("nowhere"), "{error}");
    // A checkpoint of another schedule.
    feed(&mut open(&config), 0..2);
    let other = TrainerConfig { max_lr: 1e-5, ..config };
    let error = TrainerNode::create(other, &context()).err().unwrap().to_string();
    assert!(error.contains("resume with the same configuration"), "{error}");
}
