//! From frame to frame: the colours are those of the frames before, and counted only where a pose is believed.

use crate::RegionStatus;
use crate::histogram::Colours;
use crate::refine::{Refiner, Region, Task, Term};
use nalgebra::{Matrix6, Vector6};
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
        self.with(colours, |this| match this.open(task) {
            RegionStatus::Ok => this.descend(task, start, &mut term),
            unseen => this.without_contour(task, start, unseen, &mut term),
        })
    }

    /// What the contour says of a pose as it is, in the picture that the last call of [`Refiner::follow`] opened.
    pub fn weigh(
        &mut self,
        task: &Task<'_>,
        pose: &Pose,
        colours: &mut Colours,
        mut term: Option<&mut dyn Term>,
    ) -> Region {
        self.with(colours, |this| match this.begin(task.model, pose) {
            RegionStatus::Ok => {
                let mut information = Matrix6::zeros();
                task.prior.accumulate(pose, &mut information, &mut Vector6::zeros());
                this.judge(task, pose, information, pose, &mut term)
            }
            unseen => this.without_contour(task, pose, unseen, &mut None),
        })
    }

    /// Counts the colours at a pose in the picture that was opened last: `renewal` of the new and the rest of the old (all of the
    /// new at first). False, and the old ones stay, when too little is seen of one side, or both have the same colours.
    pub fn learn(&mut self, task: &Task<'_>, pose: &Pose, colours: &mut Colours, renewal: f32) -> bool {
        self.with(colours, |this| {
            this.place_lines(task.model, pose);
            if this.used() < this.config.min_lines {
                return false;
            }
            this.count_colours();
            this.histograms.renew(renewal)
        })
    }

    /// Opens the picture around the task's prior, for [`Refiner::learn`] and [`Refiner::weigh`].
    pub fn look_at(&mut self, task: &Task<'_>) -> RegionStatus {
        self.open(task)
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
