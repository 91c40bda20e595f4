use super::verdict::{Verdict, Yardstick, verdicts};
use super::{Arrival, Expectation, HIDDEN_BELOW, HIDDEN_LONG_S, ON_TIME_MS};
use crate::EvalError;
use pseudoflow_imaging::ObjectSet;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// What happened: the frames that were played, and what came of them.
#[derive(Debug, Clone, Default)]
pub struct LiveRun {
    /// What was played.
    pub source: String,
    /// The graph that it was played into.
    pub graph: String,
    /// Frames per second at which it was played.
    pub hz: f64,
    /// Scene and image of each frame, in the order played.
    pub frames: Vec<(u32, u32)>,
    /// What came, by frame.
    pub arrivals: Vec<Arrival>,
    /// From the start of the processes to the first frame, seconds.
    pub startup_s: f64,
    /// What each node used, in the graph's order.
    pub nodes: Vec<(String, NodeCost)>,
}

/// What a node's process used.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct NodeCost {
    /// CPU milliseconds of all its threads for each frame that was played.
    pub cpu_ms_per_frame: f64,
    /// CPU milliseconds before it was ready.
    pub startup_cpu_ms: f64,
    /// Frames that it handled.
    pub frames: u64,
    /// Milliseconds in a frame: median and 99th percentile.
    pub work_ms: Option<[f64; 2]>,
}

/// How a graph did beside a camera.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct LiveReport {
    /// What was played.
    pub source: String,
    /// The graph that it was played into.
    pub graph: String,
    /// Cores of the computer.
    pub cores: usize,
    /// Frames per second at which it was played.
    pub hz: f64,
    /// Frames that were played.
    pub frames: usize,
    /// Frames whose poses came, none included.
    pub answered: usize,
    /// From the start of the processes to the first frame, seconds.
    pub startup_s: f64,
    /// From when the first frame was due to the first published pose of any object: here the steady state begins.
    pub steady_from_s: Option<f64>,
    /// Published poses per second of each object in the steady state, by name.
    pub published_per_s: BTreeMap<String, f64>,
    /// From when a frame was due to when its poses were here; steady state.
    pub latency_ms: Option<Latency>,
    /// Share of the frames played in the steady state that had a pose within 100 ms; where it is known what is visible, of the
    /// frames in which something is.
    pub on_time: Option<f64>,
    /// CPU milliseconds of all nodes for each frame that was played.
    pub cpu_ms_per_frame: f64,
    /// Cores in use on average from the first frame to the end of the recording or, if later, the last answer.
    pub cores_used: f64,
    /// By node, in the graph's order.
    pub nodes: Vec<(String, NodeCost)>,
    /// ADD(-S) below 0.1 diameters; `None` where it is not known what is right.
    #[serde(rename = "add_s_recall_0.1d")]
    pub recall_10: Option<Recall>,
    /// ADD(-S) below 0.05 diameters.
    #[serde(rename = "add_s_recall_0.05d")]
    pub recall_5: Option<Recall>,
    /// By object name.
    pub objects: BTreeMap<String, ObjectReport>,
    /// For the page: by object, a letter for each frame (see [`ObjectReport::timeline`]), and the age of each answer.
    pub ages_ms: Vec<Option<f64>>,
}

/// Milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Latency {
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Longest.
    pub max: f64,
}

/// Shares of visible instances with a right pose; what is missing is wrong.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Recall {
    /// Visible instances in all frames that were played, dropped ones included.
    pub n: usize,
    /// Of all of them.
    pub all: f64,
    /// Of those in frames of the steady state.
    pub steady: Option<f64>,
    /// Of those in frames that were answered at all.
    pub answered: Option<f64>,
    /// Of those in answered frames that are at least 60 % visible.
    pub answered_60_visible: Option<f64>,
}

/// How soon an object was found.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct FirstPose {
    /// From when the first frame was due to its first published pose, seconds.
    pub published_s: Option<f64>,
    /// To the first that is within 0.1 diameters.
    pub right_s: Option<f64>,
}

/// An object that was hidden and came back.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Reacquired {
    /// First frame in which it was hidden.
    pub hidden_from: usize,
    /// First frame in which it is visible again.
    pub visible_from: usize,
    /// From when that frame was due to when a pose within 0.1 diameters was here; `None`: never before it was hidden again.
    pub seconds: Option<f64>,
}

/// One object.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ObjectReport {
    /// How soon it was found.
    pub first_pose_s: FirstPose,
    /// Each time it came back.
    pub reacquired_s: Vec<Reacquired>,
    /// ADD(-S) below 0.1 diameters.
    #[serde(rename = "add_s_recall_0.1d")]
    pub recall_10: Option<Recall>,
    /// ADD(-S) below 0.05 diameters.
    #[serde(rename = "add_s_recall_0.05d")]
    pub recall_5: Option<Recall>,
    /// Frames in which it was hidden for longer than half a second and yet published as measured.
    pub claimed_while_hidden: usize,
    /// A letter for each frame played: `g` right, `y` within a tenth but not a twentieth of the diameter, `r` wrong, `p`
    /// published (unknown whether right), `m` visible and missing, `d` visible and the frame was dropped, `-` hidden or unknown.
    pub timeline: String,
}

impl LiveReport {
    /// Sets what came against what should have.
    ///
    /// # Errors
    /// When a mesh cannot be measured with, or a pose is none.
    pub fn new(run: &LiveRun, objects: &ObjectSet, expectation: Option<&Expectation>) -> Result<Self, EvalError> {
        let models = objects.iter().map(|o| Ok((o.id, Yardstick::new(o)?))).collect::<Result<_, EvalError>>()?;
        let names = objects.iter().map(|o| (o.id, o.name.clone())).collect();
        Self::of(run, &names, &models, expectation)
    }

    pub(crate) fn of(
        run: &LiveRun,
        names: &BTreeMap<u32, String>,
        models: &BTreeMap<u32, Yardstick>,
        expectation: Option<&Expectation>,
    ) -> Result<Self, EvalError> {
        let verdicts = expectation.map(|e| verdicts(run, e, models)).transpose()?;
        let seen = Seen::new(run, verdicts.as_deref());
        let steady_from_s = seen.steady_from_s;
        let steady: Vec<&Arrival> = run.arrivals.iter().filter(|a| seen.is_steady(a.index as usize)).collect();
        let seconds = run.frames.len() as f64 / run.hz;
        let cpu_ms_per_frame = run.nodes.iter().map(|(_, cost)| cost.cpu_ms_per_frame).sum();
        let rate = |id: u32| {
            let poses = steady.iter().flat_map(|a| &a.poses).filter(|p| p.object_id == id && p.published).count();
            steady_from_s.filter(|from| *from < seconds).map(|from| poses as f64 / (seconds - from))
        };
        let recall = |limit| verdicts.as_ref().map(|all| seen.recall(&all.iter().collect::<Vec<_>>(), limit));
        let named = |id: &u32| names.get(id).cloned().unwrap_or_else(|| id.to_string());
        Ok(Self {
            source: run.source.clone(),
            graph: run.graph.clone(),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            hz: run.hz,
            frames: run.frames.len(),
            answered: run.arrivals.len(),
            startup_s: run.startup_s,
            steady_from_s,
            published_per_s: names.keys().filter_map(|id| Some((named(id), rate(*id)?))).collect(),
            latency_ms: latency(steady.iter().map(|a| a.age_ms).collect()),
            on_time: seen.on_time(),
            cpu_ms_per_frame,
            cores_used: cpu_ms_per_frame * 1e-3 * run.frames.len() as f64 / seen.end_s().max(1e-9),
            nodes: run.nodes.clone(),
            recall_10: recall(0.1),
            recall_5: recall(0.05),
            objects: names.keys().map(|id| (named(id), seen.object(*id))).collect(),
            ages_ms: seen.ages_ms(),
        })
    }

    /// Writes `report.json`.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write_json(&self, path: &Path) -> Result<(), EvalError> {
        let text = serde_json::to_vec_pretty(self).map_err(std::io::Error::from);
        let written = text.and_then(|text| pseudoflow_files::write_private(path, &text));
        written.map_err(|source| EvalError::Io { path: path.to_owned(), source })
    }
}

fn latency(mut ages_ms: Vec<f64>) -> Option<Latency> {
    ages_ms.sort_by(f64::total_cmp);
    let max = *ages_ms.last()?;
    let at = |share: f64| ages_ms[((ages_ms.len() as f64 * share).ceil() as usize).clamp(1, ages_ms.len()) - 1];
    Some(Latency { p50: at(0.5), p99: at(0.99), max })
}

/// A run beside its verdicts.
struct Seen<'a> {
    run: &'a LiveRun,
    verdicts: Option<&'a [Verdict]>,
    /// When the first pose of all was published.
    steady_from_s: Option<f64>,
}

impl<'a> Seen<'a> {
    fn new(run: &'a LiveRun, verdicts: Option<&'a [Verdict]>) -> Self {
        let mut seen = Self { run, verdicts, steady_from_s: None };
        seen.steady_from_s = seen.first_published_s(None);
        seen
    }

    /// When a frame was due, seconds after the first.
    fn due_s(&self, frame: usize) -> f64 {
        frame as f64 / self.run.hz
    }

    fn came_s(&self, arrival: &Arrival) -> f64 {
        self.due_s(arrival.index as usize) + arrival.age_ms * 1e-3
    }

    /// When the last frame was over, or the last answer here.
    fn end_s(&self) -> f64 {
        let came = self.run.arrivals.iter().map(|arrival| self.came_s(arrival));
        came.fold(self.due_s(self.run.frames.len()), f64::max)
    }

    fn first_published_s(&self, object_id: Option<u32>) -> Option<f64> {
        let wanted = |id: u32| object_id.is_none_or(|wanted| wanted == id);
        let publishes = |a: &&Arrival| a.poses.iter().any(|p| p.published && wanted(p.object_id));
        self.run.arrivals.iter().filter(publishes).map(|a| self.came_s(a)).min_by(f64::total_cmp)
    }

    /// Whether a frame was due when the first pose had been published.
    fn is_steady(&self, frame: usize) -> bool {
        self.steady_from_s.is_some_and(|from| self.due_s(frame) >= from)
    }

    fn on_time(&self) -> Option<f64> {
        let frames = self.run.frames.len();
        let visible =
            |frame: usize| self.verdicts.is_none_or(|verdicts| verdicts.iter().any(|v| v.frame == frame && v.expected));
        let counted: Vec<usize> = (0..frames).filter(|f| self.is_steady(*f) && visible(*f)).collect();
        let in_time = |arrival: &Arrival| arrival.age_ms <= ON_TIME_MS && arrival.poses.iter().any(|p| p.published);
        let on_time = self.run.arrivals.iter().filter(|a| counted.contains(&(a.index as usize)) && in_time(a)).count();
        (!counted.is_empty()).then(|| on_time as f64 / counted.len() as f64)
    }

    fn recall(&self, verdicts: &[&Verdict], limit: f64) -> Recall {
        let share = |wanted: &dyn Fn(&Verdict) -> bool| {
            let of: Vec<&&Verdict> = verdicts.iter().filter(|v| v.expected && wanted(v)).collect();
            let right = of.iter().filter(|v| v.is_right(limit)).count();
            (of.len(), (!of.is_empty()).then(|| right as f64 / of.len() as f64))
        };
        let (n, all) = share(&|_| true);
        Recall {
            n,
            all: all.unwrap_or(0.0),
            steady: share(&|v| self.is_steady(v.frame)).1,
            answered: share(&|v| v.answered).1,
            answered_60_visible: share(&|v| v.answered && v.visible.is_none_or(|visible| visible >= 0.6)).1,
        }
    }

    fn object(&self, object_id: u32) -> ObjectReport {
        let verdicts: Option<Vec<&Verdict>> =
            self.verdicts.map(|all| all.iter().filter(|v| v.object_id == object_id).collect());
        let of = verdicts.as_deref().unwrap_or_default();
        let right = of.iter().filter(|v| v.is_right(0.1)).filter_map(|v| self.verdict_came_s(v));
        let recall = |limit| verdicts.as_ref().map(|of| self.recall(of, limit));
        ObjectReport {
            first_pose_s: FirstPose {
                published_s: self.first_published_s(Some(object_id)),
                right_s: right.min_by(f64::total_cmp),
            },
            reacquired_s: self.reacquired(of),
            recall_10: recall(0.1),
            recall_5: recall(0.05),
            claimed_while_hidden: self.claimed_while_hidden(of),
            timeline: self.timeline(object_id, verdicts.as_deref()),
        }
    }

    fn verdict_came_s(&self, verdict: &Verdict) -> Option<f64> {
        Some(self.due_s(verdict.frame) + verdict.age_ms? * 1e-3)
    }

    /// Spans of frames in which an object was hidden, `from..to`, each one open at the recording's end left out.
    fn hidden_spans(of: &[&Verdict]) -> Vec<(usize, usize)> {
        let (mut spans, mut from) = (Vec::new(), None);
        for verdict in of {
            let hidden = verdict.visible.is_some_and(|visible| visible < HIDDEN_BELOW);
            match (hidden, from) {
                (true, None) => from = Some(verdict.frame),
                (false, Some(begin)) => {
                    spans.push((begin, verdict.frame));
                    from = None;
                }
                _ => {}
            }
        }
        spans
    }

    fn reacquired(&self, of: &[&Verdict]) -> Vec<Reacquired> {
        let spans = Self::hidden_spans(of);
        let ends = spans.iter().skip(1).map(|(from, _)| *from).chain([usize::MAX]);
        let back = |((hidden_from, visible_from), end): (&(usize, usize), usize)| {
            let within = of.iter().filter(|v| (*visible_from..end).contains(&v.frame) && v.is_right(0.1));
            let came = within.filter_map(|v| self.verdict_came_s(v)).min_by(f64::total_cmp);
            let seconds = came.map(|came| came - self.due_s(*visible_from));
            Reacquired { hidden_from: *hidden_from, visible_from: *visible_from, seconds }
        };
        spans.iter().zip(ends).map(back).collect()
    }

    fn claimed_while_hidden(&self, of: &[&Verdict]) -> usize {
        let mut since = None;
        let claims = |verdict: &&&Verdict| {
            let hidden = verdict.visible.is_some_and(|visible| visible < HIDDEN_BELOW);
            since = hidden.then(|| since.unwrap_or(verdict.frame));
            since.is_some_and(|from| verdict.claimed && self.due_s(verdict.frame - from) > HIDDEN_LONG_S)
        };
        of.iter().filter(claims).count()
    }

    fn timeline(&self, object_id: u32, verdicts: Option<&[&Verdict]>) -> String {
        let mut letters = vec!['-'; self.run.frames.len()];
        for verdict in verdicts.unwrap_or_default().iter().filter(|v| v.expected) {
            letters[verdict.frame] = match verdict {
                v if v.is_right(0.05) => 'g',
                v if v.is_right(0.1) => 'y',
                v if v.error.is_some() => 'r',
                v if v.answered => 'm',
                _ => 'd',
            };
        }
        if verdicts.is_none() {
            let publishes = |a: &&Arrival| a.poses.iter().any(|p| p.published && p.object_id == object_id);
            let published = self.run.arrivals.iter().filter(publishes).map(|a| a.index as usize);
            published.filter(|i| *i < self.run.frames.len()).for_each(|i| letters[i] = 'p');
        }
        letters.into_iter().collect()
    }

    fn ages_ms(&self) -> Vec<Option<f64>> {
        let mut ages = vec![None; self.run.frames.len()];
        for arrival in &self.run.arrivals {
            if let Some(age) = ages.get_mut(arrival.index as usize) {
                *age = Some(arrival.age_ms);
            }
        }
        ages
    }
}
