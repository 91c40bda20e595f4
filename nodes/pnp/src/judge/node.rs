use super::{Judged, JudgedFrame, JudgedInstance, Verdict};
use crate::crop_solver::CropSolver;
use crate::gate::{Gate, GateConfig};
use crate::views::{ViewPlanes, belong_together, evidence, planes};
use pseudoflow_geometry::quaternion_xyzw;
use pseudoflow_msgs::{FlowFields, ObjectPose, ReferenceViews};
use pseudoflow_runtime::{
    Context, Inputs, JsonLines, Node, NodeError, OrBadInput, Outputs, Port, PortSpec, Role, read_lines,
};
use pseudoflow_solver::{PnpConfig, PnpStatus};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::path::PathBuf;

/// Renderings and real crops.
const VIEWS: Port<ReferenceViews<'static>> = Port::required("views");
/// Flow of the first network.
const FLOW: Port<FlowFields<'static>> = Port::required("flow");
/// Flow of the second network.
const FLOW_AFTER: Port<FlowFields<'static>> = Port::optional("flow_after");

/// Settings of the judge node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JudgeConfig {
    /// File that gets a line of JSON for each frame ([`JudgedFrame`]).
    pub lines: PathBuf,
    /// File for the comparison of both flows (JSON, [`Verdict`]), written at the end. It needs the input `flow_after`.
    #[serde(default)]
    pub verdict: Option<PathBuf>,
    /// The solver. Pixel thresholds are those of a crop of 256 px and scale with the crop.
    #[serde(default)]
    pub solver: PnpConfig,
}

/// Views with the flow of one or two networks in; judgements in a file.
pub struct JudgeNode {
    config: JudgeConfig,
    solver: CropSolver,
    gate: Gate,
    blocks_across: usize,
    lines: JsonLines,
    /// Frames that the file has already.
    done: BTreeSet<u64>,
}

impl JudgeNode {
    /// The pose that a flow means, and what the pictures say about it.
    fn judged(&mut self, planes: &ViewPlanes<'_>, seed: u64) -> Result<Judged, NodeError> {
        let found = self.solver.solve(&planes.field, seed)?;
        let initial = &planes.view.pose;
        let solved = found.status == PnpStatus::Ok;
        let (pose, [photometric, silhouette]) = if solved {
            let seen = evidence(planes, &found, self.blocks_across, &mut self.gate)?;
            let after = &found.camera_from_object;
            let pose = (quaternion_xyzw(after), after.translation.vector.into());
            (pose, [seen.photometric_refined, seen.silhouette_refined].map(finite))
        } else {
            ((initial.rotation_xyzw, initial.translation_m), [0.0; 2])
        };
        Ok(Judged { solved, pose, inlier_ratio: found.inlier_ratio, photometric, silhouette })
    }

    /// All instances by one flow. They are solved with one seed: what is drawn depends on nothing but the run's.
    fn by_flow(
        &mut self,
        views: &ReferenceViews<'_>,
        inputs: &dyn Inputs,
        port: &Port<FlowFields<'static>>,
        seed: u64,
    ) -> Result<Vec<Judged>, NodeError> {
        let flow = port.read(inputs)?;
        belong_together(views, &flow).or_bad_input(port.name())?;
        (0..views.header.instances as usize).map(|at| self.judged(&planes(views, &flow, at)?, seed)).collect()
    }

    fn judge(&mut self, inputs: &dyn Inputs, seed: u64) -> Result<JudgedFrame, NodeError> {
        let views = VIEWS.read(inputs)?;
        let before = self.by_flow(&views, inputs, &FLOW, seed)?;
        let mut after = match FLOW_AFTER.has_come(inputs) {
            true => self.by_flow(&views, inputs, &FLOW_AFTER, seed)?.into_iter(),
            false => Vec::new().into_iter(),
        };
        let firsts = views.views.iter().step_by(views.header.views_per_instance.max(1) as usize);
        let instances = firsts.zip(before).map(|(view, before)| JudgedInstance {
            object_id: view.pose.object_id,
            instance: view.pose.instance,
            score: view.pose.score,
            initial: (view.pose.rotation_xyzw, view.pose.translation_m),
            crop: view.crop,
            before,
            after: after.next(),
        });
        Ok(JudgedFrame {
            frame: inputs.key().index,
            scene_id: views.header.scene_id,
            image_id: views.header.image_id,
            instances: instances.collect(),
            skipped: views.skipped.iter().map(ObjectPose::identity).collect(),
        })
    }
}

fn finite(value: f64) -> f64 {
    if value.is_finite() { value } else { 0.0 }
}

impl Node for JudgeNode {
    const KIND: &'static str = "judge";
    const ROLE: Role = Role::Sink;
    const KEEPS: bool = true;
    type Config = JudgeConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![VIEWS.spec(), FLOW.spec(), FLOW_AFTER.spec()]
    }

    fn outputs() -> Vec<PortSpec> {
        Vec::new()
    }

    fn check(config: &JudgeConfig) -> Result<(), NodeError> {
        config.solver.validate()?;
        match std::iter::once(&config.lines).chain(&config.verdict).find(|path| path.file_name().is_none()) {
            Some(path) => Err(format!("`{}`: give the name of a file", path.display()).into()),
            None => Ok(()),
        }
    }

    fn needs(config: &JudgeConfig) -> Vec<&'static str> {
        config.verdict.iter().map(|_| FLOW_AFTER.name()).collect()
    }

    fn create(config: JudgeConfig, context: &Context) -> Result<Self, NodeError> {
        let goes_on = context.restarts > 0;
        let lines = JsonLines::open(&config.lines, goes_on)?;
        let done = if goes_on { read_lines::<JudgedFrame>(&config.lines)? } else { Vec::new() };
        Ok(Self {
            solver: CropSolver::new(config.solver.clone()),
            gate: Gate::new(),
            blocks_across: GateConfig::default().blocks_across,
            lines,
            done: done.iter().map(|frame| frame.frame).collect(),
            config,
        })
    }

    fn objects(inputs: &dyn Inputs) -> Option<usize> {
        Some(VIEWS.read(inputs).ok()?.objects())
    }

    fn process(&mut self, inputs: &dyn Inputs, _: &mut dyn Outputs, context: &Context) -> Result<(), NodeError> {
        if self.done.insert(inputs.key().index) {
            let judged = self.judge(inputs, context.seed)?;
            self.lines.write(&judged)?;
        }
        Ok(())
    }

    fn finish(&mut self, context: &Context) -> Result<(), NodeError> {
        let Some(path) = &self.config.verdict else { return Ok(()) };
        let frames = read_lines::<JudgedFrame>(&self.config.lines)?;
        let verdict = Verdict::of(&frames, &mut context.rng(0, "bootstrap"));
        let verdict =
            verdict.ok_or("no frame has an initial pose that could be refined: there is nothing to compare")?;
        let text = serde_json::to_vec_pretty(&verdict)?;
        pseudoflow_files::write_private(path, &text)
            .map_err(|error| format!("{}: cannot be written: {error}", path.display()).into())
    }
}
