use std::collections::BTreeMap;

/// Brings together what belongs to one image: messages of the same stamp, in whatever order they come.
///
/// Complete sets leave in the order of their stamps. What is older than a set that left, or more than `depth`
/// messages old, is dropped; dropped images are counted.
#[derive(Debug)]
pub(crate) struct StampSync<Image, Info, Extra> {
    depth: usize,
    extra_needed: bool,
    images: BTreeMap<i64, Image>,
    infos: BTreeMap<i64, Info>,
    extras: BTreeMap<i64, Extra>,
    left: Option<i64>,
    dropped: u64,
}

/// One image with what belongs to it.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Complete<Image, Info, Extra> {
    pub(crate) stamp_ns: i64,
    pub(crate) image: Image,
    pub(crate) info: Info,
    pub(crate) extra: Option<Extra>,
}

impl<Image, Info, Extra> StampSync<Image, Info, Extra> {
    pub(crate) fn new(depth: usize, extra_needed: bool) -> Self {
        let (images, infos, extras) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
        Self { depth, extra_needed, images, infos, extras, left: None, dropped: 0 }
    }

    pub(crate) fn push_image(&mut self, stamp_ns: i64, image: Image) {
        self.dropped += push(&mut self.images, stamp_ns, image, self.depth, self.left);
    }

    pub(crate) fn push_info(&mut self, stamp_ns: i64, info: Info) {
        push(&mut self.infos, stamp_ns, info, self.depth, self.left);
    }

    pub(crate) fn push_extra(&mut self, stamp_ns: i64, extra: Extra) {
        push(&mut self.extras, stamp_ns, extra, self.depth, self.left);
    }

    /// Images that were dropped because something of theirs was missing, or because they came too late.
    pub(crate) fn dropped(&self) -> u64 {
        self.dropped
    }

    /// The oldest complete set.
    pub(crate) fn take(&mut self) -> Option<Complete<Image, Info, Extra>> {
        let whole =
            |stamp: &&i64| self.infos.contains_key(stamp) && (!self.extra_needed || self.extras.contains_key(stamp));
        let stamp_ns = *self.images.keys().find(whole)?;
        let image = self.images.remove(&stamp_ns)?;
        let info = self.infos.remove(&stamp_ns)?;
        let extra = self.extras.remove(&stamp_ns);
        let waiting = self.images.len();
        self.images.retain(|stamp, _| *stamp > stamp_ns);
        self.infos.retain(|stamp, _| *stamp > stamp_ns);
        self.extras.retain(|stamp, _| *stamp > stamp_ns);
        self.dropped += (waiting - self.images.len()) as u64;
        self.left = Some(stamp_ns);
        Some(Complete { stamp_ns, image, info, extra })
    }
}

/// Adds a message and returns how many were dropped for it, itself included.
fn push<T>(queue: &mut BTreeMap<i64, T>, stamp_ns: i64, message: T, depth: usize, left: Option<i64>) -> u64 {
    // A clock that jumped back (a looped recording) would otherwise silence the camera for good.
    const JUMP_NS: i64 = 1_000_000_000;
    if left.is_some_and(|left| stamp_ns <= left && left.saturating_sub(stamp_ns) < JUMP_NS) {
        return 1;
    }
    queue.insert(stamp_ns, message);
    let excess = queue.len().saturating_sub(depth);
    for _ in 0..excess {
        queue.pop_first();
    }
    excess as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn stamps(sync: &mut StampSync<i64, i64, ()>) -> Vec<i64> {
        std::iter::from_fn(|| sync.take().map(|set| set.stamp_ns)).collect()
    }

    #[test]
    fn sets_leave_in_order_and_older_images_are_counted() {
        let mut sync = StampSync::new(10, false);
        for stamp in [1, 2, 3, 4] {
            sync.push_image(stamp, stamp);
        }
        for stamp in [4, 2] {
            sync.push_info(stamp, stamp);
        }
        assert_eq!(stamps(&mut sync), [2, 4]);
        assert_eq!(sync.dropped(), 2);
        sync.push_image(3, 3);
        sync.push_info(3, 3);
        assert_eq!((stamps(&mut sync), sync.dropped()), (vec![], 3));
    }

    #[test]
    fn detections_are_waited_for_when_asked_for() {
        let mut sync = StampSync::<_, _, &str>::new(10, true);
        sync.push_image(1, "image");
        sync.push_info(1, "info");
        assert_eq!(sync.take(), None);
        sync.push_extra(1, "poses");
        let expected = Complete { stamp_ns: 1, image: "image", info: "info", extra: Some("poses") };
        assert_eq!(sync.take(), Some(expected));
    }

    #[test]
    fn what_never_completes_is_bounded() {
        let mut sync = StampSync::<_, (), ()>::new(3, false);
        for stamp in 0..100 {
            sync.push_image(stamp, ());
        }
        assert_eq!((sync.images.len(), sync.dropped()), (3, 97));
    }

    #[test]
    fn a_clock_that_jumps_back_begins_anew() {
        let mut sync = StampSync::<_, _, ()>::new(3, false);
        for stamp in [5_000_000_000, 1] {
            sync.push_image(stamp, ());
            sync.push_info(stamp, ());
            assert_eq!(sync.take().unwrap().stamp_ns, stamp);
        }
    }

    proptest! {
        #[test]
        fn all_pairs_leave_whatever_the_order_within_the_depth(order in Just((0..20_i64).collect::<Vec<_>>()).prop_shuffle()) {
            let mut sync = StampSync::new(20, false);
            (0..20).for_each(|stamp| sync.push_image(stamp, stamp));
            order.into_iter().for_each(|stamp| sync.push_info(stamp, stamp));
            prop_assert_eq!(stamps(&mut sync), (0..20).collect::<Vec<_>>());
            prop_assert_eq!(sync.dropped(), 0);
        }
    }
}
