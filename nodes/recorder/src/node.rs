#[cfg(test)]
mod tests;

use crate::following::Following;
use crate::overlay::{OverlayConfig, Painter};
use crate::topics::{Extras, FrameWriter, Topics, jpeg};
use pseudoflow_bag::{BagError, BagWriter, Packing};
use pseudoflow_edge::Catalogue;
use pseudoflow_geometry::Intrinsics;
use pseudoflow_imaging::{ObjectSet, RgbImage};
use pseudoflow_msgs::ros::{Header, Naming, Time};
use pseudoflow_msgs::{CameraFrame, ObjectPose, ObjectPoses, ObjectStatuses, Pictures};
use pseudoflow_runtime::{Context, Inputs, Node, NodeError, OrBadInput, Outputs, Port, PortSpec, Role};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::{Path, PathBuf};

const FRAME: Port<CameraFrame<'static>> = Port::required("frame");
const POSES: Port<ObjectPoses<'static>> = Port::optional("poses");
const INITIAL_POSES: Port<ObjectPoses<'static>> = Port::optional("initial_poses");
const PICTURES: Port<Pictures<'static>> = Port::optional("pictures");
const STATUS: Port<ObjectStatuses<'static>> = Port::optional("status");

/// Settings of the recorder node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RecorderConfig {
    /// Folder of the recording; must not exist yet.
    pub path: PathBuf,
    /// Whether the frames themselves are recorded.
    #[serde(default = "yes")]
    pub images: bool,
    /// Quality of the JPEGs, 1 to 100.
    #[serde(default = "default_quality")]
    pub jpeg_quality: u8,
    /// Draws contours on the frames; none without.
    #[serde(default)]
    pub overlay: Option<OverlayConfig>,
    /// Lays the frames so many milliseconds apart in the recording, in the order in which they come, instead of at their
    /// stamps: a training takes its frames in an order of its own, and more than once.
    #[serde(default)]
    pub period_ms: Option<u32>,
    /// Folder of the object set, for the names of objects; without, that of the overlay.
    #[serde(default)]
    pub objects: Option<PathBuf>,
    /// The object of `/object_pose`, by name or id; without, the first that is found, until it is lost.
    #[serde(default)]
    pub object: Option<String>,
    /// How long the object of `/object_pose` may be lost before another takes its place, seconds.
    #[serde(default = "default_switch_after_s")]
    pub switch_after_s: f64,
    /// Goes on in a new file of the recording when one has so many bytes of messages, at least a million, or 100,000 frames
    /// (what a file's index takes in memory until it is closed grows with them); without: 4 GiB.
    #[serde(default)]
    pub max_bytes: Option<u64>,
}

/// Of a file when the configuration gives none.
const MAX_BYTES: u64 = 4 << 30;
const MAX_FRAMES: u64 = 100_000;

impl RecorderConfig {
    /// Records all that comes, without overlay.
    #[must_use]
    pub fn new(path: PathBuf) -> Self {
        Self {
            path,
            images: true,
            jpeg_quality: default_quality(),
            overlay: None,
            period_ms: None,
            objects: None,
            object: None,
            switch_after_s: default_switch_after_s(),
            max_bytes: None,
        }
    }

    /// The object set whose names are written.
    fn object_set(&self) -> Option<&Path> {
        self.objects.as_deref().or(self.overlay.as_ref().map(|overlay| overlay.objects.as_path()))
    }
}

fn yes() -> bool {
    true
}

fn default_switch_after_s() -> f64 {
    5.0
}

fn default_quality() -> u8 {
    90
}

/// Writes each frame as one chunk: it is in the recording whole or not at all, before it is acknowledged. A restarted
/// recorder mends what its predecessor left and goes on in the next file of the same recording.
pub struct RecorderNode {
    config: RecorderConfig,
    /// From the first frame on: a run that fails before it leaves nothing behind.
    open: Option<(BagWriter, Topics)>,
    /// What a predecessor left, until the first frame of this life.
    resumed: Option<BagWriter>,
    /// Below it every frame is recorded: frames of a replay come in order, those of a live graph are counted here.
    next: u32,
    painter: Option<Painter>,
    naming: Naming,
    followed: Following,
}

impl RecorderNode {
    fn record(&mut self, inputs: &dyn Inputs, sequence: u32) -> Result<(), NodeError> {
        let frame = FRAME.read(inputs)?;
        let initial = INITIAL_POSES.given(inputs)?;
        let initial = initial.map(|message| message.poses);
        let likeliest: Vec<ObjectPose> = ObjectPose::likeliest(initial.unwrap_or_default()).copied().collect();
        let poses = POSES.given(inputs)?.map(|message| message.poses);
        let statuses = STATUS.given(inputs)?.map(|message| message.statuses);
        let shown = PICTURES.given(inputs)?;
        let period_ns = self.config.period_ms.map(|ms| i64::from(ms) * 1_000_000);
        let stamp_ns = period_ns.map_or(inputs.key().stamp_ns, |ns| ns * i64::from(sequence));
        let stamp = Time::from_ns(stamp_ns).filter(|_| stamp_ns >= 0);
        let stamp = stamp.ok_or_else(|| format!("stamp {stamp_ns} ns does not fit into ROS time and a recording"));
        let stamp = stamp.or_bad_input(FRAME.name())?;
        let header = Header { stamp, frame_id: frame.header.frame_id().to_owned() };
        let image = RgbImage::from_raw(frame.header.width, frame.header.height, frame.rgb.to_vec());
        let image = image.filter(|image| image.width() > 0 && image.height() > 0);
        let image = image.ok_or("the frame has too few pixels").or_bad_input(FRAME.name())?;
        let overlay = self.overlay(image.clone(), &frame, &likeliest, poses.unwrap_or_default())?;
        let followed = poses.map(|poses| self.followed.choose(inputs.key().stamp_ns, poses)).transpose()?.flatten();
        let naming = self.naming.clone();
        let jpeg_quality = self.config.jpeg_quality;
        let pictures = self.config.overlay.as_ref().and_then(|overlay| overlay.pictures.clone());
        let extras = Extras {
            images: self.config.images,
            initial_poses: initial.is_some(),
            poses: poses.is_some(),
            overlay: overlay.is_some(),
            statuses: statuses.is_some(),
        };
        let max_bytes = self.config.max_bytes.unwrap_or(MAX_BYTES);
        let (bag, topics) = self.open(extras)?;
        let mut writer = FrameWriter { bag, topics, naming: &naming, header, stamp_ns, sequence };
        if extras.images {
            writer.image(jpeg(&image, jpeg_quality).or_bad_input(FRAME.name())?, frame.header)?;
        }
        if let Some(initial) = initial {
            writer.initial_poses(initial)?;
        }
        if let Some(poses) = poses {
            writer.poses(poses, followed)?;
        }
        if let Some(statuses) = statuses {
            writer.statuses(statuses)?;
        }
        for (name, bytes) in shown.iter().flat_map(|shown| &shown.pictures) {
            writer.picture(name, bytes.to_vec())?;
        }
        let overlay = overlay.map(|overlay| jpeg(&overlay, jpeg_quality)).transpose()?;
        if let Some(bytes) = overlay {
            // Before the frame counts as recorded: a frame that comes again draws its picture again.
            pictures.map_or(Ok(()), |folder| picture(&folder, sequence, &bytes))?;
            writer.overlay(bytes)?;
        }
        bag.end_frame()?;
        let (bytes, frames) = bag.current_file();
        if bytes >= max_bytes || frames >= MAX_FRAMES {
            bag.split()?;
        }
        Ok(())
    }

    /// What the frame is called in the recording; `None` when it is in there.
    fn sequence(&self, index: u64, replay: bool) -> Result<Option<u32>, NodeError> {
        if !replay {
            // A live source goes on with other numbers after its death, and none of its frames comes twice.
            return Ok(Some(self.next));
        }
        let sequence = u32::try_from(index).map_err(|_| "a recording holds 2^32 frames at most")?;
        Ok((sequence >= self.next).then_some(sequence))
    }

    /// The bag, made or taken up when the first frame comes.
    fn open(&mut self, extras: Extras) -> Result<(&mut BagWriter, &mut Topics), NodeError> {
        if self.open.is_none() {
            let mut bag = match self.resumed.take() {
                Some(bag) => bag,
                None => BagWriter::create(&self.config.path, Packing::default())?,
            };
            let topics = Topics::add_to(&mut bag, extras)?;
            self.open = Some((bag, topics));
        }
        let (bag, topics) = self.open.as_mut().ok_or("the recording is closed")?;
        Ok((bag, topics))
    }

    fn overlay(
        &self,
        mut image: RgbImage,
        frame: &CameraFrame<'_>,
        initial: &[ObjectPose],
        poses: &[ObjectPose],
    ) -> Result<Option<RgbImage>, NodeError> {
        let Some(painter) = &self.painter else { return Ok(None) };
        let [fx, fy, cx, cy] = frame.header.intrinsics;
        painter.paint(&mut image, &Intrinsics { fx, fy, cx, cy }, initial, poses).or_bad_input(POSES.name())?;
        Ok(Some(image))
    }
}

/// Writes the picture of a frame beside its place and renames it.
fn picture(folder: &Path, sequence: u32, jpeg: &[u8]) -> Result<(), NodeError> {
    pseudoflow_files::private_folder(folder)?;
    let path = folder.join(format!("{sequence:06}.jpg"));
    let beside = path.with_extension("part");
    let _ = std::fs::remove_file(&beside); // of a recorder that was killed here
    pseudoflow_files::create_private(&beside)?.write_all(jpeg)?;
    Ok(std::fs::rename(&beside, &path)?)
}

impl Node for RecorderNode {
    const KIND: &'static str = "recorder";
    const ROLE: Role = Role::Sink;
    const KEEPS: bool = true;
    type Config = RecorderConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![FRAME.spec(), POSES.spec(), INITIAL_POSES.spec(), PICTURES.spec(), STATUS.spec()]
    }

    fn outputs() -> Vec<PortSpec> {
        Vec::new()
    }

    fn check(config: &RecorderConfig) -> Result<(), NodeError> {
        if !(1..=100).contains(&config.jpeg_quality) {
            return Err(format!("`jpeg_quality: {}`: give 1..=100", config.jpeg_quality).into());
        }
        if let Some(OverlayConfig { objects, .. }) = &config.overlay {
            ObjectSet::check(objects)?;
        }
        if !(config.switch_after_s >= 0.0 && config.switch_after_s.is_finite()) {
            return Err(format!("`switch_after_s: {}`: give seconds from 0 on", config.switch_after_s).into());
        }
        if config.max_bytes.is_some_and(|bytes| bytes < 1_000_000) {
            return Err("`max_bytes`: give at least 1000000, or leave it out".into());
        }
        if config.path.file_name().is_none() {
            return Err(format!("`path: {}`: give the folder that the recording will be", config.path.display()).into());
        }
        Ok(())
    }

    fn create(config: RecorderConfig, context: &Context) -> Result<Self, NodeError> {
        let painter = config.overlay.as_ref().map(Painter::open).transpose()?;
        let naming = Catalogue::load_if(config.object_set())?.naming;
        let followed = Following::open(&config, &naming, context)?;
        let mut node = Self { config, open: None, resumed: None, next: 0, painter, naming, followed };
        let path = &node.config.path;
        if context.restarts == 0 && path.exists() {
            return Err(BagError::Exists { path: path.clone() }.into());
        }
        if path.exists() {
            let (bag, resumed) = BagWriter::resume(path, Packing::default())?;
            log::info!("{}: goes on after {} recorded frames", path.display(), resumed.next_sequence);
            resumed.mended.iter().for_each(|damage| log::warn!("mended: {damage}"));
            (node.next, node.resumed) = (resumed.next_sequence, Some(bag));
        }
        Ok(node)
    }

    fn process(&mut self, inputs: &dyn Inputs, _: &mut dyn Outputs, context: &Context) -> Result<(), NodeError> {
        let Some(sequence) = self.sequence(inputs.key().index, context.replay)? else { return Ok(()) };
        if let Err(error) = self.record(inputs, sequence) {
            // Of a bad frame nothing is recorded.
            self.open.iter_mut().for_each(|(bag, _)| bag.abandon_frame());
            return Err(error);
        }
        self.next = sequence.checked_add(1).ok_or("a recording holds 2^32 frames at most")?;
        Ok(())
    }

    fn finish(&mut self, _: &Context) -> Result<(), NodeError> {
        match self.open.take().map(|(bag, _)| bag).or(self.resumed.take()) {
            Some(bag) => Ok(bag.finish()?),
            None => {
                log::warn!("{}: no frame came, so nothing was recorded", self.config.path.display());
                Ok(())
            }
        }
    }
}
