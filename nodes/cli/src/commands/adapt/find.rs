//! Initial poses of recordings that have none: the initializer finds them, and what flow and picture do not confirm is left
//! out. No truth is involved.

use super::Args;
use super::judge::{boxed, context, pipeline, player_with};
use crate::pipeline::{Finder, Frame, Judged};
use anyhow::{Result, bail, ensure};
use pseudoflow_geometry::{pose_from_quaternion, rotation_angle_rad};
use pseudoflow_initializer::{CompareConfig, InitializerConfig};
use pseudoflow_metrics::{Estimate, ResultsWriter};
use pseudoflow_msgs::{AlignedBytes, CameraFrame, ObjectPose, ObjectPoses};
use pseudoflow_network::{FlowNetwork, NetworkConfig};
use pseudoflow_runtime::{InMemory, Node, Produced, read};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

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
    let mut player = player_with(args, (None, None))?;
    // The features of the flow network that is to be adapted tell the sides of the objects apart.
    let network = super::super::export::network(&args.network)?.of(&args.weights)?;
    let is_nano = matches!(&network, FlowNetwork::Raft(raft) if *raft == NetworkConfig::nano());
    let compare = is_nano.then(|| CompareConfig::new(args.weights.clone()));
    let config = InitializerConfig { compare, ..InitializerConfig::new(weights.to_owned(), args.objects.clone()) };
    let (mut finder, mut refiner) = (Finder::open(config, args.seed)?, pipeline(args, &args.weights)?);
    let part = file.with_extension("csv.part");
    let mut writer = ResultsWriter::create(&part)?;
    let step = search_step(player.count() as u64, args.budget_frames, args.held_out_every) as usize;
    let bar = super::super::progress_bar(player.count().div_ceil(step) as u64, "finding");
    let (mut found, mut kept, mut images) = (0, 0, BTreeSet::new());
    for number in (0..player.count()).step_by(step) {
        let mut messages = InMemory::default();
        let produced = player.produce(number as u64, &mut messages, &context(args)).map_err(boxed)?;
        ensure!(matches!(produced, Produced::Frame(_)), "frame {number} could not be read");
        let frame = read::<CameraFrame<'static>>(&messages, "frame").map_err(boxed)?;
        let (header, index) = (*frame.header, number as u64);
        if !images.insert((header.scene_id, header.image_id)) {
            bail!(
                "two frames are scene {}, image {}: adapt to one recording at a time",
                header.scene_id,
                header.image_id
            );
        }
        let poses = finder.find(&Frame { header, rgb: frame.rgb, index })?;
        let poses: Vec<ObjectPose> = poses.into_iter().filter(|pose| wanted(args, pose)).collect();
        put(&mut messages, (header.scene_id, header.image_id), &poses);
        let judged = refiner.judge(&messages)?;
        let estimates: Vec<Estimate> = believed(&judged)
            .into_iter()
            .map(|pose| estimate((header.scene_id, header.image_id), pose))
            .collect::<Result<_>>()?;
        (found, kept) = (found + ObjectPose::likeliest(&poses).count(), kept + estimates.len());
        writer.write_image(&estimates)?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    println!("initializer: {found} objects in {} frames, {kept} of them confirmed by flow and picture", images.len());
    ensure!(kept > 0, "nothing to adapt to: the initializer finds no object that flow and picture confirm");
    std::fs::rename(&part, &file)?;
    Ok(file)
}

/// Every how manieth frame is searched. All without a budget; with one, twice as many as it allows, for some show nothing that
/// can be believed, and some are held out: the step meets those in turn.
fn search_step(frames: u64, budget: Option<u64>, held_out_every: u64) -> u64 {
    let most = budget.map_or(1, |budget| frames / (2 * budget.max(1))).max(1);
    let coprime =
        |step: &u64| !(2..=held_out_every).any(|d| step.is_multiple_of(d) && held_out_every.is_multiple_of(d));
    (1..=most).rev().find(coprime).unwrap_or(1)
}

/// Of each instance the pose whose refinement flow and picture agree with best, if they agree at all.
fn believed(judged: &[Judged]) -> Vec<&ObjectPose> {
    let mut best: BTreeMap<(u32, u32), &Judged> = BTreeMap::new();
    for judged in judged {
        let kept = best.entry(judged.pose.identity()).or_insert(judged);
        if judged.agreement > kept.agreement {
            *kept = judged;
        }
    }
    let plausible = |j: &&Judged| j.agreement >= LEAST_AGREEMENT && turn_deg(&j.initial, &j.pose) < LARGEST_TURN_DEG;
    best.into_values().filter(plausible).map(|judged| &judged.initial).collect()
}

fn wanted(args: &Args, pose: &ObjectPose) -> bool {
    args.only_objects.as_ref().is_none_or(|wanted| wanted.contains(&pose.object_id))
}

/// Replaces the poses of a frame.
fn put(messages: &mut InMemory, (scene_id, image_id): (u32, u32), poses: &[ObjectPose]) {
    let mut bytes = AlignedBytes::zeroed(ObjectPoses::byte_len(poses.len()));
    ObjectPoses::write(&mut bytes, scene_id, image_id, poses);
    messages.messages.retain(|(port, _)| port != "initial_poses");
    messages.messages.push(("initial_poses".into(), bytes));
}

fn turn_deg(a: &ObjectPose, b: &ObjectPose) -> f64 {
    let pose = |p: &ObjectPose| pose_from_quaternion(&p.rotation_xyzw, &p.translation_m);
    match (pose(a), pose(b)) {
        (Ok(a), Ok(b)) => rotation_angle_rad(&a, &b).to_degrees(),
        _ => f64::INFINITY,
    }
}

fn estimate((scene_id, image_id): (u32, u32), pose: &ObjectPose) -> Result<Estimate> {
    Ok(Estimate {
        scene_id,
        image_id,
        object_id: pose.object_id,
        score: pose.score,
        camera_from_object: pose_from_quaternion(&pose.rotation_xyzw, &pose.translation_m)?.into(),
        image_time_s: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_budget_leaves_frames_out_but_not_only_those_that_are_held_out() {
        assert_eq!(search_step(330, None, 5), 1);
        assert_eq!(search_step(330, Some(200), 5), 1);
        assert_eq!(search_step(330, Some(80), 5), 2);
        // 5 and 10 would meet the same place of every five frames.
        assert_eq!(search_step(1000, Some(100), 5), 4);
        assert_eq!(search_step(1000, Some(50), 5), 9);
    }
}
