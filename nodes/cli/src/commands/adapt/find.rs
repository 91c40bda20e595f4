//! Initial poses of recordings that have none: a graph finds them and refines them, and what flow and picture do not confirm is
//! left out. No truth is involved.

use super::Args;
use anyhow::{Result, bail, ensure};
use pseudoflow_cli::graphs::network;
use pseudoflow_cli::in_process::Written;
use pseudoflow_geometry::{Pose, pose_from_quaternion, rotation_angle_rad};
use pseudoflow_initializer::CompareConfig;
use pseudoflow_metrics::{Estimate, ResultsWriter};
use pseudoflow_network::{FlowNetwork, NetworkConfig};
use pseudoflow_player::{FrameSource, open_recording};
use pseudoflow_pnp::judge::{JudgedFrame, JudgedInstance};
use pseudoflow_runtime::{Graph, Stride, read_lines};
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroU64;
use std::path::{Path, PathBuf};

const GRAPH: &str = include_str!("../../../../../config/graphs/confirm.yaml");

/// The file in the training's folder.
const FOUND: &str = "initial_poses.csv";

/// A pose is plausible when flow and picture agree with its refinement as they do with seen objects (pnp's `min_seen`).
const LEAST_AGREEMENT: f64 = 1.1;
/// And when the refinement does not turn it further than the flow network was trained for.
const LARGEST_TURN_DEG: f64 = 45.0;

/// The initializer's weights, if they are what `--init` names.
pub(super) fn initializer(args: &Args) -> Option<&Path> {
    let path = args.init.as_deref().map(Path::new)?;
    path.extension().is_some_and(|extension| extension == "safetensors").then_some(path)
}

/// Searches the frames and writes the poses that can be believed (a BOP result file). Done once for a training.
pub(super) fn find(args: &Args, weights: &Path, folder: &Path) -> Result<PathBuf> {
    let file = folder.join(FOUND);
    if file.is_file() {
        return Ok(file);
    }
    ensure!(weights.is_file(), "`--init {}`: no such file", weights.display());
    let mut recordings = open_recording(&args.recordings())?;
    let count = recordings.count() as u64;
    let frames =
        Stride { start: 0, step: search_step(count, args.training.budget_frames, args.training.held_out_every) };
    check_images(&mut *recordings, frames.numbers(count))?;
    let lines = folder.join("found.jsonl");
    let written = Written { graph: &graph(args, weights, frames, &lines)?, file: &folder.join("confirm.yaml") };
    written.run(&crate::registry(), "finding", frames.count(count), 0)?;
    write(&read_lines(&lines)?, &file)?;
    Ok(file)
}

/// Poses in a result file belong to a scene and an image.
fn check_images(recordings: &mut dyn FrameSource, numbers: impl Iterator<Item = u64>) -> Result<()> {
    let mut images = BTreeSet::new();
    for number in numbers {
        let facts = recordings.facts(number as usize)?;
        let (scene, image) = (facts.scene_id, facts.image_id);
        if !images.insert((scene, image)) {
            bail!("two frames are scene {scene}, image {image}: adapt to one recording at a time");
        }
    }
    Ok(())
}

fn graph(args: &Args, initializer: &Path, frames: Stride, lines: &Path) -> Result<Graph> {
    let mut graph = Graph::parse(GRAPH, Path::new("config/graphs/confirm.yaml"))?;
    let network = network(&args.training.network)?;
    graph.set_params(&json!({
        "source": args.training.bags[0],
        "also": args.training.bags[1..],
        "frames": frames,
        "objects": args.training.objects,
        "initializer": initializer,
        "weights": args.training.weights,
        "network": network,
        "device": args.training.device,
        "size_px": args.training.size,
        "lines": lines,
    }))?;
    args.only_objects(&mut graph, "initializer")?;
    // The features of the flow network that is to be adapted tell the sides of the objects apart.
    if matches!(network.of(&args.training.weights)?, FlowNetwork::Raft(raft) if raft == NetworkConfig::nano()) {
        graph.set("initializer.compare", &json!(CompareConfig::new(args.training.weights.clone())).to_string())?;
    }
    Ok(graph)
}

/// Writes what can be believed, and says how much that is.
fn write(frames: &[JudgedFrame], file: &Path) -> Result<()> {
    let part = file.with_extension("csv.part");
    let mut writer = ResultsWriter::create(&part)?;
    let (mut found, mut kept) = (0, 0);
    for frame in frames {
        let estimates: Vec<Estimate> =
            believed(&frame.instances)?.into_iter().map(|(of, pose)| estimate(frame, of, pose)).collect();
        let seen = frame.instances.iter().map(JudgedInstance::identity);
        found += seen.chain(frame.skipped.iter().copied()).collect::<BTreeSet<_>>().len();
        kept += estimates.len();
        writer.write_image(&estimates)?;
    }
    println!("initializer: {found} objects in {} frames, {kept} of them confirmed by flow and picture", frames.len());
    ensure!(kept > 0, "nothing to adapt to: the initializer finds no object that flow and picture confirm");
    Ok(std::fs::rename(&part, file)?)
}

/// Every how manieth frame is searched. All without a budget; with one, twice as many as it allows, for some show nothing that
/// can be believed, and some are held out: the step meets those in turn.
fn search_step(frames: u64, budget: Option<u64>, held_out_every: u64) -> NonZeroU64 {
    let most = budget.map_or(1, |budget| frames / (2 * budget.max(1))).max(1);
    let coprime =
        |step: &u64| !(2..=held_out_every).any(|d| step.is_multiple_of(d) && held_out_every.is_multiple_of(d));
    (1..=most).rev().find(coprime).and_then(NonZeroU64::new).unwrap_or(NonZeroU64::MIN)
}

/// Of each instance the initial pose whose refinement flow and picture agree with best, if they agree at all.
fn believed(judged: &[JudgedInstance]) -> Result<Vec<(&JudgedInstance, Pose)>> {
    let mut best: BTreeMap<(u32, u32), &JudgedInstance> = BTreeMap::new();
    for judged in judged {
        let kept = best.entry(judged.identity()).or_insert(judged);
        if judged.before.agreement() > kept.before.agreement() {
            *kept = judged;
        }
    }
    let mut believed = Vec::new();
    for judged in best.into_values().filter(|judged| judged.before.agreement() >= LEAST_AGREEMENT) {
        let [initial, refined] = [&judged.initial, &judged.before.pose].map(|(q, t)| pose_from_quaternion(q, t));
        let (initial, refined) = (initial?, refined?);
        if rotation_angle_rad(&initial, &refined).to_degrees() < LARGEST_TURN_DEG {
            believed.push((judged, initial));
        }
    }
    Ok(believed)
}

fn estimate(frame: &JudgedFrame, of: &JudgedInstance, initial: Pose) -> Estimate {
    Estimate {
        scene_id: frame.scene_id,
        image_id: frame.image_id,
        object_id: of.object_id,
        score: of.score,
        camera_from_object: initial.into(),
        image_time_s: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(frames: u64, budget: Option<u64>) -> u64 {
        search_step(frames, budget, 5).get()
    }

    #[test]
    fn a_budget_leaves_frames_out_but_not_only_those_that_are_held_out() {
        assert_eq!(step(330, None), 1);
        assert_eq!(step(330, Some(200)), 1);
        assert_eq!(step(330, Some(80)), 2);
        // 5 and 10 would meet the same place of every five frames.
        assert_eq!(step(1000, Some(100)), 4);
        assert_eq!(step(1000, Some(50)), 9);
    }
}
