use super::RIGHT;
use crate::report::median;
use crate::{GateErrors, InstanceErrors};
use pseudoflow_metrics::recall;
use serde::{Deserialize, Serialize};

/// What became of the instances from one set to another.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Changes {
    /// Right before (ADD(-S) below a tenth of the diameter).
    pub right_before: usize,
    /// Of these wrong after.
    pub spoilt: usize,
    /// Wrong before.
    pub wrong_before: usize,
    /// Of these right after.
    pub mended: usize,
}

impl Changes {
    /// `None` unless both sides are the same instances.
    pub(super) fn between(before: &[&InstanceErrors], after: &[&InstanceErrors]) -> Option<Self> {
        let same = before.len() == after.len() && before.iter().zip(after).all(|(b, a)| b.key() == a.key());
        if !same || after.is_empty() {
            return None;
        }
        let mut found = Self::default();
        for (b, a) in before.iter().zip(after) {
            match b.add_s_correct {
                true => {
                    (found.right_before, found.spoilt) =
                        (found.right_before + 1, found.spoilt + usize::from(!a.add_s_correct))
                }
                false => {
                    (found.wrong_before, found.mended) =
                        (found.wrong_before + 1, found.mended + usize::from(a.add_s_correct))
                }
            }
        }
        Some(found)
    }
}

/// Whether the gate was right: over all its decisions, of every pass.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct GateCalibration {
    /// Refinements that replaced what they began from.
    pub accepted: usize,
    /// Share of these with a smaller ADD(-S) than before.
    pub accepted_improved: f64,
    /// Median of their gain in ADD(-S), diameters: positive is better.
    pub accepted_median_gain: Option<f64>,
    /// Of these: right before and wrong after.
    pub accepted_spoilt: usize,
    /// Of these: wrong before and right after.
    pub accepted_mended: usize,
    /// Refinements that did not.
    pub refused: usize,
    /// Share of these that would have been worse.
    pub refused_worse: f64,
    /// Median of the gain that they would have brought, diameters.
    pub refused_median_gain: Option<f64>,
    /// Of these: would have gone from right to wrong.
    pub refused_saved: usize,
    /// Of these: would have gone from wrong to right.
    pub refused_missed: usize,
}

impl GateCalibration {
    pub(super) fn of(instances: &[&InstanceErrors]) -> Option<Self> {
        let all = instances.iter().flat_map(|i| &i.gate);
        let (accepted, refused): (Vec<&GateErrors>, Vec<&GateErrors>) = all.partition(|step| step.accepted);
        let gain = |steps: &[&GateErrors]| median(steps.iter().map(|s| s.before_of_diameter - s.after_of_diameter));
        let count = |steps: &[&GateErrors], f: &dyn Fn(&GateErrors) -> bool| steps.iter().filter(|s| f(s)).count();
        let spoils = |s: &GateErrors| s.before_of_diameter < RIGHT && s.after_of_diameter >= RIGHT;
        let mends = |s: &GateErrors| s.before_of_diameter >= RIGHT && s.after_of_diameter < RIGHT;
        let improves = |s: &GateErrors| s.after_of_diameter < s.before_of_diameter;
        (!accepted.is_empty() || !refused.is_empty()).then(|| Self {
            accepted: accepted.len(),
            accepted_improved: recall(count(&accepted, &improves), accepted.len()),
            accepted_median_gain: gain(&accepted),
            accepted_spoilt: count(&accepted, &spoils),
            accepted_mended: count(&accepted, &mends),
            refused: refused.len(),
            refused_worse: recall(count(&refused, &|s| !improves(s)), refused.len()),
            refused_median_gain: gain(&refused),
            refused_saved: count(&refused, &spoils),
            refused_missed: count(&refused, &mends),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(before: f64, after: f64, accepted: bool) -> GateErrors {
        GateErrors { before_of_diameter: before, after_of_diameter: after, accepted, ..Default::default() }
    }

    #[test]
    fn decisions_of_all_passes_are_judged() {
        let first = InstanceErrors { gate: vec![step(0.3, 0.05, true), step(0.05, 0.2, false)], ..Default::default() };
        let second = InstanceErrors { gate: vec![step(0.05, 0.25, true)], ..Default::default() };
        let third = InstanceErrors { gate: vec![step(0.4, 0.02, false)], ..Default::default() };
        let found = GateCalibration::of(&[&first, &second, &third]).unwrap();
        assert_eq!((found.accepted, found.accepted_improved), (2, 0.5));
        assert_eq!((found.accepted_spoilt, found.accepted_mended), (1, 1));
        assert_eq!((found.refused, found.refused_worse), (2, 0.5));
        assert_eq!((found.refused_saved, found.refused_missed), (1, 1));
        assert!((found.accepted_median_gain.unwrap() - 0.025).abs() < 1e-12);
        assert_eq!(GateCalibration::of(&[&InstanceErrors::default()]), None);
    }

    #[test]
    fn changes_pair_the_same_instances_only() {
        let of = |image_id, right| InstanceErrors { image_id, add_s_correct: right, ..Default::default() };
        let (before, after) = ([of(1, true), of(2, false), of(3, true)], [of(1, false), of(2, true), of(3, true)]);
        let refs = |all: &'static [InstanceErrors]| all.iter().collect::<Vec<_>>();
        let (before, after) = (refs(Box::leak(Box::new(before))), refs(Box::leak(Box::new(after))));
        let found = Changes::between(&before, &after).unwrap();
        assert_eq!(found, Changes { right_before: 2, spoilt: 1, wrong_before: 1, mended: 1 });
        assert_eq!(Changes::between(&before[1..], &after[..2]), None);
        assert_eq!(Changes::between(&[], &after), None);
    }
}
