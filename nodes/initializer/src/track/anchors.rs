//! Things on a table keep their places while the camera moves: what is hidden or lost is where it was among the others.
//!
//! A track remembers its pose in the frame of each other object that was seen with it. Where two or more of them agree on where
//! it is now, that is where it is expected. One alone is not believed: it may have been moved.

use super::{Track, Tracker, distance_m};
use pseudoflow_geometry::Pose;
use pseudoflow_msgs::{TrackPhase, TrackReason};

/// Another instance, and where this one was in its frame.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Anchor {
    /// As [`Track::identity`].
    identity: (u32, u32),
    anchor_from_object: Pose,
}

/// Anchors agree where they say the same place up to this distance, diameters of the object.
const AGREE_DIAMETERS: f64 = 0.5;

impl Tracker {
    /// Remembers what was seen together at `stamp_ns`.
    pub(super) fn anchor(&mut self, stamp_ns: i64) {
        let seen = |t: &Track| t.active && t.stamp_ns == stamp_ns && t.bad == 0 && t.good > 0;
        let together: Vec<((u32, u32), Pose)> =
            self.tracks.iter().filter(|t| seen(t) && sound(t)).map(|t| (t.identity(), t.pose)).collect();
        for track in self.tracks.iter_mut().filter(|t| seen(t)) {
            let others = together.iter().filter(|(identity, _)| *identity != track.identity());
            let anchors = others.map(|&(identity, camera_from_anchor)| Anchor {
                identity,
                anchor_from_object: camera_from_anchor.inverse() * track.pose,
            });
            let anchors: Vec<Anchor> = anchors.collect();
            // Alone in the image it keeps what it knew.
            if !anchors.is_empty() {
                track.anchors = anchors;
            }
        }
    }

    /// Where the objects around a track say that it is at `stamp_ns`; `None` unless two or more agree.
    pub(super) fn anchored(&self, track: &Track, stamp_ns: i64) -> Option<Pose> {
        let says = |anchor: &Anchor| {
            let there =
                self.tracks.iter().find(|t| t.identity() == anchor.identity).filter(|t| sound(t))?.predict(stamp_ns);
            Some(there * anchor.anchor_from_object)
        };
        let poses: Vec<Pose> = track.anchors.iter().filter_map(says).collect();
        agreed(&poses, AGREE_DIAMETERS * self.diameter_m(track.object_id))
    }

    /// Where a track is expected at `stamp_ns`: where its motion takes it, unless it was not seen of late and the objects
    /// around it know better.
    pub(super) fn expected(&self, track: &Track, stamp_ns: i64) -> Pose {
        let unseen = !track.fresh && (track.bad > 0 || !track.active);
        unseen.then(|| self.anchored(track, stamp_ns)).flatten().unwrap_or_else(|| track.predict(stamp_ns))
    }

    /// Looks for what is lost where it was left.
    pub(super) fn remember(&mut self, stamp_ns: i64) {
        for i in 0..self.tracks.len() {
            let track = &self.tracks[i];
            if track.active || track.phase != TrackPhase::Lost || self.full(track.object_id) {
                continue;
            }
            let Some(left) = self.anchored(track, stamp_ns) else { continue };
            let taken = |t: &Track| t.active && t.object_id == track.object_id && self.near(t, &left, stamp_ns);
            if !self.tracks.iter().any(taken) {
                self.tracks[i].resume(TrackReason::Remembered, left, Vec::new(), stamp_ns);
            }
        }
    }
}

/// Whether others may be placed by it.
fn sound(track: &Track) -> bool {
    track.active && track.bad == 0 && track.phase == TrackPhase::Tracking
}

/// The pose that most others agree with, the nearest to them of equals; `None` where no two agree.
fn agreed(poses: &[Pose], within_m: f64) -> Option<Pose> {
    let support = |i: usize| {
        let others = (0..poses.len()).filter(|j| *j != i).map(|j| distance_m(&poses[i], &poses[j]));
        others.filter(|m| *m <= within_m).fold((0_usize, 0.0), |(count, sum), m| (count + 1, sum + m))
    };
    let ranked = (0..poses.len()).map(|i| (support(i), i)).filter(|((count, _), _)| *count > 0);
    let best = ranked.min_by(|((a, near), _), ((b, far), _)| b.cmp(a).then(near.total_cmp(far)));
    best.map(|(_, i)| poses[i])
}
