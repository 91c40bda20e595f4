/// Matches the estimates of one object in one image to its true instances, as bop_toolkit `pose_matching.match_poses`
/// does: in the order of falling score (equal scores in the order given), each estimate takes the valid, still free
/// instance of least error, if that error is below the threshold.
///
/// `errors[e][g]` is the error of estimate `e` against instance `g`; a NaN matches nothing. Only the `top` estimates
/// of highest score take part. Returns for each instance the estimate that found it.
#[must_use]
pub fn match_greedy(
    errors: &[Vec<f64>],
    scores: &[f64],
    valid: &[bool],
    threshold: f64,
    top: usize,
) -> Vec<Option<usize>> {
    let mut order: Vec<usize> = (0..errors.len()).collect();
    order.sort_by(|a, b| scores[*b].total_cmp(&scores[*a]));
    let mut found_by = vec![None; valid.len()];
    for e in order.into_iter().take(top) {
        let mut best = (None, threshold);
        for g in (0..valid.len()).filter(|g| valid[*g]) {
            if found_by[g].is_none() && errors[e][g] < best.1 {
                best = (Some(g), errors[e][g]);
            }
        }
        if let Some(g) = best.0 {
            found_by[g] = Some(e);
        }
    }
    found_by
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_confident_estimate_chooses_first() {
        let errors = vec![vec![0.1, 0.3], vec![0.05, 0.2]];
        assert_eq!(match_greedy(&errors, &[0.9, 0.5], &[true, true], 1.0, 2), [Some(0), Some(1)]);
        assert_eq!(match_greedy(&errors, &[0.5, 0.9], &[true, true], 1.0, 2), [Some(1), Some(0)]);
        assert_eq!(match_greedy(&errors, &[0.5, 0.5], &[true, true], 1.0, 2), [Some(0), Some(1)]);
    }

    #[test]
    fn the_threshold_is_strict_and_top_limits() {
        let errors = vec![vec![0.1], vec![0.2]];
        assert_eq!(match_greedy(&errors, &[0.1, 0.9], &[true], 0.2, 2), [Some(0)]);
        assert_eq!(match_greedy(&errors, &[0.1, 0.9], &[true], 0.2, 1), [None]);
        assert_eq!(match_greedy(&errors, &[0.1, 0.9], &[true], 0.21, 1), [Some(1)]);
    }

    #[test]
    fn invalid_truth_and_nan_match_nothing() {
        let errors = vec![vec![0.1, f64::NAN]];
        assert_eq!(match_greedy(&errors, &[1.0], &[false, true], 1.0, 1), [None, None]);
    }
}
