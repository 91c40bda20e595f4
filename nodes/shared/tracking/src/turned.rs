//! The same silhouette from the other side: a bottle that is followed back to front is followed well by its contour, and a look from there
//! agrees with it. What tells is the mesh's texture.

use crate::compare::ANCHOR_CONTRAST;
use crate::measure::Trial;
use crate::tracker::{Now, Tracker};
use pseudoflow_geometry::Pose;
use pseudoflow_imaging::Mesh;

/// A picture as like the mesh as this shows no other side, correlation.
const LIKE: f64 = 0.7;
/// How much more like the mesh the picture must be at the turned pose, and how like it at least.
const GAIN: f64 = 0.15;
const LEAST: f64 = 0.35;
/// How much less sure the contour may be of the turned pose.
const CONTOUR_LOSS: f64 = 0.2;

impl Tracker {
    /// The object turned by half a turn about an axis of its box, another each time, where the picture is clearly more like the mesh that
    /// way.
    pub(crate) fn turned(&mut self, i: usize, now: &Now<'_>, own: &Trial, poses: &[Pose]) -> Option<Trial> {
        let before = self.tracks[i].likeness.filter(|l| l.contrast > ANCHOR_CONTRAST && l.correlation < LIKE)?;
        if own.evidence.seen() < self.config.min_seen || !self.tracks[i].turning.is_due(before.correlation) {
            return None;
        }
        let axis = self.tracks[i].turns % 3;
        self.tracks[i].turns += 1;
        let start = own.pose * half_turn(&self.objects[self.tracks[i].object].mesh, axis);
        let trial = self.follow_contour(i, &now.reaching_far(), &start, poses);
        let trial = self.compared(i, now, &trial, poses);
        let trial = self.polished(i, now, trial, &start, poses);
        let taken = trial.evidence.likeness > (before.correlation + GAIN).max(LEAST)
            && trial.evidence.seen() >= self.config.min_seen
            && trial.evidence.of_contour() > own.evidence.of_contour() - CONTOUR_LOSS
            && !self.near(i, &own.pose, &trial.pose);
        self.tracks[i].turning.note(before.correlation, taken);
        log::debug!(
            "frame {}, object {}: turned about axis {axis}, {}: likeness {:.2} after {:.2}, contour {:.2} after {:.2}",
            now.frame.index,
            self.objects[self.tracks[i].object].id,
            if taken { "taken" } else { "not taken" },
            trial.evidence.likeness,
            before.correlation,
            trial.evidence.of_contour(),
            own.evidence.of_contour()
        );
        if !taken {
            return None;
        }
        self.jump(i, &own.pose, &trial.pose);
        // A look will say whether it is right.
        (self.tracks[i].disputed, self.tracks[i].texture_due) = (true, true);
        Some(trial)
    }
}

/// Half a turn about an axis (0: x, 1: y, 2: z) through the middle of a mesh's box: `object_from_turned_object`, metres.
///
/// # Panics
/// When there is no such axis.
#[must_use]
pub fn half_turn(mesh: &Mesh, axis: usize) -> Pose {
    let corners = mesh.box_corners_m();
    let middle = (corners[0].coords + corners[7].coords) / 2.0;
    let mut turn = nalgebra::Vector3::zeros();
    turn[axis] = std::f64::consts::PI;
    let there = Pose::translation(middle.x, middle.y, middle.z);
    there * Pose::rotation(turn) * there.inverse()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use pseudoflow_imaging::shapes::cuboid;

    #[test]
    fn half_a_turn_changes_two_sides_of_the_box() {
        let mesh = cuboid([0.1, 0.2, 0.3], [9; 3]).unwrap();
        let turned = half_turn(&mesh, 1) * Point3::new(0.05, 0.1, 0.15);
        assert!((turned - Point3::new(-0.05, 0.1, -0.15)).norm() < 1e-9, "{turned}");
    }
}
