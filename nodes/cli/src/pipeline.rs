//! The refinement nodes called one by one, message by message: for images that no source of a graph gives (`calibrate`), and for
//! what `adapt` asks of a frame out of turn.

use anyhow::{Context as _, Result, anyhow};
use pseudoflow_flow::{FlowConfig, FlowNode};
use pseudoflow_initializer::{InitializerConfig, InitializerNode};
use pseudoflow_msgs::{
    AlignedBytes, CameraFrame, CameraFrameHeader, FlowFields, FrameKey, Message, ObjectPose, ObjectPoses,
    ReferenceViews,
};
use pseudoflow_pnp::{Look, PnpNode, PnpNodeConfig};
use pseudoflow_renderer::{RendererConfig, RendererNode};
use pseudoflow_runtime::{Context, InMemory, Node};

/// How to refine.
#[derive(Debug, Clone)]
pub(crate) struct PipelineConfig {
    /// What renders and what computes flow; `None` for poses from contours alone.
    pub(crate) views: Option<(RendererConfig, FlowConfig)>,
    pub(crate) pnp: PnpNodeConfig,
    pub(crate) seed: u64,
}

/// One frame of a dataset.
pub(crate) struct Frame<'a> {
    pub(crate) header: CameraFrameHeader,
    pub(crate) rgb: &'a [u8],
    pub(crate) index: u64,
}

/// Renderer, flow and pnp of one process.
pub(crate) struct Pipeline {
    views: Option<(RendererNode, FlowNode)>,
    pnp: PnpNode,
    context: Context,
}

/// One instance: its refined pose, what the pictures say about it, and the crop that it was refined in.
#[derive(Debug, Clone)]
pub(crate) struct Judged {
    pub(crate) initial: ObjectPose,
    pub(crate) pose: ObjectPose,
    pub(crate) agreement: f64,
    pub(crate) photometric: f64,
    pub(crate) silhouette: f64,
    /// x0, y0 (edges), side in image pixels.
    pub(crate) crop: [f64; 3],
}

fn open_views(renderer: RendererConfig, flow: FlowConfig, context: &Context) -> Result<(RendererNode, FlowNode)> {
    RendererNode::check(&renderer).map_err(boxed).context("renderer")?;
    FlowNode::check(&flow).map_err(boxed).context("flow")?;
    Ok((
        RendererNode::create(renderer, context).map_err(boxed).context("renderer")?,
        FlowNode::create(flow, context).map_err(boxed).context("flow")?,
    ))
}

fn boxed(error: pseudoflow_runtime::NodeError) -> anyhow::Error {
    anyhow!("{error}")
}

impl Pipeline {
    pub(crate) fn open(config: PipelineConfig) -> Result<Self> {
        let context = context("eval", config.seed);
        PnpNode::check(&config.pnp).map_err(boxed).context("pnp")?;
        let views = config.views.map(|(renderer, flow)| open_views(renderer, flow, &context)).transpose()?;
        Ok(Self { views, pnp: PnpNode::create(config.pnp, &context).map_err(boxed).context("pnp")?, context })
    }

    /// Refines the poses of one frame.
    pub(crate) fn refine(&mut self, frame: &Frame<'_>, initial: &[ObjectPose]) -> Result<Vec<Look>> {
        let mut messages = InMemory::new(FrameKey { index: frame.index, stamp_ns: 0 });
        messages.messages.push(("frame".into(), frame_message(frame)));
        messages.messages.push(("initial_poses".into(), poses_message(frame, initial)));
        if let Some((renderer, flow)) = &mut self.views {
            renderer.step(&mut messages, &self.context).context("node renderer")?;
            flow.step(&mut messages, &self.context).context("node flow")?;
        }
        self.pnp.looks(&messages, &self.context).map_err(boxed).context("node pnp")
    }

    /// Refines a frame (`frame` and `initial_poses` are among the messages) and judges each pose without truth.
    pub(crate) fn judge(&mut self, messages: &InMemory) -> Result<Vec<Judged>> {
        let mut messages = InMemory { key: messages.key, messages: messages.messages.clone() };
        let (renderer, flow) = self.views.as_mut().context("a pipeline without flow cannot judge by it")?;
        renderer.step(&mut messages, &self.context).context("node renderer")?;
        flow.step(&mut messages, &self.context).context("node flow")?;
        let bytes = |port: &str| {
            let found = messages.messages.iter().find(|(name, _)| name == port);
            found.map(|(_, bytes)| bytes).with_context(|| format!("no node sent `{port}`"))
        };
        let views = ReferenceViews::view(bytes("views")?)?;
        let flow = FlowFields::view(bytes("flow")?)?;
        let judgements = self.pnp.judge(&views, &flow, self.context.seed).map_err(boxed).context("node pnp")?;
        let per_instance = views.header.views_per_instance as usize;
        let judged = judgements.into_iter().zip(views.views.iter().step_by(per_instance)).map(|(judgement, view)| {
            let (photometric, silhouette) =
                judgement.evidence.map_or((0.0, 0.0), |e| (e.photometric_refined, e.silhouette_refined));
            let agreement = judgement.agreement();
            Judged { initial: view.pose, pose: judgement.pose, agreement, photometric, silhouette, crop: view.crop }
        });
        Ok(judged.collect())
    }
}

/// The initializer in one process.
pub(crate) struct Finder {
    node: InitializerNode,
    context: Context,
}

impl Finder {
    pub(crate) fn open(config: InitializerConfig, seed: u64) -> Result<Self> {
        let context = context("initializer", seed);
        InitializerNode::check(&config).map_err(boxed).context("initializer")?;
        Ok(Self { node: InitializerNode::create(config, &context).map_err(boxed).context("initializer")?, context })
    }

    /// The objects in a frame.
    pub(crate) fn find(&mut self, frame: &Frame<'_>) -> Result<Vec<ObjectPose>> {
        let mut messages = InMemory::new(FrameKey { index: frame.index, stamp_ns: 0 });
        messages.messages.push(("frame".into(), frame_message(frame)));
        self.node.step(&mut messages, &self.context).context("node initializer")?;
        let bytes = messages.messages.iter().find(|(port, _)| port == "initial_poses").context("no initial poses")?;
        Ok(ObjectPoses::view(&bytes.1)?.poses.to_vec())
    }
}

fn context(name: &str, seed: u64) -> Context {
    Context { name: name.into(), seed, out_dir: std::env::temp_dir(), restarts: 0, replay: true }
}

/// A node that reads from and adds to the frame's messages.
trait Step {
    fn step(&mut self, messages: &mut InMemory, context: &Context) -> Result<()>;
}

impl<N: Node> Step for N {
    fn step(&mut self, messages: &mut InMemory, context: &Context) -> Result<()> {
        let mut out = InMemory::new(messages.key.context("frames have keys")?);
        self.process(messages, &mut out, context).map_err(boxed)?;
        messages.messages.append(&mut out.messages);
        Ok(())
    }
}

fn frame_message(frame: &Frame<'_>) -> AlignedBytes {
    let mut bytes = AlignedBytes::zeroed(CameraFrame::byte_len(frame.header.width, frame.header.height));
    CameraFrame::write(&mut bytes, frame.header).rgb.copy_from_slice(frame.rgb);
    bytes
}

fn poses_message(frame: &Frame<'_>, poses: &[ObjectPose]) -> AlignedBytes {
    let mut bytes = AlignedBytes::zeroed(ObjectPoses::byte_len(poses.len()));
    ObjectPoses::write(&mut bytes, frame.header.scene_id, frame.header.image_id, poses);
    bytes
}
