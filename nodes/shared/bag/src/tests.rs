use super::*;
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use pseudoflow_msgs::ros::{CompressedImage, Header, PoseStamped, RosMessage, Time};
use std::collections::BTreeMap;
use std::path::PathBuf;

const IMAGES: &str = "/camera/image_raw/compressed";

fn image(frame: u32, bytes: usize) -> CompressedImage {
    let header = Header { stamp: Time { sec: frame as i32, nanosec: 5 }, frame_id: "camera".into() };
    let data = (0..bytes as u32).map(|i| (i.wrapping_mul(2_654_435_761).wrapping_add(frame) >> 13) as u8).collect();
    CompressedImage { header, format: "jpeg".into(), data }
}

fn pose(frame: u32) -> PoseStamped {
    let mut pose = PoseStamped { header: image(frame, 0).header, ..PoseStamped::default() };
    pose.pose.position.x = f64::from(frame);
    pose
}

struct Topics(TopicId, TopicId);

impl Topics {
    fn add(writer: &mut BagWriter) -> Self {
        let images = writer.add_topic::<CompressedImage>(IMAGES, Qos::SENSOR_DATA).unwrap();
        Self(images, writer.add_topic::<PoseStamped>("/object_pose", Qos::RELIABLE).unwrap())
    }

    fn write(&self, writer: &mut BagWriter, frame: u32, bytes: usize) {
        let stamp_ns = image(frame, 0).header.stamp.as_ns();
        writer.write(self.0, stamp_ns, frame, &image(frame, bytes)).unwrap();
        writer.write(self.1, stamp_ns, frame, &pose(frame)).unwrap();
        writer.end_frame().unwrap();
    }
}

fn write_bag(directory: &Path, frames: std::ops::Range<u32>, bytes: usize, packing: Packing) {
    let mut writer = BagWriter::create(directory, packing).unwrap();
    writer.set_custom_data([("scene".to_owned(), "7".to_owned())].into()).unwrap();
    let topics = Topics::add(&mut writer);
    frames.for_each(|frame| topics.write(&mut writer, frame, bytes));
    writer.finish().unwrap();
}

fn image_topic(reader: &BagReader) -> TopicNumber {
    reader.topic(IMAGES, &[CompressedImage::type_name()]).unwrap()
}

fn frames_of(path: &Path) -> Vec<u32> {
    let mut reader = BagReader::open(path).unwrap();
    let topic = image_topic(&reader);
    (0..reader.topics()[topic].count).map(|n| reader.message(topic, n).unwrap().sequence).collect()
}

fn only_file(directory: &Path) -> PathBuf {
    directory.join(format!("{}_0.mcap", bag_name(directory).unwrap()))
}

#[test]
fn any_message_is_read_from_directory_or_file_packed_or_not() {
    for packing in [Packing::None, Packing::Zstd] {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("bag");
        write_bag(&bag, 0..9, 300, packing);
        for path in [bag.clone(), only_file(&bag)] {
            let mut reader = BagReader::open(&path).unwrap();
            let (images, poses) =
                (image_topic(&reader), reader.topic("/object_pose", &[PoseStamped::type_name()]).unwrap());
            for frame in [8, 0, 4, 4, 7] {
                assert_eq!(reader.read::<CompressedImage>(images, frame as usize).unwrap(), image(frame, 300));
                assert_eq!(reader.read::<PoseStamped>(poses, frame as usize).unwrap(), pose(frame));
            }
            assert!(matches!(reader.message(images, 9), Err(BagError::NoMessage { count: 9, .. })));
            assert_eq!(reader.custom_data()["scene"], "7");
            let info = reader.info().unwrap();
            assert_eq!((info.span_ns, info.checksums), (Some((5, 8_000_000_005)), true));
        }
    }
}

#[test]
fn the_same_messages_make_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = ["a/bag", "b/bag"].map(|name| {
        let bag = folder.path().join(name);
        write_bag(&bag, 0..5, 1000, Packing::Zstd);
        (std::fs::read(only_file(&bag)).unwrap(), std::fs::read(bag.join("metadata.yaml")).unwrap())
    });
    assert!(bytes[0] == bytes[1]);
}

#[test]
fn metadata_lists_files_topics_and_counts() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    write_bag(&bag, 2..5, 10, Packing::None);
    let yaml: serde_yaml::Value =
        serde_yaml::from_str(&std::fs::read_to_string(bag.join("metadata.yaml")).unwrap()).unwrap();
    let information = &yaml["rosbag2_bagfile_information"];
    assert_eq!((information["version"].as_u64(), information["message_count"].as_u64()), (Some(9), Some(6)));
    assert_eq!(information["duration"]["nanoseconds"].as_u64(), Some(2_000_000_000));
    assert_eq!(information["relative_file_paths"][0].as_str(), Some("bag_0.mcap"));
    let topic = &information["topics_with_message_count"][0];
    assert_eq!(topic["message_count"].as_u64(), Some(3));
    assert_eq!(topic["topic_metadata"]["offered_qos_profiles"][0]["reliability"].as_str(), Some("best_effort"));
    assert!(topic["topic_metadata"]["type_description_hash"].as_str().unwrap().starts_with("RIHS01_"));
}

#[test]
fn an_existing_bag_is_never_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    write_bag(&bag, 0..1, 10, Packing::None);
    assert!(matches!(BagWriter::create(&bag, Packing::None), Err(BagError::Exists { .. })));
    assert!(matches!(Partial::directory(&bag), Err(BagError::Exists { .. })));
}

/// Every single flipped bit must be noticed: a file of 5 KB has enough kinds of records to stand for all.
#[test]
fn no_flipped_bit_goes_unnoticed() {
    for (packing, step) in [(Packing::None, 1), (Packing::Zstd, 11)] {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("bag");
        write_bag(&bag, 0..1, 40, packing);
        let whole = std::fs::read(only_file(&bag)).unwrap();
        let path = folder.path().join("flipped.mcap");
        for byte in (0..whole.len()).step_by(step) {
            let mut flipped = whole.clone();
            flipped[byte] ^= 1 << (byte % 8);
            std::fs::write(&path, &flipped).unwrap();
            let error = BagReader::open(&path).expect_err(&format!("{packing:?}: byte {byte} of {}", whole.len()));
            assert!(error.to_string().contains("flipped.mcap"), "{error}");
        }
    }
}

#[test]
fn no_truncation_goes_unnoticed_and_each_recovers_the_whole_frames() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    write_bag(&bag, 0..3, 200, Packing::None);
    let whole = std::fs::read(only_file(&bag)).unwrap();
    let path = folder.path().join("cut.mcap");
    let mut kept_before = 0;
    for length in (0..whole.len()).step_by(37) {
        std::fs::write(&path, &whole[..length]).unwrap();
        let error = BagReader::open(&path).unwrap_err();
        assert!(matches!(error, BagError::Truncated { .. } | BagError::Empty { .. }), "{length}: {error}");
        let out = folder.path().join(format!("kept_{length}"));
        let kept = match recover(&RecoverOptions { bag: path.clone(), out: Some(out.clone()) }) {
            Ok(recovered) => {
                assert_eq!((frames_of(&out).len() as u64, recovered.damages.len()), (recovered.messages[IMAGES], 1));
                assert_eq!(recovered.messages[IMAGES], recovered.messages["/object_pose"], "half a frame was kept");
                assert_eq!(BagReader::open(&out).unwrap().custom_data()["scene"], "7");
                recovered.messages[IMAGES]
            }
            Err(error) => {
                assert!(!out.exists(), "{error}");
                0
            }
        };
        assert!(kept >= kept_before);
        kept_before = kept;
    }
    assert_eq!(kept_before, 3);
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert!(left.iter().all(|name| !name.to_string_lossy().contains("partial")), "{left:?}");
}

#[test]
fn a_damaged_chunk_costs_its_own_frame_alone() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    write_bag(&bag, 0..5, 400, Packing::None);
    let mut bytes = std::fs::read(only_file(&bag)).unwrap();
    let image_bytes = image(2, 400).data;
    let at = bytes.windows(400).position(|window| window == image_bytes).unwrap();
    bytes[at + 100] ^= 0x40;
    std::fs::write(only_file(&bag), bytes).unwrap();
    assert!(matches!(BagReader::open(&bag), Err(BagError::Damaged { .. })));
    let recovered = recover(&RecoverOptions { bag: bag.clone(), out: None }).unwrap();
    assert_eq!(frames_of(&recovered.directory), [0, 1, 3, 4]);
    assert!(recovered.damages[0].contains("checksum"), "{:?}", recovered.damages);
}

#[test]
fn what_is_no_bag_is_named_for_what_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let said = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        BagReader::open(&path).unwrap_err().to_string()
    };
    assert!(said("a.mcap", b"").contains("empty"));
    assert!(said("b.mcap", b"SQLite format 3\0").contains("ros2 bag convert"));
    assert!(said("c.mcap", b"#ROSBAG V2.0\n").contains("ROS 1"));
    assert!(said("d.mcap", b"\xff\xd8\xff\xe0 a picture").contains("no recording"));
    let empty = folder.path().join("empty");
    std::fs::create_dir(&empty).unwrap();
    assert!(BagReader::open(&empty).unwrap_err().to_string().contains(".mcap"));
    assert!(matches!(BagReader::open(&folder.path().join("none")), Err(BagError::Io { .. })));
    let bytes = {
        let mut writer = mcap::WriteOptions::new().profile("ros1").create(std::io::Cursor::new(Vec::new())).unwrap();
        writer.finish().unwrap();
        writer.into_inner().into_inner()
    };
    assert!(said("e.mcap", &bytes).contains("`ros1`"));
}

#[test]
fn wrong_metadata_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    write_bag(&bag, 0..1, 10, Packing::None);
    let path = bag.join("metadata.yaml");
    let yaml = std::fs::read_to_string(&path).unwrap();
    let said = |from: &str, to: &str| {
        assert!(yaml.contains(from));
        std::fs::write(&path, yaml.replace(from, to)).unwrap();
        BagReader::open(&bag).unwrap_err().to_string()
    };
    assert!(said("storage_identifier: mcap", "storage_identifier: sqlite3").contains("sqlite3"));
    assert!(said("version: 9", "version: 77").contains("77"));
    assert!(said("- bag_0.mcap", "- other.mcap").contains("other.mcap"));
    assert!(said("compression_mode: ''", "compression_mode: file").contains("compression_mode"));
    assert!(said("rosbag2_bagfile_information:", "nothing:").contains("rosbag2_bagfile_information"));
    std::fs::remove_file(&path).unwrap();
    assert_eq!(frames_of(&bag), [0]);
}

#[test]
fn wrong_topics_are_named_with_those_there_are() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    write_bag(&bag, 0..1, 10, Packing::None);
    let reader = BagReader::open(&bag).unwrap();
    let unknown = reader.topic("/nothing", &[]).unwrap_err().to_string();
    assert!(unknown.contains("/nothing") && unknown.contains(IMAGES), "{unknown}");
    let other = reader.topic(IMAGES, &[PoseStamped::type_name()]).unwrap_err().to_string();
    assert!(other.contains("CompressedImage") && other.contains("PoseStamped"), "{other}");
}

#[test]
fn a_killed_writer_is_taken_up_without_a_frame_lost_or_doubled() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = BagWriter::create(&bag, Packing::None).unwrap();
    let topics = Topics::add(&mut writer);
    (0..4).for_each(|frame| topics.write(&mut writer, frame, 100));
    // kill -9 in the middle of a frame: what is in the process is gone, what is in the file stays.
    writer.write(topics.0, 1, 4, &image(4, 100)).unwrap();
    std::mem::forget(writer);
    let mut cut = std::fs::read(only_file(&bag)).unwrap();
    cut.extend_from_slice(&[6, 200, 0, 0]); // the beginning of a chunk
    std::fs::write(only_file(&bag), cut).unwrap();

    let (mut writer, resumed) = BagWriter::resume(&bag, Packing::None).unwrap();
    assert_eq!((resumed.next_sequence, resumed.messages, resumed.mended.len()), (4, 8, 1));
    let topics = Topics::add(&mut writer);
    (4..7).for_each(|frame| topics.write(&mut writer, frame, 100));
    writer.finish().unwrap();
    assert_eq!(frames_of(&bag), [0, 1, 2, 3, 4, 5, 6]);
    assert!(bag.join("bag_1.mcap").is_file());
    let yaml = std::fs::read_to_string(bag.join("metadata.yaml")).unwrap();
    assert!(yaml.contains("message_count: 14"), "{yaml}");
}

#[test]
fn a_frame_that_did_not_end_is_not_in_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = BagWriter::create(&bag, Packing::None).unwrap();
    let topics = Topics::add(&mut writer);
    topics.write(&mut writer, 0, 10);
    writer.write(topics.0, 1, 1, &image(1, 10)).unwrap();
    drop(writer); // an error in the middle of the frame
    assert_eq!(BagWriter::resume(&bag, Packing::None).unwrap().1.next_sequence, 1);
}

#[test]
fn a_writer_killed_before_its_first_frame_is_taken_up_too() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    std::mem::forget(BagWriter::create(&bag, Packing::None).unwrap());
    let (mut writer, resumed) = BagWriter::resume(&bag, Packing::None).unwrap();
    assert_eq!(resumed.messages, 0);
    Topics::add(&mut writer).write(&mut writer, 0, 10);
    writer.finish().unwrap();
    assert_eq!(frames_of(&bag), [0]);
}

#[test]
fn split_files_are_one_bag() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = BagWriter::create(&bag, Packing::Zstd).unwrap();
    let topics = Topics::add(&mut writer);
    for frame in 0..12 {
        topics.write(&mut writer, frame, 10);
        writer.split().unwrap();
    }
    writer.finish().unwrap();
    assert_eq!(frames_of(&bag), (0..12).collect::<Vec<_>>());
}

#[test]
fn a_visitor_sees_every_message_and_can_refuse_one() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    write_bag(&bag, 0..3, 10, Packing::None);
    let mut seen = BTreeMap::<String, usize>::new();
    BagReader::open_visiting(&bag, &mut |visited| {
        *seen.entry(visited.topic.name.clone()).or_default() += 1;
        Ok(())
    })
    .unwrap();
    assert_eq!(seen, [(IMAGES.to_owned(), 3), ("/object_pose".to_owned(), 3)].into());
    let refused = BagReader::open_visiting(&bag, &mut |visited| match visited.number {
        2 => Err("it is the third".into()),
        _ => Ok(()),
    });
    assert!(refused.unwrap_err().to_string().contains("message 2: it is the third"));
}

#[test]
fn random_bytes_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    write_bag(&bag, 0..1, 20, Packing::None);
    let whole = std::fs::read(only_file(&bag)).unwrap();
    let path = folder.path().join("noise.mcap");
    let bytes = (proptest::collection::vec(any::<u8>(), 0..400), 0..whole.len());
    TestRunner::new(ProptestConfig::with_cases(500))
        .run(&bytes, |(noise, keep)| {
            std::fs::write(&path, [&whole[..keep], &noise].concat()).unwrap();
            prop_assert!(BagReader::open(&path).is_err());
            let salvaged = super::recover::salvage(&path, &folder.path().join("salvaged"));
            if salvaged.is_ok() {
                std::fs::remove_file(folder.path().join("salvaged")).unwrap();
            }
            Ok(())
        })
        .unwrap();
}
