use crate::partners::{PartnerCrops, crop_partners};
use crate::views::{Plan, ViewSettings, plan, with_pose};
use crate::{Device, open};
use pseudoflow_geometry::Intrinsics;
use pseudoflow_imaging::raster::{Rasteriser, Rendering};
use pseudoflow_imaging::{ObjectSet, RgbImage, resample};
use pseudoflow_msgs::{
    CameraFrame, ObjectPose, ObjectPoses, PartnerFrames, ReferenceView, ReferenceViews, ReferenceViewsHeader,
    ReferenceViewsMut,
};
use pseudoflow_runtime::{Context, Draws, Inputs, Node, NodeError, OrBadInput, Outputs, Port, PortSpec, Role};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

const FRAME: Port<CameraFrame<'static>> = Port::required("frame");
const INITIAL_POSES: Port<ObjectPoses<'static>> = Port::required("initial_poses");
const AROUND: Port<ObjectPoses<'static>> = Port::optional("around");
const PARTNERS: Port<PartnerFrames<'static>> = Port::optional("partners");
const VIEWS: Port<ReferenceViews<'static>> = Port::required("views");

/// Settings of the renderer node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RendererConfig {
    /// Folder of the object set (BOP `models/`).
    pub objects: PathBuf,
    /// Width and height of crops and renderings, pixels; the flow node's `size_px`.
    #[serde(default = "default_size_px")]
    pub size_px: u32,
    /// Renderings of each instance: 1 to refine, 4 to make pseudo-labels.
    #[serde(default = "default_views")]
    pub views: u32,
    /// Side of the crop over the larger side of the projection.
    #[serde(default = "default_margin")]
    pub margin: f64,
    /// What renders.
    #[serde(default)]
    pub device: Device,
    /// Frames of a training that went before this run: they decide what is drawn at random.
    #[serde(default)]
    pub first_frame: u64,
    /// What decides which poses of further views are drawn.
    #[serde(default)]
    pub draws: Draws,
}

fn default_size_px() -> u32 {
    128
}

fn default_views() -> u32 {
    1
}

fn default_margin() -> f64 {
    1.1
}

impl RendererConfig {
    /// The defaults for an object set.
    #[must_use]
    pub fn new(objects: PathBuf, size_px: u32) -> Self {
        Self {
            objects,
            size_px,
            views: default_views(),
            margin: default_margin(),
            device: Device::default(),
            first_frame: 0,
            draws: Draws::default(),
        }
    }
}

/// Frames and initial poses in, reference views out.
pub struct RendererNode {
    settings: ViewSettings,
    objects: ObjectSet,
    rasteriser: Box<dyn Rasteriser>,
    first_frame: u64,
    draws: Draws,
}

impl RendererNode {
    fn fill(
        &self,
        message: ReferenceViewsMut<'_>,
        plan: &Plan,
        renderings: &[Rendering],
        crops: &[RgbImage],
        partners: &PartnerCrops,
    ) {
        let area = (self.settings.size_px as usize).pow(2);
        message.skipped.copy_from_slice(&plan.skipped);
        message.partners.copy_from_slice(&partners.partners);
        message.partner_rgb.copy_from_slice(&partners.rgb);
        for (out, crop) in message.real_rgb.chunks_exact_mut(3 * area).zip(crops) {
            out.copy_from_slice(crop.as_raw());
        }
        for (i, rendering) in renderings.iter().enumerate() {
            message.rgb[i * 3 * area..(i + 1) * 3 * area].copy_from_slice(rendering.rgb.as_raw());
            message.depth_m[i * area..(i + 1) * area].copy_from_slice(&rendering.depth_m);
            for (out, mask) in message.mask[i * area..(i + 1) * area].iter_mut().zip(&rendering.mask) {
                *out = if *mask == 0 { 0 } else { 255 };
            }
        }
        let views = plan.instances.iter().flat_map(|instance| {
            instance.poses.iter().enumerate().map(move |(view, pose)| {
                let k = &instance.crop_intrinsics;
                ReferenceView {
                    pose: with_pose(&instance.initial, view, pose),
                    crop_intrinsics: [k.fx, k.fy, k.cx, k.cy],
                    crop: [instance.crop.x0, instance.crop.y0, instance.crop.side],
                    diameter_m: instance.diameter_m,
                }
            })
        });
        message.views.iter_mut().zip(views).for_each(|(out, view)| *out = view);
    }
}

impl Node for RendererNode {
    const KIND: &'static str = "renderer";
    const ROLE: Role = Role::Transform;
    type Config = RendererConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![FRAME.spec(), INITIAL_POSES.spec(), AROUND.spec(), PARTNERS.spec()]
    }

    fn outputs() -> Vec<PortSpec> {
        vec![VIEWS.spec()]
    }

    fn check(config: &RendererConfig) -> Result<(), NodeError> {
        if !config.size_px.is_multiple_of(8) || !(64..=1024).contains(&config.size_px) {
            return Err(format!("`size_px: {}`: give a multiple of 8 in 64..=1024", config.size_px).into());
        }
        if !(1..=16).contains(&config.views) {
            return Err(format!("`views: {}`: give 1..=16", config.views).into());
        }
        if !(1.0..=2.0).contains(&config.margin) {
            return Err(format!("`margin: {}`: give 1.0..=2.0", config.margin).into());
        }
        ObjectSet::check(&config.objects)?;
        Ok(())
    }

    fn create(config: RendererConfig, _context: &Context) -> Result<Self, NodeError> {
        let objects = ObjectSet::load(&config.objects)?;
        let mut rasteriser = open(config.device)?;
        for object in objects.iter() {
            rasteriser.add_object(object.id, &object.mesh)?;
        }
        log::info!("{} renders {} objects at {} px", rasteriser.name(), objects.len(), config.size_px);
        let settings = ViewSettings { size_px: config.size_px, views: config.views, margin: config.margin };
        Ok(Self { settings, objects, rasteriser, first_frame: config.first_frame, draws: config.draws })
    }

    fn objects(inputs: &dyn Inputs) -> Option<usize> {
        let initial = INITIAL_POSES.read(inputs).ok()?;
        Some(ObjectPose::likeliest(initial.poses).count())
    }

    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, context: &Context) -> Result<(), NodeError> {
        let frame = FRAME.read(inputs)?;
        let initial = INITIAL_POSES.read(inputs)?;
        let (width, height) = (frame.header.width, frame.header.height);
        let [fx, fy, cx, cy] = frame.header.intrinsics;
        let intrinsics = Intrinsics { fx, fy, cx, cy };
        let image = (frame.header.scene_id, frame.header.image_id);
        let mut rng = self.draws.rng(context, self.first_frame + inputs.key().index, image, "views");
        let around = AROUND.given(inputs)?.map_or(&[][..], |message| message.poses);
        let size = (width, height);
        let plan = plan(initial.poses, around, &self.objects, &intrinsics, size, &self.settings, &mut rng);
        let plan = plan.or_bad_input(INITIAL_POSES.name())?;
        let renderings = self.rasteriser.render(&plan.rasteriser_views(self.settings.size_px))?;
        let image = RgbImage::from_raw(width, height, frame.rgb.to_vec());
        let image = image.ok_or("the frame has too few pixels").or_bad_input(FRAME.name())?;
        let crops: Vec<RgbImage> = plan.instances.iter().map(|i| resample(&image, &i.crop)).collect();
        let partners = match PARTNERS.given(inputs)? {
            Some(frames) => {
                crop_partners(&frames, &plan, &self.objects, &self.settings).or_bad_input(PARTNERS.name())?
            }
            None => PartnerCrops::default(),
        };
        let header = ReferenceViewsHeader {
            instances: plan.instances.len() as u32,
            views_per_instance: self.settings.views,
            size_px: self.settings.size_px,
            scene_id: frame.header.scene_id,
            image_id: frame.header.image_id,
            skipped: plan.skipped.len() as u32,
            partners_per_instance: partners.per_instance,
            reserved: 0,
        };
        VIEWS.send(outputs, inputs.key(), ReferenceViews::byte_len(&header), &mut |bytes| {
            self.fill(ReferenceViews::write(bytes, header), &plan, &renderings, &crops, &partners);
        })
    }
}
