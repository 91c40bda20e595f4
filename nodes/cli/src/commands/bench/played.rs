//! What a graph beside a recording does while it runs, and what it did.

use anyhow::{Context as _, Result, bail, ensure};
use pseudoflow_evaluator::live::{Arrival, Arrivals, LiveRun, NodeCost, read_arrivals};
use pseudoflow_imaging::ObjectSet;
use pseudoflow_player::{PlayerConfig, open_recording};
use pseudoflow_runtime::Graph;
use pseudoflow_runtime::supervisor::{self, Below, NodeSummary, Options};
use std::collections::{BTreeMap, VecDeque};
use std::fmt::Write as _;
use std::path::Path;
use std::sync::{Arc, Mutex};

/// Runs a graph with a player and a stopwatch that writes to `arrivals`. `None` when it was asked to stop.
pub(crate) fn play(graph: &Graph, folder: &Path, arrivals: &Path, objects: &ObjectSet) -> Result<Option<LiveRun>> {
    let player = player(graph)?;
    let (hz, frames) = (player.hz.context("the graph's player needs `hz`")?, frames(&player)?);
    for leftover in [folder, arrivals] {
        remove(leftover)?;
    }
    let now = Now::new(arrivals, objects, hz);
    let below = Below(Some(Arc::new(move || now.table())));
    let summary = supervisor::run(graph, &crate::registry(), &Options { below, ..Options::new(folder) })?;
    let run = LiveRun {
        source: player.source.display().to_string(),
        graph: graph.file.display().to_string(),
        hz,
        nodes: summary.nodes.iter().map(|node| (node.name.clone(), cost(node, frames.len()))).collect(),
        frames,
        arrivals: read_arrivals(arrivals)?,
        startup_s: summary.startup_s.unwrap_or(0.0),
    };
    Ok(Some(run).filter(|_| !summary.asked_to_stop))
}

fn remove(leftover: &Path) -> Result<()> {
    let removed = if leftover.is_dir() { std::fs::remove_dir_all(leftover) } else { std::fs::remove_file(leftover) };
    match removed {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(error).with_context(|| format!("{}: cannot be replaced", leftover.display()))
        }
        _ => Ok(()),
    }
}

/// The settings of a graph's player.
pub(crate) fn player(graph: &Graph) -> Result<PlayerConfig> {
    let resolved = graph.resolved().map_err(pseudoflow_runtime::GraphError::Problems)?;
    let Some(spec) = resolved.nodes.values().find(|spec| spec.kind == "player") else {
        bail!("{}: there is no player", graph.file.display());
    };
    Ok(serde_yaml::from_value(spec.config.clone())?)
}

/// Scene and image of each frame that a player plays.
fn frames(player: &PlayerConfig) -> Result<Vec<(u32, u32)>> {
    let mut source = open_recording(player)?;
    let count = source.count() as u64;
    let played = (0..).map_while(|index| player.number_at(index, count));
    let ids = played.map(|n| source.facts(n as usize).map(|facts| (facts.scene_id, facts.image_id)));
    let ids = ids.collect::<Result<Vec<_>, _>>()?;
    ensure!(!ids.is_empty(), "{}: no frame in it", player.source.display());
    Ok(ids)
}

fn cost(node: &NodeSummary, frames: usize) -> NodeCost {
    NodeCost {
        cpu_ms_per_frame: node.cpu_ms[1] / frames.max(1) as f64,
        startup_cpu_ms: node.cpu_ms[0],
        frames: node.frames,
        work_ms: node.work_ms,
    }
}

/// What has come of late, by object.
struct Now {
    names: BTreeMap<u32, String>,
    /// Answers that make a second.
    second: usize,
    seen: Mutex<(Arrivals, VecDeque<Arrival>)>,
}

impl Now {
    fn new(arrivals: &Path, objects: &ObjectSet, hz: f64) -> Self {
        Self {
            names: objects.iter().map(|object| (object.id, object.name.clone())).collect(),
            second: (hz.ceil() as usize).max(1),
            seen: Mutex::new((Arrivals::new(arrivals.to_owned()), VecDeque::new())),
        }
    }

    /// A line for each object: poses in the last second of the camera's time, confidence and age of the newest, its track.
    fn table(&self) -> String {
        let Ok(mut seen) = self.seen.lock() else { return String::new() };
        let (arrivals, recent) = &mut *seen;
        recent.extend(arrivals.more());
        let begin = recent.back().map_or(0, |newest| newest.stamp_ns - 1_000_000_000);
        while recent.len() > self.second || recent.front().is_some_and(|arrival| arrival.stamp_ns < begin) {
            recent.pop_front();
        }
        let mut text = format!("{:22} {:>7} {:>10} {:>7}  {}\n", "object", "poses/s", "confidence", "age ms", "track");
        for (id, name) in &self.names {
            text += &line(*id, name, recent);
        }
        text
    }
}

fn line(id: u32, name: &str, recent: &VecDeque<Arrival>) -> String {
    let pose = |arrival: &Arrival| arrival.poses.iter().find(|p| p.object_id == id && p.published).map(|p| p.score);
    let count = recent.iter().filter(|arrival| pose(arrival).is_some()).count();
    let newest = recent.iter().rev().find_map(|arrival| Some((pose(arrival)?, arrival.age_ms)));
    let (confidence, age) =
        newest.map_or(("-".to_owned(), "-".to_owned()), |(score, ms)| (format!("{score:.2}"), format!("{ms:.0}")));
    let track = recent.back().and_then(|arrival| arrival.tracks.get(&id)).map_or("", String::as_str);
    let mut text = String::new();
    let _ = writeln!(text, "{name:22} {count:>7} {confidence:>10} {age:>7}  {track}");
    text
}
