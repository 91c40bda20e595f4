use std::collections::VecDeque;

/// Joins images with the calibration of the same stamp, in whatever order they come.
///
/// Pairs leave in the order of their stamps. What is older than a pair that left is dropped. Of what never completes, `depth`
/// messages are kept, those that came last: a stamp from the future cannot push out what belongs together.
#[derive(Debug)]
pub(crate) struct StampSync<Image, Info> {
    depth: usize,
    images: VecDeque<(i64, Image)>,
    infos: VecDeque<(i64, Info)>,
    left: Option<i64>,
    dropped: u64,
}

/// One image with what belongs to it.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Complete<Image, Info> {
    pub(crate) stamp_ns: i64,
    pub(crate) image: Image,
    pub(crate) info: Info,
}

/// A clock that jumped back this far (a looped recording, a restarted driver) begins anew; so does one that went ahead.
const JUMP_NS: i64 = 1_000_000_000;

impl<Image, Info> StampSync<Image, Info> {
    pub(crate) fn new(depth: usize) -> Self {
        Self { depth, images: VecDeque::new(), infos: VecDeque::new(), left: None, dropped: 0 }
    }

    pub(crate) fn push_image(&mut self, stamp_ns: i64, image: Image) {
        if self.is_late(stamp_ns) {
            self.dropped += 1;
        } else {
            self.dropped += push(&mut self.images, stamp_ns, image, self.depth);
        }
    }

    pub(crate) fn push_info(&mut self, stamp_ns: i64, info: Info) {
        if !self.is_late(stamp_ns) {
            push(&mut self.infos, stamp_ns, info, self.depth);
        }
    }

    fn is_late(&self, stamp_ns: i64) -> bool {
        self.left.is_some_and(|left| stamp_ns <= left && left.saturating_sub(stamp_ns) < JUMP_NS)
    }

    /// Images that were dropped since this was last asked, because something of theirs was missing, or because they came too late.
    pub(crate) fn take_dropped(&mut self) -> u64 {
        std::mem::take(&mut self.dropped)
    }

    /// How many images and calibrations wait for each other.
    pub(crate) fn waiting(&self) -> (usize, usize) {
        (self.images.len(), self.infos.len())
    }

    /// The oldest complete pair.
    pub(crate) fn take(&mut self) -> Option<Complete<Image, Info>> {
        let has_info = |stamp: i64| self.infos.iter().any(|(of, _)| *of == stamp);
        let stamp_ns = self.images.iter().map(|(stamp, _)| *stamp).filter(|stamp| has_info(*stamp)).min()?;
        let image = remove(&mut self.images, stamp_ns)?;
        let info = remove(&mut self.infos, stamp_ns)?;
        let waiting = self.images.len();
        self.left = Some(stamp_ns);
        // A pair of a clock that jumped back does not make the pairs before the jump late, nor is it late itself.
        let old = |stamp: i64| stamp <= stamp_ns && stamp_ns.saturating_sub(stamp) < JUMP_NS;
        self.images.retain(|(stamp, _)| !old(*stamp));
        self.infos.retain(|(stamp, _)| !old(*stamp));
        self.dropped += (waiting - self.images.len()) as u64;
        Some(Complete { stamp_ns, image, info })
    }
}

fn remove<T>(queue: &mut VecDeque<(i64, T)>, stamp_ns: i64) -> Option<T> {
    let at = queue.iter().position(|(stamp, _)| *stamp == stamp_ns)?;
    queue.remove(at).map(|(_, message)| message)
}

/// Adds a message and returns how many were dropped for it. The second of a stamp takes the place of the first.
fn push<T>(queue: &mut VecDeque<(i64, T)>, stamp_ns: i64, message: T, depth: usize) -> u64 {
    let before = queue.len() + 1;
    queue.retain(|(stamp, _)| *stamp != stamp_ns);
    queue.push_back((stamp_ns, message));
    while queue.len() > depth {
        queue.pop_front();
    }
    (before - queue.len()) as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn stamps(sync: &mut StampSync<i64, i64>) -> Vec<i64> {
        std::iter::from_fn(|| sync.take().map(|set| set.stamp_ns)).collect()
    }

    #[test]
    fn pairs_leave_in_order_and_older_images_are_counted() {
        let mut sync = StampSync::new(10);
        for stamp in [1, 2, 3, 4] {
            sync.push_image(stamp, stamp);
        }
        for stamp in [4, 2] {
            sync.push_info(stamp, stamp);
        }
        assert_eq!((stamps(&mut sync), sync.take_dropped()), (vec![2, 4], 2));
        sync.push_image(3, 3);
        sync.push_info(3, 3);
        assert_eq!((stamps(&mut sync), sync.take_dropped()), (vec![], 1));
    }

    #[test]
    fn images_from_the_future_do_not_silence_the_camera() {
        let mut sync = StampSync::new(10);
        let future = 9_000_000_000_000;
        (0..12).for_each(|i| sync.push_image(future + i, future));
        for stamp in 1..30 {
            sync.push_image(stamp, stamp);
            sync.push_info(stamp, stamp);
            assert_eq!(stamps(&mut sync), [stamp]);
        }
        // Even complete ones cost no more than themselves.
        sync.push_image(future, future);
        sync.push_info(future, future);
        assert_eq!(stamps(&mut sync), [future]);
        sync.push_image(31, 31);
        sync.push_info(31, 31);
        assert_eq!(stamps(&mut sync), [31]);
    }

    #[test]
    fn what_never_completes_is_bounded() {
        let mut sync = StampSync::<_, ()>::new(3);
        for stamp in 0..100 {
            sync.push_image(stamp, ());
        }
        assert_eq!((sync.waiting(), sync.take_dropped()), ((3, 0), 97));
    }

    #[test]
    fn a_clock_that_jumps_back_begins_anew() {
        let mut sync = StampSync::new(3);
        for stamp in [5_000_000_000, 1] {
            sync.push_image(stamp, ());
            sync.push_info(stamp, ());
            assert_eq!(sync.take().unwrap().stamp_ns, stamp);
        }
    }

    proptest! {
        #[test]
        fn all_pairs_leave_whatever_the_order_within_the_depth(order in Just((0..20_i64).collect::<Vec<_>>()).prop_shuffle()) {
            let mut sync = StampSync::new(20);
            (0..20).for_each(|stamp| sync.push_image(stamp, stamp));
            order.into_iter().for_each(|stamp| sync.push_info(stamp, stamp));
            prop_assert_eq!(stamps(&mut sync), (0..20).collect::<Vec<_>>());
            prop_assert_eq!(sync.take_dropped(), 0);
        }
    }
}
