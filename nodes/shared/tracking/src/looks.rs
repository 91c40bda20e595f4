//! Which objects a network should look at: those that are not sure, those that were not looked at for long.

use crate::TrackingConfig;
use crate::track::{Phase, Track};
use pseudoflow_geometry::Pose;

/// A look of the network that is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    /// The object.
    pub object_id: u32,
    /// Where it is believed to be in this frame.
    pub camera_from_object: Pose,
}

/// What looks may cost: each frame earns some, each look costs some.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Budget {
    saved_ms: f64,
}

impl Budget {
    pub(crate) fn earn(&mut self, config: &TrackingConfig) {
        let most_ms = config.budget_ms.max(config.look_ms);
        self.saved_ms = (self.saved_ms + config.budget_ms).min(most_ms);
    }

    /// As many of the wanted looks as can be paid.
    pub(crate) fn spend(&mut self, mut wanted: Vec<usize>, config: &TrackingConfig) -> Vec<usize> {
        let affordable = (self.saved_ms / config.look_ms + 1e-9) as usize;
        wanted.truncate(affordable);
        self.saved_ms -= wanted.len() as f64 * config.look_ms;
        wanted
    }
}

/// The tracks to be looked at in this frame, the most urgent first.
pub(crate) fn wanted(tracks: &[Track], now_ns: i64, config: &TrackingConfig) -> Vec<usize> {
    let since = |ns: Option<i64>| ns.map_or(f64::INFINITY, |ns| (now_ns - ns) as f64 * 1e-9);
    let waiting = |t: &Track| since(t.asked_ns) < config.look_timeout_s;
    // Newest wins in a live graph: a second request would push aside the one that the network has not begun with.
    if tracks.iter().any(waiting) {
        return Vec::new();
    }
    let urgency = |t: &Track| {
        let age_s = since(t.looked_ns);
        let (due_s, weight) = match (t.measured, t.phase) {
            (true, Phase::Tracking) if !t.disputed => (config.look_every_s, 1.0),
            (true, Phase::Tracking) => (config.look_again_s, 2.0),
            (_, Phase::Lost) => (config.look_again_s * 2.0, 2.0),
            _ => (config.look_again_s, 4.0),
        };
        (t.known && age_s >= due_s).then(|| weight * age_s.min(100.0) / due_s)
    };
    let mut ranked: Vec<(f64, usize)> =
        tracks.iter().enumerate().filter_map(|(i, t)| urgency(t).map(|u| (u, i))).collect();
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    ranked.into_iter().take(config.looks_at_once).map(|(_, i)| i).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_next_looks_are_asked_for_when_the_last_have_come() {
        let config = TrackingConfig::default();
        let s = |s: f64| (s * 1e9) as i64;
        let track = |looked_ns: Option<i64>, disputed: bool| {
            let base = Track { known: true, measured: true, phase: Phase::Tracking, ..Track::new(0) };
            Track { looked_ns, disputed, ..base }
        };
        let now = s(100.0);
        let agreed = |since: f64| track(Some(now - s(since)), false);
        let disputed = track(Some(now - s(0.5)), true);
        assert_eq!(
            wanted(&[agreed(0.5), disputed.clone(), agreed(2.0)], now, &config),
            [1, 2],
            "the most urgent first"
        );
        let asked = Track { asked_ns: Some(now - s(0.3)), ..agreed(0.3) };
        assert!(wanted(&[asked.clone(), disputed.clone()], now, &config).is_empty());
        let given_up = Track { asked_ns: Some(now - s(2.0)), ..asked };
        assert_eq!(wanted(&[given_up, disputed], now, &config)[0], 1);
    }
}
