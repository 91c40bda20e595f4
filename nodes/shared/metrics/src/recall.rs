//! From errors to shares: the thresholds of the BOP Challenge 2019 and the area under the accuracy curve.

/// How far the outermost point may move between two steps of a continuous symmetry, in diameters (bop_toolkit
/// `eval_bop19_pose.py`, `max_sym_disc_step`).
pub const MAX_SYM_DISC_STEP: f64 = 0.01;

/// Without a target list, truth that is visible to less than this share is not looked for (bop_toolkit,
/// `visib_gt_min`).
pub const VISIB_GT_MIN: f64 = 0.1;

/// The largest threshold of the accuracy curve of [`auc_to_10cm`], metres.
pub const AUC_LIMIT_M: f64 = 0.10;

/// `start, start + step, ...` as numpy's `arange` computes it.
fn steps(start: f64, step: f64) -> [f64; 10] {
    std::array::from_fn(|i| start + i as f64 * step)
}

/// Thresholds of MSSD in diameters: 0.05 to 0.5.
#[must_use]
pub fn mssd_thresholds() -> [f64; 10] {
    steps(0.05, 0.05)
}

/// Thresholds of MSPD in pixels of an image 640 wide (see [`crate::mspd_scale`]): 5 to 50.
#[must_use]
pub fn mspd_thresholds() -> [f64; 10] {
    steps(5.0, 5.0)
}

/// Misalignment tolerances of VSD in diameters: 0.05 to 0.5.
#[must_use]
pub fn vsd_taus() -> [f64; 10] {
    steps(0.05, 0.05)
}

/// Thresholds of VSD: 0.05 to 0.5.
#[must_use]
pub fn vsd_thresholds() -> [f64; 10] {
    steps(0.05, 0.05)
}

/// The threshold of ADD(-S)-0.1d, metres: a tenth of the diameter (Hinterstoisser et al., ACCV 2012, k_m = 0.1).
#[must_use]
pub fn add_threshold_m(diameter_m: f64) -> f64 {
    0.1 * diameter_m
}

/// The share of targets that were found; 0 when there are none (bop_toolkit `score.calc_recall`).
#[must_use]
pub fn recall(found: usize, targets: usize) -> f64 {
    if targets == 0 { 0.0 } else { found as f64 / targets as f64 }
}

/// Area under the accuracy-threshold curve of ADD(-S) for thresholds from 0 to 10 cm, as a share of 1 (Xiang et al.,
/// PoseCNN, RSS 2018, sec. V-C). This is the exact area, the mean of `max(0, 1 - error / 10 cm)`; the toolbox of
/// PoseCNN takes the upper end of each step and is larger by less than 1 / n. What was not found counts as an
/// infinite error.
#[must_use]
pub fn auc_to_10cm(errors_m: &[f64]) -> f64 {
    if errors_m.is_empty() {
        return 0.0;
    }
    let share = |e: &f64| if e.is_nan() { 0.0 } else { (1.0 - e / AUC_LIMIT_M).max(0.0) };
    errors_m.iter().map(share).sum::<f64>() / errors_m.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_area_is_that_of_the_step_curve() {
        let errors = [0.01, 0.02, 0.05, 0.2, f64::INFINITY];
        let n = 100_000;
        let accuracy = |t: f64| errors.iter().filter(|e| **e < t).count() as f64 / errors.len() as f64;
        let area =
            (0..n).map(|i| accuracy((f64::from(i) + 0.5) / f64::from(n) * AUC_LIMIT_M)).sum::<f64>() / f64::from(n);
        assert!((auc_to_10cm(&errors) - area).abs() < 1e-4);
        assert_eq!(auc_to_10cm(&[]), 0.0);
        assert_eq!(auc_to_10cm(&[0.0]), 1.0);
    }

    #[test]
    fn thresholds_are_those_of_the_benchmark() {
        assert_eq!(mssd_thresholds()[2], 0.15000000000000002); // numpy.arange(0.05, 0.51, 0.05)[2]
        assert_eq!(mspd_thresholds(), [5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0, 50.0]);
        assert_eq!(vsd_taus()[9], 0.5);
    }
}
