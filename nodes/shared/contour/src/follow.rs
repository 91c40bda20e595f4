//! From frame to frame: the colours are those of the frames before, and counted only where a pose is believed.

use crate::RegionStatus;
use crate::histogram::Colours;
use crate::refine::{Refiner, Region, Task, Term};
use pseudoflow_geometry::Pose;

impl Refiner {
    /// As [`Refiner::refine`] from one start, with colours that are known already; they stay as they are.
    pub fn follow(
        &mut self,
        task: &Task<'_>,
        start: &Pose,
        colours: &mut Colours,
        mut term: Option<&mut dyn Term>,
    ) -> Region {
        // What was counted in an earlier frame is no longer to be learnt.
        colours.0.counted_at = None;
        self.with(colours, |this| match this.open(task) {
            RegionStatus::Ok => this.descend(task, start, &mut term),
            unseen => this.without_contour(task, start, unseen, &mut term),
        })
    }

    /// Counts the colours at a pose in the task's picture: `renewal` of the new and the rest of the old (all of the new at first).
    /// False, and the old ones stay, when too little is seen of one side. What [`Refiner::follow`] has just found costs nothing: its
    /// colours were counted then.
    pub fn learn(&mut self, task: &Task<'_>, pose: &Pose, colours: &mut Colours, renewal: f32) -> bool {
        self.with(colours, |this| this.has_counted(task, pose) && this.histograms.renew(renewal))
    }

    fn has_counted(&mut self, task: &Task<'_>, pose: &Pose) -> bool {
        if self.histograms.counted_at == Some(*pose) {
            return true;
        }
        if !self.open(task).is_ok() {
            return false;
        }
        self.place_lines(task.model, pose);
        self.count_colours_for(pose)
    }

    fn with<T>(&mut self, colours: &mut Colours, work: impl FnOnce(&mut Self) -> T) -> T {
        std::mem::swap(&mut self.histograms, &mut colours.0);
        self.kept = true;
        let out = work(self);
        self.kept = false;
        std::mem::swap(&mut self.histograms, &mut colours.0);
        out
    }
}
