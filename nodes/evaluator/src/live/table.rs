//! The report as people read it in a terminal.

use super::{LiveReport, Recall};
use std::fmt;

fn seconds(value: Option<f64>) -> String {
    value.map_or_else(|| "-".into(), |s| format!("{s:.2}"))
}

fn share(value: Option<f64>) -> String {
    value.map_or_else(|| "-".into(), |share| format!("{share:.2}"))
}

impl fmt::Display for LiveReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { frames, hz, answered, cores, startup_s, .. } = self;
        writeln!(
            f,
            "\n{frames} frames at {hz} Hz, {answered} answered; {cores} cores; {startup_s:.1} s until all nodes were ready"
        )?;
        self.write_objects(f)?;
        self.write_nodes(f)?;
        if let Some(latency) = &self.latency_ms {
            let on_time = share(self.on_time);
            writeln!(
                f,
                "latency p50 {:.1} ms, p99 {:.1} ms, max {:.1} ms; on time (100 ms): {on_time}",
                latency.p50, latency.p99, latency.max
            )?;
        }
        if let Some(recall) = &self.recall_10 {
            let Recall { n, answered_60_visible, .. } = recall;
            let visible = share(*answered_60_visible);
            writeln!(
                f,
                "all {n} visible instances: see `report.json`; at least 60 % visible, in answered frames: {visible}"
            )?;
        }
        Ok(())
    }
}

impl LiveReport {
    fn write_objects(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:22} {:>7} {:>9} {:>9} {:>8} {:>8} {:>9} {:>12}",
            "object", "poses/s", "first s", "right s", "0.1d", "0.05d", "answered", "again after"
        )?;
        for (name, object) in &self.objects {
            let rate = self.published_per_s.get(name).map_or_else(|| "-".into(), |rate| format!("{rate:.1}"));
            let again: Vec<String> = object.reacquired_s.iter().map(|r| seconds(r.seconds)).collect();
            writeln!(
                f,
                "{name:22} {rate:>7} {:>9} {:>9} {:>8} {:>8} {:>9} {:>12}",
                seconds(object.first_pose_s.published_s),
                seconds(object.first_pose_s.right_s),
                share(object.recall_10.map(|r| r.all)),
                share(object.recall_5.map(|r| r.all)),
                share(object.recall_10.and_then(|r| r.answered)),
                again.join(" ")
            )?;
        }
        let all = |recall: &Option<Recall>| share(recall.map(|r| r.all));
        let answered = share(self.recall_10.and_then(|r| r.answered));
        let (r10, r5) = (all(&self.recall_10), all(&self.recall_5));
        writeln!(f, "{:22} {:>7} {:>9} {:>9} {r10:>8} {r5:>8} {answered:>9}\n", "all", "", "", "")
    }

    fn write_nodes(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let headings = ["frames", "CPU ms/frame", "ms p50", "ms p99", "start CPU ms"];
        writeln!(
            f,
            "{:12} {:>7} {:>13} {:>9} {:>9} {:>13}",
            "node", headings[0], headings[1], headings[2], headings[3], headings[4]
        )?;
        for (name, cost) in &self.nodes {
            let work = |i: usize| cost.work_ms.map_or_else(|| "-".into(), |work| format!("{:.1}", work[i]));
            let (p50, p99) = (work(0), work(1));
            let (frames, cpu, start) = (cost.frames, cost.cpu_ms_per_frame, cost.startup_cpu_ms);
            writeln!(f, "{name:12} {frames:>7} {cpu:>13.1} {p50:>9} {p99:>9} {start:>13.0}")?;
        }
        writeln!(f, "{:12} {:>7} {:>13.1}   ({:.2} cores)\n", "all", "", self.cpu_ms_per_frame, self.cores_used)
    }
}
