//! How often an object is searched for that is not found: less and less, so that an absent one costs little.

use crate::InitializerError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// How often wanted objects are searched for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SearchConfig {
    /// Seconds of the camera's time from one search for an object to the next.
    pub wait_s: f64,
    /// They double with every search that does not find it, up to this.
    pub most_wait_s: f64,
    /// Objects that are searched for in one frame, those that have waited longest: what is found comes the sooner, the fewer.
    pub objects: usize,
}

impl Default for SearchConfig {
    fn default() -> Self {
        Self { wait_s: 0.25, most_wait_s: 2.0, objects: 1 }
    }
}

impl SearchConfig {
    /// Checks the ranges.
    ///
    /// # Errors
    /// Names the first setting out of range.
    pub fn check(&self) -> Result<(), InitializerError> {
        let Self { wait_s, most_wait_s, objects } = *self;
        if !(0.0..=3600.0).contains(&wait_s) {
            return Err(InitializerError::Setting { field: "search.wait_s", got: wait_s, wanted: "0 to 3600" });
        }
        if !(wait_s..=3600.0).contains(&most_wait_s) {
            let wanted = "from `wait_s` to 3600";
            return Err(InitializerError::Setting { field: "search.most_wait_s", got: most_wait_s, wanted });
        }
        if objects == 0 {
            return Err(InitializerError::Setting { field: "search.objects", got: 0.0, wanted: "at least 1" });
        }
        Ok(())
    }
}

/// What is remembered of the searches for each object.
#[derive(Debug)]
pub(crate) struct Patience {
    config: SearchConfig,
    searched: BTreeMap<u32, Searched>,
}

#[derive(Debug, Clone, Copy)]
struct Searched {
    /// Stamp of the last frame that was searched.
    stamp_ns: i64,
    /// Searches in a row that did not find it.
    misses: u32,
}

impl Patience {
    pub(crate) fn new(config: SearchConfig) -> Self {
        Self { config, searched: BTreeMap::new() }
    }

    /// What is not wanted any more begins anew when it is wanted again.
    pub(crate) fn forget_all_but(&mut self, wanted: &[u32]) {
        self.searched.retain(|id, _| wanted.contains(id));
    }

    /// Of these objects those that are to be searched for now, the ones that have waited longest first.
    pub(crate) fn due(&self, candidates: &[u32], stamp_ns: i64) -> Vec<u32> {
        self.longest_first(candidates.iter().copied().filter(|id| self.is_due(*id, stamp_ns)).collect())
    }

    /// Of these objects, which an image shows, those whose turn it is. How often they were not found before does not matter now.
    pub(crate) fn turn(&self, shown: &[u32], stamp_ns: i64) -> Vec<u32> {
        let rested = |id: &u32| self.seconds_since(*id, stamp_ns).is_none_or(|s| s >= self.config.wait_s);
        let mut turn = self.longest_first(shown.iter().copied().filter(rested).collect());
        turn.truncate(self.config.objects);
        turn
    }

    fn longest_first(&self, mut ids: Vec<u32>) -> Vec<u32> {
        ids.sort_by_key(|id| self.searched.get(id).map(|searched| searched.stamp_ns));
        ids
    }

    /// Time since the last search for an object; `None` where it was never searched for, or time went back: that is another clock.
    fn seconds_since(&self, id: u32, stamp_ns: i64) -> Option<f64> {
        let since_s = (stamp_ns - self.searched.get(&id)?.stamp_ns) as f64 * 1e-9;
        (since_s >= 0.0).then_some(since_s)
    }

    fn is_due(&self, id: u32, stamp_ns: i64) -> bool {
        let Some(since_s) = self.seconds_since(id, stamp_ns) else { return true };
        let doublings = self.searched[&id].misses.saturating_sub(1).min(30) as i32;
        since_s >= (self.config.wait_s * 2_f64.powi(doublings)).min(self.config.most_wait_s)
    }

    /// Takes down that a frame was searched.
    pub(crate) fn searched(&mut self, id: u32, stamp_ns: i64, found: bool) {
        let before = self.searched.get(&id).map_or(0, |searched| searched.misses);
        let misses = if found { 0 } else { before.saturating_add(1) };
        self.searched.insert(id, Searched { stamp_ns, misses });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: i64 = 1_000_000_000;

    /// Searches for object 3, which is never found, in frames every 0.1 s.
    fn searches(patience: &mut Patience, seconds: i64) -> Vec<i64> {
        let stamps = (0..10 * seconds).map(|i| i * S / 10);
        let searched = stamps.filter(|stamp| {
            let due = !patience.due(&[3], *stamp).is_empty();
            if due {
                patience.searched(3, *stamp, false);
            }
            due
        });
        searched.collect()
    }

    #[test]
    fn what_is_absent_is_searched_for_less_and_less() {
        let mut patience = Patience::new(SearchConfig { wait_s: 0.5, most_wait_s: 4.0, objects: 1 });
        let at_ms: Vec<i64> = searches(&mut patience, 20).into_iter().map(|ns| ns / 1_000_000).collect();
        assert_eq!(at_ms, [0, 500, 1500, 3500, 7500, 11_500, 15_500, 19_500]);
    }

    #[test]
    fn what_was_found_or_not_wanted_for_a_while_begins_anew() {
        let mut patience = Patience::new(SearchConfig::default());
        searches(&mut patience, 10);
        assert!(patience.due(&[3], 10 * S).is_empty());
        assert_eq!(patience.due(&[3, 4], 10 * S), [4]);
        patience.forget_all_but(&[4]);
        assert_eq!(patience.due(&[3], 10 * S), [3]);
        patience.searched(3, 10 * S, true);
        assert!(patience.due(&[3], 10 * S + S / 10).is_empty());
        assert_eq!(patience.due(&[3], 10 * S + S / 2), [3]);
        assert_eq!(patience.due(&[3], 9 * S), [3], "a clock that went back");
    }

    #[test]
    fn those_that_have_waited_longest_come_first() {
        let mut patience = Patience::new(SearchConfig { objects: 2, ..SearchConfig::default() });
        patience.searched(1, S, false);
        patience.searched(2, 0, true);
        assert_eq!(patience.due(&[1, 2, 3], 3 * S), [3, 2, 1]);
        assert_eq!(patience.turn(&[1, 2, 3], 3 * S), [3, 2]);
    }

    #[test]
    fn what_an_image_shows_is_not_kept_waiting_by_searches_that_did_not_find_it() {
        let mut patience = Patience::new(SearchConfig { wait_s: 0.5, most_wait_s: 8.0, objects: 1 });
        (0..5).for_each(|i| patience.searched(3, i * S, false));
        assert!(patience.due(&[3], 5 * S).is_empty());
        assert_eq!(patience.turn(&[3], 5 * S), [3]);
        assert!(patience.turn(&[3], 4 * S + S / 10).is_empty());
    }

    #[test]
    fn settings_out_of_range_are_named() {
        let refused =
            |wait_s, most_wait_s| SearchConfig { wait_s, most_wait_s, objects: 1 }.check().unwrap_err().to_string();
        assert!(refused(-1.0, 3.0).contains("search.wait_s"));
        assert!(refused(2.0, 1.0).contains("search.most_wait_s"));
        SearchConfig::default().check().unwrap();
    }
}
