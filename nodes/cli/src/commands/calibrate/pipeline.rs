//! The refinement nodes called one by one, message by message. No graph, because the truth of a synthetic scene must reach what
//! counts its poses, and no message may carry it; and because scenes are made until there are samples enough.

use anyhow::{Context as _, Result, anyhow};
use pseudoflow_flow::{FlowConfig, FlowNode};
use pseudoflow_msgs::{AlignedBytes, CameraFrame, CameraFrameHeader, FrameKey, ObjectPose, ObjectPoses};
use pseudoflow_pnp::{Look, PnpNode, PnpNodeConfig};
use pseudoflow_renderer::{RendererConfig, RendererNode};
use pseudoflow_runtime::{Context, InMemory, Node};

/// How to refine.
#[derive(Debug, Clone)]
pub(super) struct PipelineConfig {
    /// What renders and what computes flow; `None` for poses from contours alone.
    pub(super) views: Option<(RendererConfig, FlowConfig)>,
    pub(super) pnp: PnpNodeConfig,
    pub(super) seed: u64,
}

/// One frame of a dataset.
pub(super) struct Frame<'a> {
    pub(super) header: CameraFrameHeader,
    pub(super) rgb: &'a [u8],
    pub(super) index: u64,
}

/// Renderer, flow and pnp of one process.
pub(super) struct Pipeline {
    views: Option<(RendererNode, FlowNode)>,
    pnp: PnpNode,
    context: Context,
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
    pub(super) fn open(config: PipelineConfig) -> Result<Self> {
        let context = context(config.seed);
        PnpNode::check(&config.pnp).map_err(boxed).context("pnp")?;
        let views = config.views.map(|(renderer, flow)| open_views(renderer, flow, &context)).transpose()?;
        Ok(Self { views, pnp: PnpNode::create(config.pnp, &context).map_err(boxed).context("pnp")?, context })
    }

    /// Refines the poses of one frame.
    pub(super) fn refine(&mut self, frame: &Frame<'_>, initial: &[ObjectPose]) -> Result<Vec<Look>> {
        let mut messages = InMemory::new(FrameKey { index: frame.index, stamp_ns: 0 });
        messages.messages.push(("frame".into(), frame_message(frame)));
        messages.messages.push(("initial_poses".into(), poses_message(frame, initial)));
        if let Some((renderer, flow)) = &mut self.views {
            renderer.step(&mut messages, &self.context).context("node renderer")?;
            flow.step(&mut messages, &self.context).context("node flow")?;
        }
        self.pnp.looks(&messages, &self.context).map_err(boxed).context("node pnp")
    }
}

/// Named as the node of `eval.yaml` draws.
fn context(seed: u64) -> Context {
    Context { name: "eval".into(), seed, out_dir: std::env::temp_dir(), restarts: 0, replay: true }
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
