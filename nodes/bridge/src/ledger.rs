//! What came in and could not be used: counted by source and kind, said aloud at the 1st, 2nd, 4th, 8th ... time, and published
//! as `diagnostics`. Nothing that comes from outside ends a run.

use pseudoflow_msgs::ros::{DiagnosticArray, DiagnosticStatus, Header, KeyValue};
use pseudoflow_runtime::{BadFrames, Refused};
use std::collections::BTreeMap;

/// Longest text of somebody else that is repeated.
const MOST_CHARS: usize = 160;
/// Most sources and kinds that are told apart.
const MOST_ENTRIES: usize = 256;

/// Counts of what was dropped.
#[derive(Debug, Default)]
pub(crate) struct Ledger {
    entries: BTreeMap<(String, &'static str), Entry>,
    changed: bool,
    /// Lines of the log that /rosout has not had.
    said: Vec<String>,
    /// What the run's summary has not had: how many, and the last line.
    uncounted: u64,
    last: String,
}

#[derive(Debug, Default)]
struct Entry {
    count: u64,
    last: String,
}

impl Ledger {
    /// Counts one thing of `source` (a topic) that was dropped: `kind` names the reason in a word or two, `cause` says it whole.
    pub(crate) fn drop(&mut self, source: &str, kind: &'static str, cause: impl std::fmt::Display) {
        self.drop_many(source, kind, 1, cause);
    }

    /// Counts several at once.
    pub(crate) fn drop_many(&mut self, source: &str, kind: &'static str, count: u64, cause: impl std::fmt::Display) {
        let full = self.entries.len() >= MOST_ENTRIES;
        let key = (source.to_owned(), kind);
        if count == 0 || (full && !self.entries.contains_key(&key)) {
            return;
        }
        let entry = self.entries.entry(key).or_default();
        let before = entry.count;
        entry.count += count;
        entry.last = shortened(&cause.to_string());
        self.changed = true;
        self.uncounted += count;
        self.last = format!("{source} ({kind}): {}", entry.last);
        // The highest power of two not above the count has grown.
        if before == 0 || before.ilog2() < entry.count.ilog2() {
            let line = format!("{source}: {} dropped ({kind}): {}", entry.count, entry.last);
            self.say(line);
        }
    }

    /// Says a line in the log and, by [`Self::take_said`], on /rosout.
    pub(crate) fn say(&mut self, line: String) {
        log::warn!("{line}");
        self.said.push(line);
    }

    /// What was said since this was last asked.
    pub(crate) fn take_said(&mut self) -> Vec<String> {
        std::mem::take(&mut self.said)
    }

    /// Frames that another node of the run has dropped so far.
    pub(crate) fn other_node(&mut self, bad: &BadFrames) {
        let input = bad.input.map(|input| format!(", input {input}")).unwrap_or_default();
        let from = bad.producer.as_ref().map(|producer| format!(" from {producer}")).unwrap_or_default();
        let entry = self.entries.entry((format!("node {}{input}{from}", bad.node), "bad frame")).or_default();
        if entry.count != bad.frames {
            *entry = Entry { count: bad.frames, last: shortened(&bad.last) };
            self.changed = true;
        }
    }

    /// What was dropped since this was last asked: how many, and what the last was.
    pub(crate) fn take_refused(&mut self) -> Option<Refused> {
        let messages = std::mem::take(&mut self.uncounted);
        (messages > 0).then(|| Refused { messages, last: self.last.clone() })
    }

    /// How many were dropped of a kind, from all sources.
    #[cfg(test)]
    pub(crate) fn count(&self, kind: &str) -> u64 {
        self.entries.iter().filter(|((_, of), _)| *of == kind).map(|(_, entry)| entry.count).sum()
    }

    /// The whole account, if it has changed since it was last asked for.
    pub(crate) fn report(&mut self, header: &Header) -> Option<DiagnosticArray> {
        if !std::mem::take(&mut self.changed) {
            return None;
        }
        let status = |((source, kind), entry): (&(String, &'static str), &Entry)| DiagnosticStatus {
            level: 1,
            name: source.clone(),
            message: format!("{} dropped ({kind}): {}", entry.count, entry.last),
            hardware_id: String::new(),
            values: vec![
                KeyValue { key: "kind".into(), value: (*kind).to_owned() },
                KeyValue { key: "dropped".into(), value: entry.count.to_string() },
            ],
        };
        Some(DiagnosticArray { header: header.clone(), status: self.entries.iter().map(status).collect() })
    }
}

fn shortened(text: &str) -> String {
    let clean = |c: char| if c.is_control() { ' ' } else { c };
    let mut short: String = text.chars().take(MOST_CHARS).map(clean).collect();
    if text.chars().nth(MOST_CHARS).is_some() {
        short.push_str(" ...");
    }
    short
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drops_are_counted_by_source_and_kind_and_reported_once() {
        let mut ledger = Ledger::default();
        ledger.drop("/camera", "encoding", "16UC1\n");
        ledger.drop("/camera", "encoding", "x".repeat(1000));
        ledger.drop_many("/detections", "unknown object", 7, "teapot");
        let report = ledger.report(&Header::default()).unwrap();
        let said: Vec<_> = report.status.iter().map(|s| (s.name.as_str(), s.values[1].value.as_str())).collect();
        assert_eq!(said, [("/camera", "2"), ("/detections", "7")]);
        assert!(report.status[0].message.len() < 250);
        assert_eq!((ledger.report(&Header::default()), ledger.count("encoding")), (None, 2));
        assert_eq!(ledger.take_refused().map(|refused| refused.messages), Some(9));
        assert_eq!(ledger.take_refused(), None);
    }

    #[test]
    fn bad_frames_of_other_nodes_stand_beside() {
        let mut ledger = Ledger::default();
        let producer = Some("pnp".to_owned());
        let bad =
            BadFrames { node: "recorder".into(), input: Some("poses"), producer, frames: 3, last: "x".repeat(900) };
        (0..2).for_each(|_| ledger.other_node(&bad));
        let report = ledger.report(&Header::default()).unwrap();
        assert_eq!(report.status[0].name, "node recorder, input poses from pnp");
        assert_eq!(report.status[0].values[1].value, "3");
        assert_eq!((ledger.take_refused(), ledger.report(&Header::default())), (None, None));
    }

    #[test]
    fn what_somebody_makes_up_does_not_fill_memory() {
        let mut ledger = Ledger::default();
        (0..10_000).for_each(|i| ledger.drop(&format!("/topic{i}"), "stamp", "wrong"));
        assert!(ledger.entries.len() <= MOST_ENTRIES);
    }
}
