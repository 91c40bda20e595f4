//! Which object `/object_pose` is about: one, until it is lost for good. A `PoseStamped` cannot say of which object it is,
//! so it must not change with each frame.

use crate::{ObjectPose, PoseStatus};

/// Keeps to one instance of one object.
#[derive(Debug, Clone, PartialEq)]
pub struct Follower {
    wanted: Option<u32>,
    switch_after_ns: i64,
    state: Option<Followed>,
}

/// Who is followed, and when it was last seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Followed {
    /// Object and instance.
    pub identity: (u32, u32),
    /// Stamp of the last frame in which its pose stood.
    pub seen_ns: i64,
}

impl Follower {
    /// Follows `wanted`, or whatever is found first; what has not stood for `switch_after_ns` is given up for another.
    #[must_use]
    pub fn new(wanted: Option<u32>, switch_after_ns: i64) -> Self {
        Self { wanted, switch_after_ns, state: None }
    }

    /// Who is followed now.
    #[must_use]
    pub fn state(&self) -> Option<Followed> {
        self.state
    }

    /// Goes on where another life of the process ended.
    pub fn resume(&mut self, state: Option<Followed>) {
        self.state = state.filter(|s| self.wanted.is_none_or(|id| id == s.identity.0));
    }

    /// The pose to publish for a frame: that of the object followed where it stands. Asked again with the same frame, it
    /// answers the same.
    pub fn choose<'a>(&mut self, stamp_ns: i64, poses: &'a [ObjectPose]) -> Option<&'a ObjectPose> {
        if let Some(followed) = &mut self.state {
            if let Some(pose) = poses.iter().find(|p| stands(p) && p.identity() == followed.identity) {
                followed.seen_ns = stamp_ns;
                return Some(pose);
            }
            // A clock that jumped back (a looped recording) begins anew with the same object.
            followed.seen_ns = followed.seen_ns.min(stamp_ns);
            if stamp_ns.saturating_sub(followed.seen_ns) < self.switch_after_ns {
                return None;
            }
        }
        let candidates = poses.iter().filter(|p| stands(p) && self.wanted.is_none_or(|id| id == p.object_id));
        let best = candidates.reduce(|best, pose| if pose.score > best.score { pose } else { best })?;
        self.state = Some(Followed { identity: best.identity(), seen_ns: stamp_ns });
        Some(best)
    }
}

/// Whether a pose is one to act on.
pub(super) fn stands(pose: &ObjectPose) -> bool {
    pose.status() == Some(PoseStatus::Ok)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    const SECOND: i64 = 1_000_000_000;

    fn pose(object_id: u32, instance: u32, status: PoseStatus, score: f64) -> ObjectPose {
        ObjectPose { object_id, instance, status: status as u32, score, ..ObjectPose::zeroed() }
    }

    fn chosen(follower: &mut Follower, stamp_ns: i64, poses: &[ObjectPose]) -> Option<(u32, u32)> {
        follower.choose(stamp_ns, poses).map(ObjectPose::identity)
    }

    #[test]
    fn the_first_found_is_kept_though_another_scores_higher() {
        let mut follower = Follower::new(None, 2 * SECOND);
        let first = [pose(1, 0, PoseStatus::Rejected, 0.99), pose(2, 0, PoseStatus::Ok, 0.5)];
        assert_eq!(chosen(&mut follower, 0, &first), Some((2, 0)));
        let later = [pose(1, 0, PoseStatus::Ok, 0.99), pose(2, 0, PoseStatus::Ok, 0.1)];
        assert_eq!(chosen(&mut follower, SECOND, &later), Some((2, 0)));
        let lost = [pose(1, 0, PoseStatus::Ok, 0.99), pose(2, 0, PoseStatus::NotSeen, 0.9)];
        assert_eq!(chosen(&mut follower, 2 * SECOND, &lost), None);
        assert_eq!(chosen(&mut follower, 3 * SECOND, &lost), Some((1, 0)));
        assert_eq!(chosen(&mut follower, 4 * SECOND, &later), Some((1, 0)));
    }

    #[test]
    fn a_wanted_object_is_never_left_for_another() {
        let mut follower = Follower::new(Some(1), SECOND);
        let other = [pose(2, 0, PoseStatus::Ok, 0.9)];
        assert_eq!(chosen(&mut follower, 0, &other), None);
        let two = [pose(1, 0, PoseStatus::Ok, 0.2), pose(1, 1, PoseStatus::Ok, 0.3)];
        assert_eq!(chosen(&mut follower, 1, &two), Some((1, 1)));
        assert_eq!(chosen(&mut follower, 9 * SECOND, &other), None);
        assert_eq!(chosen(&mut follower, 9 * SECOND, &two[..1]), Some((1, 0)));
    }

    #[test]
    fn a_clock_that_jumps_back_and_a_new_life_change_nothing() {
        let mut follower = Follower::new(None, SECOND);
        let both = [pose(1, 0, PoseStatus::Ok, 0.2), pose(2, 0, PoseStatus::Ok, 0.9)];
        assert_eq!(chosen(&mut follower, 100 * SECOND, &both), Some((2, 0)));
        assert_eq!(chosen(&mut follower, 0, &both[..1]), None);
        assert_eq!(chosen(&mut follower, SECOND / 2, &both[..1]), None);
        let mut next_life = Follower::new(None, SECOND);
        next_life.resume(follower.state());
        assert_eq!(chosen(&mut next_life, SECOND / 2, &both), Some((2, 0)));
    }
}
