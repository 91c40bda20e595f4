//! A detector's answer of the past, looked through object by object: what is found is the fresher, the fewer are looked for at once.

use crate::patience::Patience;
use pseudoflow_msgs::{CameraFrameHeader, DetectedFrame, FrameKey, Rectangle};

/// An image of the past and those of its rectangles that nobody has looked into yet.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) key: FrameKey,
    pub(crate) header: CameraFrameHeader,
    pub(crate) rgb: Vec<u8>,
    rectangles: Vec<Rectangle>,
}

impl Answer {
    pub(crate) fn new(key: FrameKey, seen: &DetectedFrame<'_>) -> Self {
        Self { key, header: *seen.header, rgb: seen.rgb.to_vec(), rectangles: seen.rectangles.to_vec() }
    }

    /// The rectangles to look into now: of the wanted objects those whose turn it is, all where nobody says what is wanted. They
    /// and those of objects that are not wanted are gone then.
    pub(crate) fn take_due(&mut self, wanted: Option<&[u32]>, patience: &mut Patience) -> Vec<Rectangle> {
        let Some(wanted) = wanted else { return std::mem::take(&mut self.rectangles) };
        patience.forget_all_but(wanted);
        self.rectangles.retain(|rectangle| wanted.contains(&rectangle.object_id));
        let here = |id: &u32| self.rectangles.iter().any(|rectangle| rectangle.object_id == *id);
        let candidates: Vec<u32> = wanted.iter().copied().filter(here).collect();
        let due = patience.turn(&patience.due(&candidates, self.key.stamp_ns), self.key.stamp_ns);
        self.rectangles.extract_if(.., |rectangle| due.contains(&rectangle.object_id)).collect()
    }

    /// Whether nothing is left to look into.
    pub(crate) fn is_done(&self) -> bool {
        self.rectangles.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SearchConfig;

    fn answer(stamp_ns: i64, objects: &[u32]) -> Answer {
        let rectangle =
            |id: &u32| Rectangle { object_id: *id, score: 0.5, left: 0.0, top: 0.0, right: 9.0, bottom: 9.0 };
        let header = CameraFrameHeader {
            width: 0,
            height: 0,
            scene_id: 0,
            image_id: 0,
            intrinsics: [1.0; 4],
            frame_id: [0; 64],
        };
        let rectangles = objects.iter().map(rectangle).collect();
        Answer { key: FrameKey { index: 0, stamp_ns }, header, rgb: Vec::new(), rectangles }
    }

    fn taken(answer: &mut Answer, wanted: Option<&[u32]>, patience: &mut Patience) -> Vec<u32> {
        let ids: Vec<u32> = answer.take_due(wanted, patience).iter().map(|r| r.object_id).collect();
        ids.iter().for_each(|id| patience.searched(*id, answer.key.stamp_ns, true));
        ids
    }

    #[test]
    fn wanted_objects_are_looked_for_one_at_a_time_and_in_turn() {
        let mut patience = Patience::new(SearchConfig::default());
        let mut first = answer(0, &[1, 2, 2, 3, 4]);
        assert_eq!(taken(&mut first, Some(&[2, 3, 7]), &mut patience), [2, 2]);
        assert_eq!(taken(&mut first, Some(&[2, 3, 7]), &mut patience), [3]);
        assert!(first.is_done(), "1 and 4 are not wanted");
        // A newer answer comes before all have been looked for: who has waited longest is first.
        let mut next = answer(1_000_000_000, &[2, 3]);
        assert_eq!(taken(&mut next, Some(&[2, 3, 7]), &mut patience), [2]);
        let mut last = answer(2_000_000_000, &[2, 3]);
        assert_eq!(taken(&mut last, Some(&[2, 3, 7]), &mut patience), [3]);
    }

    #[test]
    fn without_a_tracker_all_are_looked_for() {
        let mut all = answer(0, &[1, 2, 3]);
        assert_eq!(taken(&mut all, None, &mut Patience::new(SearchConfig::default())), [1, 2, 3]);
        assert!(all.is_done());
    }
}
