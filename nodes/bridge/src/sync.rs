use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Joins images with the calibration of the same stamp, in whatever order they come.
///
/// Pairs leave in the order of their stamps. What is older than a pair that left is dropped. Of what never completes, `depth`
/// messages are kept, those that came last, for [`PATIENCE`]: a stamp from the future cannot push out what belongs together. Of
/// one stamp several may wait: a bad message does not take the place of a good one.
#[derive(Debug)]
pub(crate) struct StampSync<Image, Info> {
    images: Queue<Image>,
    infos: Queue<Info>,
    left: Option<i64>,
    /// Numbers of images and calibrations that do not fit each other.
    apart: Vec<(u64, u64)>,
}

#[derive(Debug)]
struct Queue<T> {
    depth: usize,
    waiting: VecDeque<Waiting<T>>,
    came: u64,
    dropped: Dropped,
}

/// Messages that were dropped.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Dropped {
    /// For want of their other half, or because they came too late.
    pub(crate) alone: u64,
    /// Because no other half that came fitted.
    pub(crate) misfits: u64,
}

#[derive(Debug)]
struct Waiting<T> {
    /// Its count in the queue.
    number: u64,
    stamp_ns: i64,
    came: Instant,
    /// Whether it has met another half that it did not fit.
    met: bool,
    message: T,
}

/// What came of an attempt to join two messages.
#[derive(Debug)]
pub(crate) enum Joined<T> {
    Whole(T),
    /// The image cannot be used with any calibration.
    BadImage,
    /// They do not fit each other: both wait on for others of their stamp.
    Apart,
}

/// A clock that jumped back this far (a looped recording, a restarted driver) begins anew; so does one that went ahead.
const JUMP_NS: i64 = 1_000_000_000;
/// How long a message waits for its other half.
pub(crate) const PATIENCE: Duration = Duration::from_secs(5);

impl<Image, Info> StampSync<Image, Info> {
    pub(crate) fn new(depth: usize) -> Self {
        Self { images: Queue::new(depth), infos: Queue::new(depth), left: None, apart: Vec::new() }
    }

    pub(crate) fn push_image(&mut self, stamp_ns: i64, image: Image) {
        self.images.push(stamp_ns, image, self.left);
    }

    pub(crate) fn push_info(&mut self, stamp_ns: i64, info: Info) {
        self.infos.push(stamp_ns, info, self.left);
    }

    /// Drops what has waited too long.
    pub(crate) fn expire(&mut self, now: Instant) {
        let waits = |came: Instant| now.saturating_duration_since(came) < PATIENCE;
        self.images.keep(|of| waits(of.came));
        self.infos.keep(|of| waits(of.came));
    }

    /// Images and calibrations that were dropped since this was last asked.
    pub(crate) fn take_dropped(&mut self) -> [Dropped; 2] {
        [std::mem::take(&mut self.images.dropped), std::mem::take(&mut self.infos.dropped)]
    }

    /// How many images and calibrations wait for each other.
    pub(crate) fn waiting(&self) -> (usize, usize) {
        (self.images.waiting.len(), self.infos.waiting.len())
    }

    /// The oldest pair that `join` can make something of; it is asked once for each pair.
    pub(crate) fn take<T>(&mut self, mut join: impl FnMut(i64, &Image, &Info) -> Joined<T>) -> Option<T> {
        loop {
            let (image_at, info_at) = self.oldest_pair()?;
            let (image, info) = (&mut self.images.waiting[image_at], &mut self.infos.waiting[info_at]);
            match join(image.stamp_ns, &image.message, &info.message) {
                Joined::BadImage => drop(self.images.waiting.remove(image_at)),
                Joined::Apart => {
                    (image.met, info.met) = (true, true);
                    self.apart.push((image.number, info.number));
                }
                Joined::Whole(whole) => {
                    let left_ns = image.stamp_ns;
                    self.images.waiting.remove(image_at);
                    self.infos.waiting.remove(info_at);
                    self.leave(left_ns);
                    return Some(whole);
                }
            }
        }
    }

    /// Where the two of the lowest stamp that both have stand, but for those that do not fit each other.
    fn oldest_pair(&mut self) -> Option<(usize, usize)> {
        let (images, infos) = (&self.images.waiting, &self.infos.waiting);
        self.apart.retain(|(image, info)| has(images, *image) && has(infos, *info));
        let pairs = images.iter().enumerate().flat_map(|(image_at, image)| {
            let fits = |info: &Waiting<Info>| {
                info.stamp_ns == image.stamp_ns && !self.apart.contains(&(image.number, info.number))
            };
            infos.iter().position(fits).map(|info_at| (image.stamp_ns, image_at, info_at))
        });
        pairs.min().map(|(_, image_at, info_at)| (image_at, info_at))
    }

    fn leave(&mut self, stamp_ns: i64) {
        self.left = Some(stamp_ns);
        // A pair of a clock that jumped back does not make the pairs before the jump late, nor is it late itself.
        self.images.keep(|of| !is_late(of.stamp_ns, stamp_ns));
        self.infos.keep(|of| !is_late(of.stamp_ns, stamp_ns));
    }
}

fn has<T>(waiting: &VecDeque<Waiting<T>>, number: u64) -> bool {
    waiting.iter().any(|of| of.number == number)
}

fn is_late(stamp_ns: i64, left_ns: i64) -> bool {
    stamp_ns <= left_ns && left_ns.saturating_sub(stamp_ns) < JUMP_NS
}

impl<T> Queue<T> {
    fn new(depth: usize) -> Self {
        Self { depth, waiting: VecDeque::new(), came: 0, dropped: Dropped::default() }
    }

    fn push(&mut self, stamp_ns: i64, message: T, left_ns: Option<i64>) {
        if left_ns.is_some_and(|left_ns| is_late(stamp_ns, left_ns)) {
            self.dropped.alone += 1;
            return;
        }
        self.came += 1;
        self.waiting.push_back(Waiting { number: self.came, stamp_ns, came: Instant::now(), met: false, message });
        while self.waiting.len() > self.depth {
            let oldest = self.waiting.pop_front();
            oldest.iter().for_each(|of| self.dropped.count(of.met));
        }
    }

    fn keep(&mut self, which: impl Fn(&Waiting<T>) -> bool) {
        let dropped = &mut self.dropped;
        self.waiting.retain(|of| {
            let keeps = which(of);
            if !keeps {
                dropped.count(of.met);
            }
            keeps
        });
    }
}

impl Dropped {
    fn count(&mut self, met: bool) {
        self.misfits += u64::from(met);
        self.alone += u64::from(!met);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn taken(sync: &mut StampSync<i64, i64>) -> Option<i64> {
        sync.take(|stamp_ns, _, _| Joined::Whole(stamp_ns))
    }

    fn alone(images: u64, infos: u64) -> [Dropped; 2] {
        [images, infos].map(|alone| Dropped { alone, misfits: 0 })
    }

    fn stamps(sync: &mut StampSync<i64, i64>) -> Vec<i64> {
        std::iter::from_fn(|| taken(sync)).collect()
    }

    #[test]
    fn pairs_leave_in_order_and_what_is_older_is_counted() {
        let mut sync = StampSync::new(10);
        for stamp in [1, 2, 3, 4] {
            sync.push_image(stamp, stamp);
        }
        for stamp in [4, 2] {
            sync.push_info(stamp, stamp);
        }
        assert_eq!((stamps(&mut sync), sync.take_dropped()), (vec![2, 4], alone(2, 0)));
        sync.push_image(3, 3);
        sync.push_info(3, 3);
        assert_eq!((stamps(&mut sync), sync.take_dropped()), (vec![], alone(1, 1)));
    }

    #[test]
    fn a_bad_message_does_not_take_the_place_of_a_good_one() {
        // Two and three are sizes; nothing fits a zero.
        let join = |stamp_ns: i64, image: &i64, info: &i64| match (*image, *info) {
            (0, _) => Joined::BadImage,
            (image, info) if image != info => Joined::Apart,
            _ => Joined::Whole(stamp_ns),
        };
        for (images, infos) in
            [([0, 2], [0, 2]), ([2, 0], [2, 0]), ([0, 2], [2, 0]), ([3, 2], [2, 0]), ([2, 3], [0, 2])]
        {
            let mut sync = StampSync::new(10);
            let mut whole = Vec::new();
            for (image, info) in images.into_iter().zip(infos) {
                sync.push_image(5, image);
                whole.extend(sync.take(join));
                sync.push_info(5, info);
                whole.extend(sync.take(join));
            }
            assert_eq!(whole, [5], "{images:?} {infos:?}");
            // What went on is never counted.
            assert!(sync.take_dropped().iter().all(|of| of.misfits + of.alone <= 1));
        }
    }

    #[test]
    fn what_does_not_fit_is_asked_and_counted_once() {
        let (mut sync, mut asked) = (StampSync::new(10), 0);
        sync.push_image(5, 2);
        sync.push_info(5, 3);
        for _ in 0..3 {
            let none = sync.take(|_, _, _| {
                asked += 1;
                Joined::<()>::Apart
            });
            assert!(none.is_none());
        }
        sync.expire(Instant::now() + PATIENCE);
        assert_eq!((asked, sync.waiting()), (1, (0, 0)));
        assert_eq!(sync.take_dropped(), [Dropped { alone: 0, misfits: 1 }; 2]);
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
        assert_eq!(taken(&mut sync), Some(future));
        sync.push_image(31, 31);
        sync.push_info(31, 31);
        assert_eq!(stamps(&mut sync), [31]);
    }

    #[test]
    fn what_never_completes_is_bounded_in_number_and_time() {
        let mut sync = StampSync::<_, ()>::new(3);
        for stamp in 0..100 {
            sync.push_image(stamp, ());
        }
        assert_eq!((sync.waiting(), sync.take_dropped()), ((3, 0), alone(97, 0)));
        sync.push_info(-5, ());
        sync.expire(Instant::now());
        assert_eq!(sync.waiting(), (3, 1));
        sync.expire(Instant::now() + PATIENCE);
        assert_eq!((sync.waiting(), sync.take_dropped()), ((0, 0), alone(3, 1)));
    }

    #[test]
    fn a_clock_that_jumps_back_begins_anew() {
        let mut sync = StampSync::new(3);
        for stamp in [5_000_000_000, 1] {
            sync.push_image(stamp, stamp);
            sync.push_info(stamp, stamp);
            assert_eq!(taken(&mut sync), Some(stamp));
        }
    }

    proptest! {
        #[test]
        fn all_pairs_leave_whatever_the_order_within_the_depth(order in Just((0..20_i64).collect::<Vec<_>>()).prop_shuffle()) {
            let mut sync = StampSync::new(20);
            (0..20).for_each(|stamp| sync.push_image(stamp, stamp));
            order.into_iter().for_each(|stamp| sync.push_info(stamp, stamp));
            prop_assert_eq!(stamps(&mut sync), (0..20).collect::<Vec<_>>());
            prop_assert_eq!(sync.take_dropped(), alone(0, 0));
        }
    }
}
