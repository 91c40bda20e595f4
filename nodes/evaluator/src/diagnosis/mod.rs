//! What is wrong with poses: depth, rotation, visibility, the gate, and what the estimates claim about themselves.
//! Everything follows from the errors of the instances, so that an old report can be diagnosed again.

mod claims;
mod gate;

pub use claims::{ConfidenceBin, ConfidenceCalibration, Coverage};
pub use gate::{Changes, GateCalibration};

use crate::InstanceErrors;
use crate::report::median;
use pseudoflow_metrics::recall;
use serde::{Deserialize, Serialize};

/// The bins of the visible share; the last one includes 1.
pub const VISIBLE_BINS: [[f64; 2]; 6] = [[0.0, 0.1], [0.1, 0.4], [0.4, 0.6], [0.6, 0.8], [0.8, 0.9], [0.9, 1.0]];

/// What is wrong with the poses of one set: all, or those of one object.
///
/// Medians are over what has an estimate, shares over all instances. The depth of a pose is that of the middle of the
/// object's bounding box. "With the true depth" means: the estimate is moved along the viewing ray of that middle, whose
/// projection so stays, to its true depth; rotation and place in the image remain the estimate's.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Diagnosis {
    /// True instances.
    pub n: usize,
    /// Median rotation error against the nearest symmetric truth, degrees.
    pub median_rotation_deg: Option<f64>,
    /// Median of the mean projection error, pixels of the image.
    pub median_projection_px: Option<f64>,
    /// Median of the depth error, diameters: positive is too far.
    pub median_depth_of_diameter: Option<f64>,
    /// Median size of the depth error, diameters.
    pub median_abs_depth_of_diameter: Option<f64>,
    /// Share with ADD(-S) below a tenth of the diameter.
    pub add_s_recall: f64,
    /// The same with the true depth.
    pub add_s_recall_true_depth: f64,
    /// The same by visible share, where the dataset knows it; empty bins are left out.
    pub by_visible_share: Vec<VisibleBin>,
    /// Against the first set of the report; `None` for that one.
    pub changes: Option<Changes>,
    /// `None` where no gate decided, or nothing is known of its decisions.
    pub gate: Option<GateCalibration>,
    /// `None` where no confidence is given.
    pub confidence: Option<ConfidenceCalibration>,
    /// `None` where no covariance is given.
    pub coverage: Option<Coverage>,
}

/// The instances whose visible share lies in a bin.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct VisibleBin {
    /// Lowest visible share.
    pub from: f64,
    /// Highest visible share, not included but in the last bin.
    pub to: f64,
    /// Instances.
    pub n: usize,
    /// Share with ADD(-S) below a tenth of the diameter.
    pub add_s_recall: f64,
    /// Median rotation error of what has an estimate, degrees.
    pub median_rotation_deg: Option<f64>,
}

impl Diagnosis {
    /// Of some instances of a set, and the same instances in the report's first set (empty for the first itself).
    #[must_use]
    pub fn of(instances: &[&InstanceErrors], first: &[&InstanceErrors]) -> Self {
        let n = instances.len();
        let over = |f: &dyn Fn(&InstanceErrors) -> Option<f64>| median(instances.iter().filter_map(|i| f(i)));
        let share = |f: &dyn Fn(&InstanceErrors) -> bool| recall(instances.iter().filter(|i| f(i)).count(), n);
        Self {
            n,
            median_rotation_deg: over(&|i| i.rotation_deg),
            median_projection_px: over(&|i| i.projection_px),
            median_depth_of_diameter: over(&|i| i.depth_of_diameter),
            median_abs_depth_of_diameter: over(&|i| i.depth_of_diameter.map(f64::abs)),
            add_s_recall: share(&|i| i.add_s_correct),
            add_s_recall_true_depth: share(&|i| i.add_s_true_depth_of_diameter.is_some_and(|e| e < RIGHT)),
            by_visible_share: by_visible_share(instances),
            changes: Changes::between(first, instances),
            gate: GateCalibration::of(instances),
            confidence: ConfidenceCalibration::of(instances),
            coverage: Coverage::of(instances),
        }
    }
}

/// ADD(-S)-0.1d: below this many diameters an estimate is right.
pub(crate) const RIGHT: f64 = 0.1;

fn by_visible_share(instances: &[&InstanceErrors]) -> Vec<VisibleBin> {
    let bin = |&[from, to]: &[f64; 2]| {
        let inside = |v: f64| (from..to).contains(&v) || (to >= 1.0 && v >= to);
        let these: Vec<&&InstanceErrors> =
            instances.iter().filter(|i| i.visible_fraction.is_some_and(inside)).collect();
        let right = these.iter().filter(|i| i.add_s_correct).count();
        (!these.is_empty()).then(|| VisibleBin {
            from,
            to,
            n: these.len(),
            add_s_recall: recall(right, these.len()),
            median_rotation_deg: median(these.iter().filter_map(|i| i.rotation_deg)),
        })
    };
    VISIBLE_BINS.iter().filter_map(bin).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn instance(visible: f64, depth: f64, right: bool) -> InstanceErrors {
        InstanceErrors {
            visible_fraction: Some(visible),
            depth_of_diameter: Some(depth),
            add_s_true_depth_of_diameter: Some(0.05),
            add_s_correct: right,
            rotation_deg: Some(3.0),
            ..InstanceErrors::default()
        }
    }

    #[test]
    fn depth_has_a_sign_and_a_size() {
        let all = [instance(1.0, -0.2, false), instance(0.95, 0.05, true), instance(0.3, 0.1, true)];
        let found = Diagnosis::of(&all.iter().collect::<Vec<_>>(), &[]);
        assert_eq!(found.median_depth_of_diameter, Some(0.05));
        assert_eq!(found.median_abs_depth_of_diameter, Some(0.1));
        assert_eq!((found.add_s_recall, found.add_s_recall_true_depth), (2.0 / 3.0, 1.0));
        assert!(found.gate.is_none() && found.confidence.is_none() && found.coverage.is_none());
    }

    #[test]
    fn every_instance_of_known_visibility_is_in_one_bin() {
        let all: Vec<InstanceErrors> = (0..=20).map(|i| instance(f64::from(i) / 20.0, 0.0, i > 12)).collect();
        let bins = Diagnosis::of(&all.iter().collect::<Vec<_>>(), &[]).by_visible_share;
        assert_eq!(bins.iter().map(|b| b.n).sum::<usize>(), all.len());
        assert_eq!(bins.last().map(|b| (b.n, b.add_s_recall)), Some((3, 1.0)));
        assert_eq!(bins[0].add_s_recall, 0.0);
        let unknown = InstanceErrors { visible_fraction: None, ..instance(1.0, 0.0, true) };
        assert!(Diagnosis::of(&[&unknown], &[]).by_visible_share.is_empty());
    }
}
