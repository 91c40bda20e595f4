//! Synthetic scenes in a camera's place, with rough poses of what they show. Their truth goes into a file, for no message may
//! carry it.

use super::starts::draw_start;
use pseudoflow_geometry::{Crop, Pose, quaternion_xyzw};
use pseudoflow_imaging::raster::{Rasteriser, SoftwareRasteriser, View};
use pseudoflow_imaging::{Object, ObjectSet, RgbImage};
use pseudoflow_msgs::{
    CameraFrame, CameraFrameHeader, FRAME_ID_BYTES, FrameKey, ObjectPose, ObjectPoses, PoseSource, PoseStatus,
};
use pseudoflow_runtime::{Context, Inputs, JsonLines, Node, NodeError, Outputs, Port, PortSpec, Produced, Role};
use pseudoflow_synthetic::{SceneConfig, SceneGenerator, SceneSample};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;

const FRAME: Port<CameraFrame<'static>> = Port::required("frame");
const INITIAL_POSES: Port<ObjectPoses<'static>> = Port::required("initial_poses");

/// Less visible objects are not looked for (as in the benchmark).
const MIN_VISIBLE: f64 = 0.1;
/// Side of the rendering that visible shares are measured with, pixels.
const SHARE_PX: u32 = 96;

/// Settings of the source of synthetic scenes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct ScenesConfig {
    /// The object set: a BOP `models/` folder.
    pub(crate) objects: PathBuf,
    /// Scenes to make, one frame of each.
    pub(crate) scenes: u64,
    /// File that gets the truth, a line of JSON for each frame.
    pub(crate) truth: PathBuf,
}

/// The truth of one frame.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SceneTruth {
    /// As in the frame's header; the scene id is 0.
    pub(super) image_id: u32,
    /// What rough poses were sent of.
    pub(super) instances: Vec<InstanceTruth>,
}

/// The truth of one object of a frame.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct InstanceTruth {
    pub(super) object_id: u32,
    pub(super) instance: u32,
    /// Unit quaternion x, y, z, w and metres.
    pub(super) camera_from_object: ([f64; 4], [f64; 3]),
    /// Visible share of the object's projection, 0..1.
    pub(super) visible: f64,
}

/// Makes the frames.
pub(crate) struct ScenesNode {
    objects: Arc<ObjectSet>,
    scenes: u64,
    generator: SceneGenerator,
    rasteriser: SoftwareRasteriser,
    truth: JsonLines,
}

/// Crowded, often hidden, from small in the image to large: what is easy teaches the gate nothing.
fn scene_config() -> SceneConfig {
    SceneConfig {
        projected_px: [55.0, 260.0],
        most_objects: 7,
        most_others: 9,
        occluded: 0.5,
        // The shipped gate was fitted without arms.
        reached_into: 0.0,
        ..SceneConfig::for_images(640, 480)
    }
}

impl ScenesNode {
    /// The scene of an index, and the rough poses and truths of everything in it that can be seen.
    fn scene(
        &self,
        index: u64,
        context: &Context,
    ) -> Result<(SceneSample, Vec<(ObjectPose, InstanceTruth)>), NodeError> {
        let mut scene = self.generator.scene(index)?;
        let mut rng = context.rng(index, "rough poses");
        fade(&mut scene.image, &mut rng);
        let mut seen = Vec::new();
        for (number, instance) in scene.instances.iter().enumerate() {
            let object = self.objects.get(instance.object_id)?;
            let visible = self.visible_share(&scene, number, object)?;
            if visible >= MIN_VISIBLE {
                let truth = &instance.camera_from_object;
                let rough = rough_pose(object.id, number as u32, &draw_start(truth, object.diameter_m, &mut rng));
                seen.push((rough, instance_truth(object.id, number as u32, truth, visible)));
            }
        }
        Ok((scene, seen))
    }

    /// The share of the object's projection that is seen in the image.
    fn visible_share(&self, scene: &SceneSample, number: usize, object: &Object) -> Result<f64, NodeError> {
        let pose = scene.instances[number].camera_from_object;
        let Some(crop) = Crop::around(&object.hull_m, &pose, &scene.intrinsics, 1.05, SHARE_PX) else { return Ok(0.0) };
        let view = View {
            object_id: object.id,
            camera_from_object: pose,
            intrinsics: crop.intrinsics(&scene.intrinsics),
            width: SHARE_PX,
            height: SHARE_PX,
        };
        let rendered = self.rasteriser.render(&[view])?;
        let scale = crop.side / f64::from(SHARE_PX);
        let whole = rendered.iter().map(|r| r.foreground_px()).sum::<usize>() as f64 * scale * scale;
        let seen = scene.owner.iter().filter(|owner| usize::from(**owner) == number + 1).count() as f64;
        Ok((seen / whole.max(1.0)).min(1.0))
    }
}

/// A third of the images have other colours than the meshes would make: paler or stronger, darker or brighter, tinted.
fn fade(image: &mut RgbImage, rng: &mut ChaCha8Rng) {
    if rng.random::<f64>() > 0.35 {
        return;
    }
    let (saturation, gamma) = (rng.random_range(0.0..1.3_f32), rng.random_range(0.55..1.8_f32));
    let tint: [f32; 3] = std::array::from_fn(|_| rng.random_range(0.75..1.2_f32));
    for pixel in image.pixels_mut() {
        let value = pixel.0.map(|c| f32::from(c) / 255.0);
        let grey = 0.299 * value[0] + 0.587 * value[1] + 0.114 * value[2];
        for k in 0..3 {
            let pale = (grey + saturation * (value[k] - grey)).clamp(0.0, 1.0);
            pixel.0[k] = (255.0 * (tint[k] * pale.powf(gamma)).clamp(0.0, 1.0) + 0.5) as u8;
        }
    }
}

fn frame_header(scene: &SceneSample, index: u64) -> CameraFrameHeader {
    let k = &scene.intrinsics;
    CameraFrameHeader {
        width: scene.image.width(),
        height: scene.image.height(),
        scene_id: 0,
        image_id: index as u32,
        intrinsics: [k.fx, k.fy, k.cx, k.cy],
        frame_id: [0; FRAME_ID_BYTES],
    }
}

fn rough_pose(object_id: u32, instance: u32, pose: &Pose) -> ObjectPose {
    ObjectPose {
        object_id,
        instance,
        status: PoseStatus::Ok as u32,
        source: PoseSource::Given as u32,
        score: 1.0,
        rotation_xyzw: quaternion_xyzw(pose),
        translation_m: pose.translation.vector.into(),
        covariance: [0.0; 36],
    }
}

fn instance_truth(object_id: u32, instance: u32, pose: &Pose, visible: f64) -> InstanceTruth {
    let camera_from_object = (quaternion_xyzw(pose), pose.translation.vector.into());
    InstanceTruth { object_id, instance, camera_from_object, visible }
}

impl Node for ScenesNode {
    const KIND: &'static str = "scenes";
    const ROLE: Role = Role::ReplaySource;
    type Config = ScenesConfig;

    fn inputs() -> Vec<PortSpec> {
        Vec::new()
    }

    fn outputs() -> Vec<PortSpec> {
        vec![FRAME.spec(), INITIAL_POSES.spec()]
    }

    fn check(config: &ScenesConfig) -> Result<(), NodeError> {
        if !config.objects.is_dir() {
            return Err(format!(
                "`objects`: {}: no such folder: name a BOP `models/` folder",
                config.objects.display()
            )
            .into());
        }
        if !(1..=u64::from(u32::MAX)).contains(&config.scenes) {
            return Err("`scenes`: give a number of 1 to 2^32 - 1".into());
        }
        Ok(())
    }

    fn create(config: ScenesConfig, context: &Context) -> Result<Self, NodeError> {
        let objects = Arc::new(ObjectSet::load(&config.objects)?);
        let mut rasteriser = SoftwareRasteriser::new();
        for object in objects.iter() {
            rasteriser.add_object(object.id, &object.mesh)?;
        }
        let generator = SceneGenerator::new(Arc::clone(&objects), scene_config(), context.seed)?;
        let truth = JsonLines::open(&config.truth, context.restarts > 0)?;
        Ok(Self { objects, scenes: config.scenes, generator, rasteriser, truth })
    }

    fn process(&mut self, _: &dyn Inputs, _: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        Ok(())
    }

    fn produce(&mut self, index: u64, outputs: &mut dyn Outputs, context: &Context) -> Result<Produced, NodeError> {
        if index >= self.scenes {
            return Ok(Produced::End);
        }
        let (scene, seen) = self.scene(index, context)?;
        let (rough, instances): (Vec<ObjectPose>, Vec<InstanceTruth>) = seen.into_iter().unzip();
        let header = frame_header(&scene, index);
        self.truth.write(&SceneTruth { image_id: header.image_id, instances })?;
        let key = FrameKey { index, stamp_ns: index as i64 };
        FRAME.send(outputs, key, CameraFrame::byte_len(header.width, header.height), &mut |bytes| {
            CameraFrame::write(bytes, header).rgb.copy_from_slice(scene.image.as_raw());
        })?;
        INITIAL_POSES.send(outputs, key, ObjectPoses::byte_len(rough.len()), &mut |bytes| {
            ObjectPoses::write(bytes, header.scene_id, header.image_id, &rough);
        })?;
        Ok(Produced::Frame(key))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn a_third_of_the_images_are_faded() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut image = RgbImage::from_pixel(4, 4, image::Rgb([200, 100, 50]));
        let changed = (0..100).filter(|_| {
            image = RgbImage::from_pixel(4, 4, image::Rgb([200, 100, 50]));
            fade(&mut image, &mut rng);
            image.get_pixel(0, 0).0 != [200, 100, 50]
        });
        assert!((20..50).contains(&changed.count()));
    }
}
