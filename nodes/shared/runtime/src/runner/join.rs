use std::collections::BTreeMap;

/// Collects the messages of frames until all inputs of a frame are there.
#[derive(Debug)]
pub(super) struct Join<M> {
    inputs: usize,
    most_frames: usize,
    frames: BTreeMap<u64, Vec<Option<M>>>,
}

impl<M> Join<M> {
    /// Joins so many inputs and holds at most so many frames.
    pub(super) fn new(inputs: usize, most_frames: usize) -> Self {
        Self { inputs, most_frames, frames: BTreeMap::new() }
    }

    /// Adds a message; of two for the same place the first stays (they are equal). The oldest frame goes when there
    /// are too many.
    pub(super) fn insert(&mut self, index: u64, input: usize, message: M) {
        let inputs = self.inputs;
        let place = &mut self.frames.entry(index).or_insert_with(|| (0..inputs).map(|_| None).collect())[input];
        if place.is_none() {
            *place = Some(message);
        }
        if self.frames.len() > self.most_frames {
            self.frames.pop_first();
        }
    }

    /// Gives up all frames below `index`; counts the whole ones (what never became whole was given up by another).
    pub(super) fn drop_below(&mut self, index: u64) -> u64 {
        let whole = self.complete().take_while(|whole| *whole < index).count() as u64;
        self.frames = self.frames.split_off(&index);
        whole
    }

    fn complete(&self) -> impl DoubleEndedIterator<Item = u64> + '_ {
        self.frames.iter().filter(|(_, messages)| messages.iter().all(Option::is_some)).map(|(index, _)| *index)
    }

    /// The first frame not above `most` that is whole.
    pub(super) fn first_complete(&self, most: u64) -> Option<u64> {
        self.complete().next().filter(|index| *index <= most)
    }

    /// Gives a frame up, whole or not; it takes no place.
    pub(super) fn give_up(&mut self, index: u64) {
        self.frames.remove(&index);
    }

    /// The frames that are whole.
    pub(super) fn complete_newest_first(&self) -> Vec<u64> {
        self.complete().rev().collect()
    }

    /// Takes a whole frame out.
    pub(super) fn take(&mut self, index: u64) -> Option<Vec<M>> {
        self.frames.remove(&index).map(|messages| messages.into_iter().flatten().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_whole_when_every_input_came() {
        let mut join = Join::new(2, 8);
        join.insert(4, 0, "4a");
        join.insert(5, 0, "5a");
        join.insert(5, 1, "5b");
        assert_eq!(
            (join.first_complete(9), join.first_complete(4), join.complete_newest_first()),
            (Some(5), None, vec![5])
        );
        join.insert(4, 0, "another 4a");
        join.insert(4, 1, "4b");
        assert_eq!((join.first_complete(9), join.complete_newest_first()), (Some(4), vec![5, 4]));
        assert_eq!(join.take(4), Some(vec!["4a", "4b"]));
        assert_eq!((join.drop_below(6), join.first_complete(9)), (1, None));
    }

    #[test]
    fn frames_given_up_take_nobodys_place() {
        let mut join = Join::new(2, 2);
        join.insert(1, 0, "1a");
        (2..20).for_each(|index| join.give_up(index));
        join.insert(1, 1, "1b");
        join.insert(20, 0, "20a");
        join.give_up(20);
        assert_eq!((join.complete_newest_first(), join.drop_below(30)), (vec![1], 1));
    }

    #[test]
    fn the_oldest_goes_when_too_many_wait() {
        let mut join = Join::new(2, 2);
        for index in 1..=3 {
            join.insert(index, 0, ());
        }
        join.insert(2, 1, ());
        assert_eq!(join.complete_newest_first(), [2]);
        assert_eq!(join.drop_below(10), 1, "one was whole");
        assert!(join.complete_newest_first().is_empty());
    }
}
