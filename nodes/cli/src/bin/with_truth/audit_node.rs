//! How many labels are right: counted against the truth, frame by frame.

use crate::truth::{Truth, TruthFiles};
use anyhow::Result;
use pseudoflow_consistency::label_panel;
use pseudoflow_msgs::{FlowFields, PseudoLabels, ReferenceViews};
use pseudoflow_runtime::{Context, Inputs, JsonLines, Node, NodeError, Outputs, Port, PortSpec, Role};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

const VIEWS: Port<ReferenceViews<'static>> = Port::required("views");
const FLOW: Port<FlowFields<'static>> = Port::required("flow");
const LABELS: Port<PseudoLabels<'static>> = Port::required("labels");

/// Largest disagreements, pixels of a 256 px crop, that labels are counted for.
pub(crate) const TAUS_AT_256: [f32; 6] = [0.5, 1.0, 1.5, 2.0, 4.0, 8.0];
/// A label is right within so many pixels of a 256 px crop.
const RIGHT_PX_AT_256: f32 = 2.0;
/// How many frames are drawn.
const MOST_PICTURES: u64 = 3;

/// Settings of the audit node.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct AuditConfig {
    /// The truth.
    pub(crate) truth: TruthFiles,
    /// File that gets a line of JSON for each frame ([`Tally`]).
    pub(crate) lines: PathBuf,
    /// Draws the labels of the first frames into this folder.
    #[serde(default)]
    pub(crate) pictures: Option<PathBuf>,
}

/// Pixels of a frame: kept and right for each tau, and on the object.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Tally {
    pub(crate) kept: [usize; TAUS_AT_256.len()],
    pub(crate) right: [usize; TAUS_AT_256.len()],
    pub(crate) visible: usize,
    pub(crate) all_right: usize,
}

impl std::iter::Sum for Tally {
    fn sum<I: Iterator<Item = Self>>(tallies: I) -> Self {
        tallies.fold(Self::default(), |all, one| Self {
            kept: std::array::from_fn(|i| all.kept[i] + one.kept[i]),
            right: std::array::from_fn(|i| all.right[i] + one.right[i]),
            visible: all.visible + one.visible,
            all_right: all.all_right + one.all_right,
        })
    }
}

/// Views and labels in, counts in a file.
pub(crate) struct AuditNode {
    truth: Truth,
    lines: JsonLines,
    pictures: Option<PathBuf>,
}

impl AuditNode {
    fn count(&self, views: &ReferenceViews<'_>, labels: &PseudoLabels<'_>) -> Result<Tally> {
        let size_px = views.header.size_px as usize;
        let (area, scale) = (size_px * size_px, size_px as f32 / 256.0);
        let mut tally = Tally::default();
        for number in 0..views.views.len() {
            let Some(real) = self.truth.flow(views, number)? else { continue };
            for pixel in (0..area).filter(|pixel| views.mask[number * area + pixel] != 0) {
                tally.visible += 1;
                let at = number * area + pixel;
                let off = |axis: usize| labels.label_px[2 * at + axis] - real.flow_px[2 * pixel + axis];
                let right = off(0).hypot(off(1)) <= RIGHT_PX_AT_256 * scale;
                tally.all_right += usize::from(right);
                for (i, tau) in TAUS_AT_256.iter().enumerate() {
                    let kept = labels.valid[at] != 0 && labels.sigma_px[at] < tau * scale;
                    tally.kept[i] += usize::from(kept);
                    tally.right[i] += usize::from(kept && right);
                }
            }
        }
        Ok(tally)
    }
}

fn draw(views: &ReferenceViews<'_>, flow: &FlowFields<'_>, labels: &PseudoLabels<'_>, folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder)?;
    for instance in 0..views.header.instances as usize {
        let Some(panel) = label_panel(views, flow, labels, instance) else { continue };
        let object_id = labels.info[instance].object_id;
        panel.save(folder.join(format!("{:06}_{object_id:02}.png", views.header.image_id)))?;
    }
    Ok(())
}

impl Node for AuditNode {
    const KIND: &'static str = "audit";
    const ROLE: Role = Role::Sink;
    type Config = AuditConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![VIEWS.spec(), FLOW.spec(), LABELS.spec()]
    }

    fn outputs() -> Vec<PortSpec> {
        Vec::new()
    }

    fn check(config: &AuditConfig) -> Result<(), NodeError> {
        Ok(config.truth.check()?)
    }

    fn create(config: AuditConfig, context: &Context) -> Result<Self, NodeError> {
        let lines = JsonLines::open(&config.lines, context.restarts > 0)?;
        Ok(Self { truth: Truth::read(&config.truth)?, lines, pictures: config.pictures })
    }

    fn process(&mut self, inputs: &dyn Inputs, _: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        let views = VIEWS.read(inputs)?;
        let labels = LABELS.read(inputs)?;
        self.lines.write(&self.count(&views, &labels)?)?;
        if let Some(folder) = self.pictures.as_ref().filter(|_| inputs.key().index < MOST_PICTURES) {
            draw(&views, &FLOW.read(inputs)?, &labels, folder)?;
        }
        Ok(())
    }
}
