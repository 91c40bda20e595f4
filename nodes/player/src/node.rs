use crate::open::{is_bop_scene, is_bop_split, open_all};
use crate::poses_file::{PosesFile, is_result_file};
use crate::sampling::{Sample, Sampler, Sampling};
use crate::source::FrameFacts;
use crate::{FrameSource, LoadedFrame, PlayerConfig, PlayerError};
use pseudoflow_edge::camera::read_calibration;
use pseudoflow_edge::naming_of;
use pseudoflow_imaging::ObjectSet;
use pseudoflow_msgs::{
    CameraFrame, FrameKey, ObjectPose, ObjectPoses, PartnerFrame, PartnerFrames, PartnerFramesHeader, Rectangles,
};
use pseudoflow_runtime::{
    Context, Inputs, Node, NodeError, OrBadInput, Outputs, Port, PortSpec, Produced, Role, Stride,
};
use std::collections::BTreeMap;
use std::path::PathBuf;

const FRAME: Port<CameraFrame<'static>> = Port::required("frame");
const INITIAL_POSES: Port<ObjectPoses<'static>> = Port::required("initial_poses");
const PARTNERS: Port<PartnerFrames<'static>> = Port::optional("partners");
const RECTANGLES: Port<Rectangles<'static>> = Port::optional("rectangles");

/// Plays a recording: camera frames and initial poses, any frame again when asked.
pub struct PlayerNode {
    config: PlayerConfig,
    source: Box<dyn FrameSource>,
    /// Of `initial_poses.file`.
    poses: Option<PosesFile>,
    sampler: Sampler,
}

/// Objects are known by id: those asked for, and those of all initial poses that will be sent.
fn check_objects(config: &PlayerConfig, objects: &BTreeMap<u32, usize>, known: &[u32]) -> Result<(), PlayerError> {
    let wanted = config.only_objects.as_deref();
    let unknown = |id: &u32| !known.contains(id);
    if let Some(object_id) = wanted.unwrap_or_default().iter().copied().find(unknown) {
        let objects = config.objects.clone().unwrap_or_default();
        return Err(PlayerError::UnknownWanted { object_id, objects, known: known.to_vec() });
    }
    match objects.iter().find(|(id, _)| unknown(id) && wanted.is_none_or(|wanted| wanted.contains(id))) {
        Some((object_id, number)) => Err(PlayerError::UnknownObject {
            path: config.initial_poses.file.clone().unwrap_or_else(|| config.source.clone()),
            number: *number,
            object_id: *object_id,
            known: known.to_vec(),
        }),
        None => Ok(()),
    }
}

impl PlayerNode {
    fn load(&mut self, number: usize) -> Result<LoadedFrame, PlayerError> {
        let mut frame = self.source.load(number)?;
        self.choose_poses(frame.header.scene_id, frame.header.image_id, &mut frame.initial_poses);
        Ok(frame)
    }

    fn facts(&mut self, number: usize) -> Result<FrameFacts, PlayerError> {
        let mut facts = self.source.facts(number)?;
        self.choose_poses(facts.scene_id, facts.image_id, &mut facts.initial_poses);
        Ok(facts)
    }

    /// The poses of the file where there is one, and only those of wanted objects.
    fn choose_poses(&self, scene_id: u32, image_id: u32, initial_poses: &mut Vec<ObjectPose>) {
        if let Some(poses) = &self.poses {
            *initial_poses = poses.of(scene_id, image_id);
        }
        if let Some(wanted) = &self.config.only_objects {
            initial_poses.retain(|pose| wanted.contains(&pose.object_id));
        }
    }

    fn prepare_sampling(&mut self, sampling: &Sampling, context: &Context) -> Result<(), PlayerError> {
        let frames: Vec<FrameFacts> =
            (0..self.source.count()).map(|number| self.facts(number)).collect::<Result<_, _>>()?;
        self.sampler = Sampler::new(&frames, sampling, &mut context.rng(0, "budget"));
        if self.sampler.is_empty() {
            return Err(PlayerError::NothingToSample { path: self.config.source.clone(), frames: frames.len() });
        }
        log::info!("{} samples in {} frames", self.sampler.len(), frames.len());
        Ok(())
    }

    /// The next frame of a training: its number, and the sample that was drawn; `None` behind the last.
    fn draw(&mut self, index: u64, context: &Context) -> Option<(usize, Option<Sample>)> {
        let Some(sampling) = &self.config.sampling else {
            let number = self.config.number_at(index, self.source.count() as u64);
            return number.map(|number| (number as usize, None));
        };
        let sample = self.sampler.at(sampling.first + index, |epoch| context.rng(epoch, "epoch"));
        (index < sampling.samples).then_some((sample.frame, Some(sample)))
    }

    fn send_partners(
        &mut self,
        sample: &Sample,
        key: FrameKey,
        outputs: &mut dyn Outputs,
        context: &Context,
    ) -> Result<(), NodeError> {
        let Some(sampling) = self.config.sampling.clone() else { return Ok(()) };
        let mut rng = context.rng(sampling.first + key.index, "partners");
        let angle_rad = f64::from(sampling.partner_angle_deg).to_radians();
        let drawn = self.sampler.partners(sample, sampling.partners, angle_rad, &mut rng);
        let loaded = drawn.iter().map(|partner| Ok((self.load(partner.frame)?, partner.pose)));
        let loaded: Vec<(LoadedFrame, usize)> = loaded.collect::<Result<_, PlayerError>>()?;
        let mut partners: Vec<PartnerFrame> = loaded.iter().map(|(frame, pose)| partner(frame, *pose)).collect();
        partners.resize(sampling.partners as usize, bytemuck::Zeroable::zeroed());
        let header = PartnerFramesHeader { instances: 1, partners_per_instance: sampling.partners };
        PARTNERS.send(outputs, key, PartnerFrames::byte_len(&partners), &mut |bytes| {
            for (out, (frame, _)) in PartnerFrames::write(bytes, header, &partners).zip(&loaded) {
                out.copy_from_slice(&frame.rgb);
            }
        })
    }
}

fn partner(frame: &LoadedFrame, pose: usize) -> PartnerFrame {
    let header = &frame.header;
    PartnerFrame {
        pose: frame.initial_poses[pose],
        intrinsics: header.intrinsics,
        scene_id: header.scene_id,
        image_id: header.image_id,
        width: header.width,
        height: header.height,
    }
}

impl Node for PlayerNode {
    const KIND: &'static str = "player";
    const ROLE: Role = Role::ReplaySource;
    type Config = PlayerConfig;

    fn inputs() -> Vec<PortSpec> {
        Vec::new()
    }

    fn outputs() -> Vec<PortSpec> {
        vec![FRAME.spec(), INITIAL_POSES.spec(), PARTNERS.spec(), RECTANGLES.spec()]
    }

    fn check(config: &PlayerConfig) -> Result<(), NodeError> {
        if let Some(path) = std::iter::once(&config.source).chain(&config.also).find(|path| !path.exists()) {
            return Err(PlayerError::NoRecording(path.clone()).into());
        }
        if !config.also.is_empty() && config.initial_poses.file.as_deref().is_some_and(|file| !is_result_file(file)) {
            let text = "`initial_poses.file`: image ids of several recordings cannot be told apart: give a BOP result \
                        file (.csv), or leave out `also`";
            return Err(text.into());
        }
        if config.sampling.as_ref().is_some_and(|s| s.held_out_every.is_some_and(|every| every < 2)) {
            return Err("`sampling.held_out_every`: give at least 2, or leave it out".into());
        }
        if config.initial_poses.topic.is_some() && config.initial_poses.file.is_some() {
            return Err("`initial_poses`: both `topic` and `file` are given: leave one out".into());
        }
        let is_bop = |path: &PathBuf| is_bop_scene(path) || is_bop_split(path);
        if config.targets.is_some() && !std::iter::once(&config.source).chain(&config.also).all(is_bop) {
            return Err("`targets`: only BOP scenes have images that a target list can name: leave it out".into());
        }
        if config.targets.as_ref().is_some_and(|path| !path.is_file()) {
            return Err("`targets`: no such file: name a BOP target list, or leave it out".into());
        }
        if config.initial_poses.topic.is_some() && is_bop(&config.source) {
            return Err("`initial_poses.topic`: a BOP scene has no topics: leave it out, or give `file`".into());
        }
        if config.hz.is_some_and(|hz| !(0.01..=1000.0).contains(&hz)) {
            return Err("`hz`: give a rate of 0.01 to 1000 frames per second, or leave it out".into());
        }
        config.calibration.as_deref().map(read_calibration).transpose()?;
        if config.passes == 0 || (config.passes > 1 && (config.hz.is_none() || config.sampling.is_some())) {
            return Err(
                "`passes`: give at least 1; more than one need `hz`, since stamps cannot go back, and no `sampling`"
                    .into(),
            );
        }
        if config.sampling.is_some() && config.frames != Stride::default() {
            return Err("`frames`: a training draws its frames at random: leave `frames` or `sampling` out".into());
        }
        if config.max_frames == Some(0) {
            return Err("`max_frames: 0`: give at least 1, or leave it out".into());
        }
        Ok(())
    }

    fn create(config: PlayerConfig, context: &Context) -> Result<Self, NodeError> {
        let objects = config.objects.as_deref().map(ObjectSet::load).transpose()?;
        let naming = objects.as_ref().map(naming_of).transpose()?.unwrap_or_default();
        let source = open_all(&config, &naming)?;
        let poses = config.initial_poses.file.as_deref().map(PosesFile::read).transpose()?;
        if let Some(set) = &objects {
            let sent = poses.as_ref().map_or_else(|| source.objects(), PosesFile::objects);
            check_objects(&config, &sent, &set.ids())?;
        }
        log::info!("{}: {} frames", config.source.display(), source.count());
        if config.frames.start > 0 && config.frames.count(source.count() as u64) == 0 {
            let (start, count) = (config.frames.start, source.count());
            return Err(format!("`frames.start: {start}`: the recordings have {count} frames: give less").into());
        }
        let sampling = config.sampling.clone();
        let mut node = Self { config, source, poses, sampler: Sampler::default() };
        if let Some(sampling) = sampling {
            node.prepare_sampling(&sampling, context)?;
        }
        Ok(node)
    }

    fn process(&mut self, _: &dyn Inputs, _: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        Ok(())
    }

    fn produce(&mut self, index: u64, outputs: &mut dyn Outputs, context: &Context) -> Result<Produced, NodeError> {
        let Some((number, sample)) = self.draw(index, context) else { return Ok(Produced::End) };
        // A file is looked at when the recording is opened; what cannot be decoded shows itself here.
        let mut frame = self.load(number).or_bad_input("source")?;
        let of_rate = |hz: f64| 1_000_000_000 + (index as f64 / hz * 1e9).round() as i64;
        let key = FrameKey { index, stamp_ns: self.config.hz.map_or(frame.stamp_ns, of_rate) };
        if let Some(sample) = &sample {
            frame.initial_poses = vec![frame.initial_poses[sample.pose]];
            if outputs.is_connected(PARTNERS.name()) {
                self.send_partners(sample, key, outputs, context)?;
            }
        }
        let header = frame.header;
        let len = CameraFrame::byte_len(header.width, header.height);
        FRAME
            .send(outputs, key, len, &mut |bytes| CameraFrame::write(bytes, header).rgb.copy_from_slice(&frame.rgb))?;
        let poses = &frame.initial_poses;
        INITIAL_POSES.send(outputs, key, ObjectPoses::byte_len(poses.len()), &mut |bytes| {
            ObjectPoses::write(bytes, header.scene_id, header.image_id, poses);
        })?;
        let seen = &frame.rectangles;
        RECTANGLES.send(outputs, key, Rectangles::byte_len(seen.len()), &mut |bytes| {
            Rectangles::write(bytes, header.scene_id, header.image_id, seen);
        })?;
        Ok(Produced::Frame(key))
    }
}
