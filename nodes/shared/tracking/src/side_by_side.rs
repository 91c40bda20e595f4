//! The objects of a frame side by side: a camera's next frame does not wait for one core.
//!
//! Work for an object reads all tracks and changes its own alone. So each object gets a copy of the tracker to work on, of which its
//! own track is kept: the outcome hangs neither on the number of threads nor on who is done first. A copy holds no colours and no
//! keyframes but the object's own, and shares what is large.

use crate::measure::Measurer;
use crate::texture::Maker;
use crate::track::Track;
use crate::tracker::{Now, Tracker};
use pseudoflow_geometry::Pose;
use rayon::prelude::*;
use std::sync::Arc;

/// What one thread works with: settings and working memory, nothing that outlasts a frame.
#[derive(Debug)]
pub(crate) struct Tools {
    pub(crate) measurer: Measurer,
    pub(crate) maker: Maker,
}

impl Tools {
    pub(crate) fn new(measurer: Measurer) -> Self {
        Self { measurer, maker: Maker::default() }
    }
}

impl Tracker {
    /// Does something for several objects at once; what it gives for each, in their order.
    pub(crate) fn side_by_side<T: Send>(
        &mut self,
        objects: &[usize],
        work: impl Fn(&mut Self, usize) -> T + Sync,
    ) -> Vec<T> {
        if let [one] = objects {
            return vec![work(self, *one)];
        }
        let mut copies: Vec<(usize, Self)> = objects.iter().map(|i| (*i, self.lend(*i))).collect();
        let done = copies.par_iter_mut().map(|(i, copy)| work(copy, *i)).collect();
        for (i, mut copy) in copies {
            self.tracks[i] = copy.tracks.swap_remove(i);
            self.spare.push(copy.tools);
        }
        done
    }

    /// A copy that knows of the other objects what can be seen of them, and has all of object `i`.
    fn lend(&mut self, i: usize) -> Self {
        let copied = |(j, track): (usize, &mut Track)| {
            let outside = track.seen_from_outside();
            if j == i { std::mem::replace(track, outside) } else { outside }
        };
        let tracks = self.tracks.iter_mut().enumerate().map(copied).collect();
        let tools = self.spare.pop().unwrap_or_else(|| Tools::new(self.tools.measurer.clone()));
        Self {
            config: Arc::clone(&self.config),
            objects: Arc::clone(&self.objects),
            tracks,
            tools,
            spare: Vec::new(),
            last: self.last,
            recent: self.recent.clone(),
            camera: self.camera,
            budget: self.budget,
            looks_come: self.looks_come,
        }
    }

    /// The objects in the order in which they are measured, those together that are measured side by side. From frame to frame of a
    /// camera all are: where a nearer one is predicted is as good as where it is, for what it hides. After a long gap it is not.
    pub(crate) fn groups(&self, now: &Now<'_>, predicted: &[Pose]) -> Vec<Vec<usize>> {
        let order = self.by_depth(predicted);
        match self.after_long_gap(now) {
            true => order.into_iter().map(|i| vec![i]).collect(),
            false => vec![order],
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::tests::{K, object, step, truth};
    use crate::{Correction, CorrectionKind, Estimate, KnownObject, Tracker, TrackingConfig};
    use pseudoflow_geometry::Pose;
    use pseudoflow_imaging::RgbImage;
    use pseudoflow_imaging::raster::{Background, Headlight, Item, Rendering, Scene, Scratch, render_scene};

    /// Two boxes that turn, the second half behind the first.
    fn poses(frame: u64) -> [Pose; 2] {
        let first = truth(frame);
        [first, Pose::translation(0.08, 0.02, 0.12) * first * Pose::rotation([0.4, 0.0, 0.3].into())]
    }

    fn picture(frame: u64) -> RgbImage {
        let items = poses(frame).map(|camera_from_object| Item { mesh: &object().mesh, camera_from_object });
        let background = Background::Colour([90, 120, 60]);
        let scene = Scene { items: &items, intrinsics: K, width: 320, height: 240, background };
        let mut out = Rendering::new(320, 240);
        render_scene(&scene, &Headlight::default(), &mut Scratch::default(), &mut out);
        out.rgb
    }

    /// What is said of each of some frames, by so many threads.
    fn followed(threads: usize) -> Vec<Vec<Estimate>> {
        let objects = [4, 5].map(|id| KnownObject { id, ..object().clone() });
        let mut tracker = Tracker::new(objects.to_vec(), TrackingConfig::default()).unwrap();
        let found = |(id, pose): (u32, Pose)| Correction {
            object_id: id,
            frame: 0,
            camera_from_object: Pose::translation(0.002, -0.001, 0.006) * pose,
            kind: CorrectionKind::Found,
        };
        let mut news: Vec<Correction> = [4, 5].into_iter().zip(poses(0)).map(found).collect();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            (0..12).map(|i| step(&mut tracker, i, &picture(i), &std::mem::take(&mut news)).estimates).collect()
        })
    }

    #[test]
    fn one_thread_and_three_say_the_same_to_the_bit() {
        let (one, three) = (followed(1), followed(3));
        assert_eq!(one, three);
        let last = &one[11];
        assert_eq!(last.len(), 2);
        for (estimate, there) in last.iter().zip(poses(11)) {
            let off_m = (estimate.camera_from_object.translation.vector - there.translation.vector).norm();
            assert!(estimate.measured && off_m < 0.01, "object {}: {off_m} m", estimate.object_id);
        }
    }
}
