use crate::source::FrameFacts;
use crate::{FrameSource, LoadedFrame, PlayerError};
use std::collections::BTreeMap;

/// Several recordings one behind the other, as one.
pub(crate) struct Concatenated(pub(crate) Vec<Box<dyn FrameSource>>);

impl Concatenated {
    /// Which recording a frame is of, and its number there.
    fn place(&self, mut number: usize) -> (usize, usize) {
        let mut recording = 0;
        while number >= self.0[recording].count() {
            number -= self.0[recording].count();
            recording += 1;
        }
        (recording, number)
    }
}

impl FrameSource for Concatenated {
    fn count(&self) -> usize {
        self.0.iter().map(|source| source.count()).sum()
    }

    fn objects(&self) -> BTreeMap<u32, usize> {
        let (mut objects, mut first) = (BTreeMap::new(), 0);
        for source in &self.0 {
            for (object_id, number) in source.objects() {
                objects.entry(object_id).or_insert(first + number);
            }
            first += source.count();
        }
        objects
    }

    fn facts(&mut self, number: usize) -> Result<FrameFacts, PlayerError> {
        let (recording, number) = self.place(number);
        self.0[recording].facts(number)
    }

    fn load(&mut self, number: usize) -> Result<LoadedFrame, PlayerError> {
        let (recording, number) = self.place(number);
        self.0[recording].load(number)
    }
}
