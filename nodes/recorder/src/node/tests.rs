use super::*;
use pseudoflow_bag::BagReader;
use pseudoflow_msgs::{AlignedBytes, CameraFrameHeader, FrameKey, Message as _};
use pseudoflow_runtime::{BadInput, InMemory};

fn frame(index: u64) -> InMemory {
    let key = FrameKey { index, stamp_ns: 1_000_000_000 + 33_000_000 * index as i64 };
    let mut inputs = InMemory::new(key);
    let mut bytes = AlignedBytes::zeroed(CameraFrame::byte_len(16, 8));
    let header = CameraFrameHeader {
        width: 16,
        height: 8,
        scene_id: 0,
        image_id: index as u32,
        intrinsics: [20.0, 20.0, 8.0, 4.0],
        frame_id: CameraFrameHeader::frame_id_bytes("camera_optical").unwrap(),
    };
    CameraFrame::write(&mut bytes, header).rgb.fill(100);
    inputs.messages.push(("frame".into(), bytes));
    let mut bytes = AlignedBytes::zeroed(ObjectPoses::byte_len(0));
    ObjectPoses::write(&mut bytes, 0, index as u32, &[]);
    inputs.messages.push(("poses".into(), bytes));
    inputs
}

fn context(folder: &std::path::Path, restarts: u32) -> Context {
    Context { name: "recorder".into(), seed: 1, out_dir: folder.to_owned(), restarts, replay: true }
}

fn recorder(folder: &std::path::Path, restarts: u32) -> RecorderNode {
    RecorderNode::create(RecorderConfig::new(folder.join("run")), &context(folder, restarts)).unwrap()
}

#[test]
fn a_killed_recorder_loses_and_doubles_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut sink = InMemory::default();
    let first_life = context(folder.path(), 0);
    let mut node = recorder(folder.path(), 0);
    for index in 0..3 {
        node.process(&frame(index), &mut sink, &first_life).unwrap();
    }
    std::mem::forget(node); // killed: nothing is flushed or closed
    let mut node = recorder(folder.path(), 1);
    for index in 2..5 {
        node.process(&frame(index), &mut sink, &first_life).unwrap();
    }
    node.finish(&first_life).unwrap();
    let info = BagReader::open(&folder.path().join("run")).unwrap().info().unwrap();
    let images = info.topics.iter().find(|t| t.name == "/camera/image/compressed").unwrap();
    assert_eq!(images.count, 5);
}

#[test]
fn pictures_become_topics_and_poses_are_no_must() {
    let folder = tempfile::tempdir().unwrap();
    let context = context(folder.path(), 0);
    let path = folder.path().join("run");
    let config = RecorderConfig { images: false, period_ms: Some(100), ..RecorderConfig::new(path) };
    let mut node = RecorderNode::create(config, &context).unwrap();
    // As in a training: the later frame was taken first.
    for (index, stamp_ns) in [(0, 9_000_000_000), (1, 2_000_000_000)] {
        let mut inputs = frame(index);
        inputs.key = Some(FrameKey { index, stamp_ns });
        inputs.messages.retain(|(port, _)| port != "poses");
        let pictures = [("labels/sigma", vec![1, 2, 3]), ("labels/flow", vec![4])];
        let mut bytes = AlignedBytes::zeroed(Pictures::byte_len(&pictures));
        Pictures::write(&mut bytes, &pictures);
        inputs.messages.push(("pictures".into(), bytes));
        node.process(&inputs, &mut InMemory::default(), &context).unwrap();
    }
    node.finish(&context).unwrap();
    let info = BagReader::open(&folder.path().join("run")).unwrap().info().unwrap();
    let topics: Vec<_> = info.topics.iter().map(|t| (t.name.as_str(), t.count)).collect();
    assert_eq!(topics, [("/labels/sigma/compressed", 2), ("/labels/flow/compressed", 2)]);
}

fn live(folder: &std::path::Path) -> Context {
    Context { replay: false, ..context(folder, 0) }
}

fn images_in(path: &std::path::Path) -> usize {
    let info = BagReader::open(path).unwrap().info().unwrap();
    info.topics.iter().find(|t| t.name == "/camera/image/compressed").map_or(0, |topic| topic.count)
}

/// A bridge counts from 2^32 on after its first restart.
#[test]
fn a_live_source_may_begin_with_any_number() {
    let folder = tempfile::tempdir().unwrap();
    let mut node = recorder(folder.path(), 0);
    for index in [7, 8, 1 << 32, (1 << 32) + 1, 3 << 32] {
        let mut inputs = frame(7);
        inputs.key = Some(FrameKey { index, stamp_ns: 5 });
        node.process(&inputs, &mut InMemory::default(), &live(folder.path())).unwrap();
    }
    node.finish(&live(folder.path())).unwrap();
    assert_eq!(images_in(&folder.path().join("run")), 5);
}

#[test]
fn a_bad_frame_is_said_to_be_one_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut node = recorder(folder.path(), 0);
    let context = live(folder.path());
    let mut process = |inputs: &InMemory| node.process(inputs, &mut InMemory::default(), &context);
    process(&frame(0)).unwrap();
    let mut before_the_epoch = frame(1);
    before_the_epoch.key = Some(FrameKey { index: 1, stamp_ns: -1 });
    let mut without_pixels = frame(2);
    let mut bytes = AlignedBytes::zeroed(CameraFrame::byte_len(0, 0));
    let mut header = *CameraFrame::view(&without_pixels.messages[0].1).unwrap().header;
    (header.width, header.height) = (0, 0);
    CameraFrame::write(&mut bytes, header);
    without_pixels.messages[0].1 = bytes;
    let mut cut_off = frame(3);
    cut_off.messages[0].1 = AlignedBytes::zeroed(8);
    for bad in [before_the_epoch, without_pixels, cut_off] {
        let error = process(&bad).unwrap_err();
        assert_eq!(error.downcast_ref::<BadInput>().map(|bad| bad.port), Some("frame"), "{error}");
    }
    process(&frame(4)).unwrap();
    node.finish(&context).unwrap();
    assert_eq!(images_in(&folder.path().join("run")), 2);
}

#[test]
fn a_long_recording_is_several_files_for_their_owner_alone() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run");
    let config = RecorderConfig { max_bytes: Some(1500), ..RecorderConfig::new(path.clone()) };
    let context = context(folder.path(), 0);
    let mut node = RecorderNode::create(config, &context).unwrap();
    (0..20).for_each(|index| node.process(&frame(index), &mut InMemory::default(), &context).unwrap());
    node.finish(&context).unwrap();
    assert_eq!(images_in(&path), 20);
    let files: Vec<_> = std::fs::read_dir(&path).unwrap().map(|file| file.unwrap()).collect();
    assert!(files.len() > 3, "{files:?}");
    let rights = |path: &std::path::Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
    assert!(files.iter().all(|file| rights(&file.path()) == 0o600) && rights(&path) == 0o700);
}

#[test]
fn a_recording_is_never_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let mut node = recorder(folder.path(), 0);
    node.process(&frame(0), &mut InMemory::default(), &context(folder.path(), 0)).unwrap();
    node.finish(&context(folder.path(), 0)).unwrap();
    let config = RecorderConfig::new(folder.path().join("run"));
    assert!(RecorderNode::create(config, &context(folder.path(), 0)).is_err());
}

#[test]
fn without_a_frame_nothing_is_left_behind() {
    let folder = tempfile::tempdir().unwrap();
    recorder(folder.path(), 0).finish(&context(folder.path(), 0)).unwrap();
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn the_same_frames_make_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let recorded = ["a", "b"].map(|name| {
        let life = context(&folder.path().join(name), 0);
        let mut node = recorder(&life.out_dir, 0);
        (0..3).for_each(|index| node.process(&frame(index), &mut InMemory::default(), &life).unwrap());
        node.finish(&life).unwrap();
        std::fs::read(life.out_dir.join("run/run_0.mcap")).unwrap()
    });
    assert!(recorded[0] == recorded[1]);
}
