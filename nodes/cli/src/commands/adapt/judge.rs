//! Whether a training made the network better, told without any truth: on held-out frames, by how well flow and pictures
//! agree with the refined poses.

use super::{Args, training};
use crate::pipeline::{Judged, Pipeline, PipelineConfig};
use anyhow::{Context as _, Result, anyhow, ensure};
use pseudoflow_flow::FlowConfig;
use pseudoflow_geometry::{Crop, Intrinsics};
use pseudoflow_imaging::{RgbImage, resample};
use pseudoflow_inference::EngineConfig;
use pseudoflow_msgs::CameraFrame;
use pseudoflow_player::{InitialPoses, PlayerConfig, PlayerNode, Sampling};
use pseudoflow_pnp::PnpNodeConfig;
use pseudoflow_renderer::RendererConfig;
use pseudoflow_runtime::{Context, InMemory, Node, Produced, read};
use rand::Rng;
use serde::Serialize;
use std::path::Path;

/// At most this many held-out frames are refined.
const MOST_FRAMES: usize = 80;
/// Fewer held-out frames say nothing.
const LEAST_FRAMES: usize = 5;
/// The lower end of the gain's interval must be above this.
const LEAST_GAIN: f64 = 0.002;
const RESAMPLINGS: usize = 2000;
/// Width and height of the pictures of the report.
pub(super) const PANEL_PX: u32 = 220;

/// One held-out instance, refined from the same initial pose with both networks.
pub(super) struct Case {
    pub(super) scene_id: u32,
    pub(super) image_id: u32,
    /// The real crop, to show.
    pub(super) crop: RgbImage,
    pub(super) crop_intrinsics: Intrinsics,
    pub(super) before: Judged,
    pub(super) after: Judged,
}

impl Case {
    /// What the pictures alone say. The inlier ratio is a network's agreement with itself, and grows when it learns to
    /// repeat itself.
    pub(super) fn gain(&self) -> f64 {
        seen(&self.after) - seen(&self.before)
    }
}

/// How well the pictures agree with a pose.
fn seen(judged: &Judged) -> f64 {
    judged.photometric + judged.silhouette
}

/// What the held-out frames say.
#[derive(Serialize)]
pub(super) struct Verdict {
    pub(super) frames: usize,
    pub(super) instances: usize,
    /// Mean agreement of the pictures with the poses, by the weights that went in.
    pub(super) before: f64,
    /// By those that came out.
    pub(super) after: f64,
    /// 95 % interval of the mean gain, drawn by frames.
    pub(super) interval: [f64; 2],
    pub(super) inlier_ratio: [f64; 2],
    pub(super) photometric: [f64; 2],
    pub(super) silhouette: [f64; 2],
    #[serde(skip)]
    pub(super) cases: Vec<Case>,
}

impl Verdict {
    /// A gain that chance does not explain and that somebody could notice.
    pub(super) fn better(&self) -> bool {
        self.frames >= LEAST_FRAMES && self.interval[0] > LEAST_GAIN
    }

    pub(super) fn text(&self) -> String {
        let row = |name: &str, [a, b]: [f64; 2]| format!("{name:32} {a:>8.3} {b:>8.3}\n");
        format!(
            "held out: {} instances in {} frames\n{:32} {:>8} {:>8}\n{}{}{}{}gain {:+.3}, 95 % interval {:+.3} .. {:+.3}: {}",
            self.instances,
            self.frames,
            "",
            "before",
            "after",
            row("inlier ratio (does not count)", self.inlier_ratio),
            row("correlation with the picture", self.photometric),
            row("contrast across the contour", self.silhouette),
            row("agreement (sum of these two)", [self.before, self.after]),
            self.after - self.before,
            self.interval[0],
            self.interval[1],
            match self.frames < LEAST_FRAMES {
                true => "too few frames to tell",
                false if self.better() => "better",
                false => "not better",
            },
        )
    }
}

pub(super) fn boxed(error: pseudoflow_runtime::NodeError) -> anyhow::Error {
    anyhow!("{error}")
}

pub(super) fn context(args: &Args) -> Context {
    let out_dir = std::env::temp_dir();
    Context { name: "judge".into(), seed: args.seed, out_dir, restarts: 0, replay: true }
}

pub(super) fn pipeline(args: &Args, weights: &Path) -> Result<Pipeline> {
    Pipeline::open(PipelineConfig {
        views: Some((
            RendererConfig::new(args.objects.clone(), args.size),
            FlowConfig {
                model: weights.to_owned(),
                network: super::super::export::network(&args.network)?,
                size_px: args.size,
                iterations: None,
                max_batch: 16,
                device: args.device,
                engine: EngineConfig::default(),
                lockstep: None,
            },
        )),
        pnp: PnpNodeConfig::default(),
        seed: args.seed,
    })
}

fn player(args: &Args) -> Result<PlayerNode> {
    player_with(args, training::initial_poses(args))
}

/// The recordings from begin to end, with initial poses of a topic or a file.
pub(super) fn player_with(args: &Args, (topic, file): (Option<String>, Option<String>)) -> Result<PlayerNode> {
    let config = PlayerConfig {
        also: args.bags[1..].to_vec(),
        objects: Some(args.objects.clone()),
        initial_poses: InitialPoses { topic, file: file.map(Into::into) },
        only_objects: args.only_objects.clone(),
        ..PlayerConfig::new(args.bags[0].clone())
    };
    PlayerNode::create(config, &context(args)).map_err(boxed)
}

/// Refines the held-out frames with the weights that went in and those that came out.
pub(super) fn judge(args: &Args, trained: &Path) -> Result<Verdict> {
    let mut player = player(args)?;
    let held_out = Sampling::holding_out(args.held_out_every);
    let numbers: Vec<usize> = (0..player.count()).filter(|number| held_out.is_held_out(*number)).collect();
    let every = numbers.len().div_ceil(MOST_FRAMES).max(1);
    let numbers: Vec<usize> = numbers.into_iter().step_by(every).collect();
    let (mut before, mut after) = (pipeline(args, &args.weights)?, pipeline(args, trained)?);
    let bar = super::super::progress_bar(numbers.len() as u64, "judging");
    let mut frames: Vec<Vec<Case>> = Vec::new();
    for number in numbers {
        let mut messages = InMemory::default();
        let produced = player.produce(number as u64, &mut messages, &context(args)).map_err(boxed)?;
        ensure!(matches!(produced, Produced::Frame(_)), "frame {number} could not be read again");
        frames.push(cases(&messages, before.judge(&messages)?, after.judge(&messages)?)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    frames.retain(|cases| !cases.is_empty());
    ensure!(
        !frames.is_empty(),
        "no held-out frame has an initial pose: give more frames, or a smaller `--held-out-every`"
    );
    Ok(verdict(frames, &context(args)))
}

fn cases(messages: &InMemory, before: Vec<Judged>, after: Vec<Judged>) -> Result<Vec<Case>> {
    let frame = read::<CameraFrame<'static>>(messages, "frame").map_err(boxed)?;
    let header = frame.header;
    let image = RgbImage::from_raw(header.width, header.height, frame.rgb.to_vec()).context("the frame is cut off")?;
    let [fx, fy, cx, cy] = header.intrinsics;
    let case = |(before, after): (Judged, Judged)| {
        let [x0, y0, side] = before.crop;
        let crop = Crop { x0, y0, side, size_px: PANEL_PX };
        Case {
            scene_id: header.scene_id,
            image_id: header.image_id,
            crop: resample(&image, &crop),
            crop_intrinsics: crop.intrinsics(&Intrinsics { fx, fy, cx, cy }),
            before,
            after,
        }
    };
    Ok(before.into_iter().zip(after).map(case).collect())
}

fn verdict(frames: Vec<Vec<Case>>, context: &Context) -> Verdict {
    let interval = interval(&frames, context);
    let count = frames.len();
    let cases: Vec<Case> = frames.into_iter().flatten().collect();
    let mean = |value: &dyn Fn(&Case) -> f64| cases.iter().map(value).sum::<f64>() / cases.len() as f64;
    let both = |part: fn(&Judged) -> f64| [mean(&|c| part(&c.before)), mean(&|c| part(&c.after))];
    Verdict {
        frames: count,
        instances: cases.len(),
        before: mean(&|c| seen(&c.before)),
        after: mean(&|c| seen(&c.after)),
        interval,
        inlier_ratio: both(|j| j.pose.score),
        photometric: both(|j| j.photometric),
        silhouette: both(|j| j.silhouette),
        cases,
    }
}

/// Bootstrap over frames: instances of a frame share light, blur and occluders.
fn interval(frames: &[Vec<Case>], context: &Context) -> [f64; 2] {
    let sums: Vec<(f64, f64)> =
        frames.iter().map(|cases| (cases.iter().map(Case::gain).sum(), cases.len() as f64)).collect();
    let mut rng = context.rng(0, "bootstrap");
    let mut means: Vec<f64> = (0..RESAMPLINGS)
        .map(|_| {
            let drawn = (0..sums.len()).map(|_| sums[rng.random_range(0..sums.len())]);
            let (gain, count) = drawn.fold((0.0, 0.0), |all, one| (all.0 + one.0, all.1 + one.1));
            gain / count
        })
        .collect();
    means.sort_by(f64::total_cmp);
    [means[RESAMPLINGS / 40], means[RESAMPLINGS - 1 - RESAMPLINGS / 40]]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(before: f64, after: f64) -> Case {
        let judged = |agreement| Judged {
            initial: bytemuck::Zeroable::zeroed(),
            pose: bytemuck::Zeroable::zeroed(),
            agreement: 0.0,
            photometric: agreement,
            silhouette: 0.0,
            crop: [0.0; 3],
        };
        let crop_intrinsics = Intrinsics { fx: 1.0, fy: 1.0, cx: 0.0, cy: 0.0 };
        let (before, after) = (judged(before), judged(after));
        Case { scene_id: 0, image_id: 0, crop: RgbImage::new(1, 1), crop_intrinsics, before, after }
    }

    fn of(gains: impl Iterator<Item = f64>) -> Verdict {
        let context = Context { name: "judge".into(), seed: 1, out_dir: "/".into(), restarts: 0, replay: true };
        verdict(gains.map(|gain| vec![case(1.0, 1.0 + gain)]).collect(), &context)
    }

    #[test]
    fn a_gain_counts_only_when_its_interval_is_above_zero() {
        let better = of((0..40).map(|i| 0.1 + 0.02 * f64::from(i % 5)));
        assert!(better.better() && better.interval[0] > 0.09, "{:?}", better.interval);
        let noise = of((0..40).map(|i| if i % 2 == 0 { 0.3 } else { -0.29 }));
        assert!(!noise.better(), "{:?}", noise.interval);
        assert!(!of((0..40).map(|_| -0.1)).better());
        assert!(!of((0..40).map(|_| 0.001)).better(), "nobody would notice");
        assert!(!of((0..4).map(|_| 0.5)).better(), "too few frames");
    }

    #[test]
    fn frames_are_drawn_whole() {
        // One frame with many instances is one observation.
        let context = Context { name: "judge".into(), seed: 1, out_dir: "/".into(), restarts: 0, replay: true };
        let frames = vec![(0..50).map(|_| case(0.0, 0.2)).collect(), vec![case(0.0, -0.2)], vec![case(0.0, -0.2)]];
        assert!(!verdict(frames, &context).better());
    }
}
