//! From samples to models, and how well the models do on objects that they were not fitted on.

use super::samples::Sample;
use anyhow::{Context as _, Result};
use nalgebra::Matrix6;
use pseudoflow_metrics::{CHI2_95_OF_3, CHI2_95_OF_6, Mahalanobis2, mahalanobis2};
use pseudoflow_pnp::gate::{CovarianceScale, Feature, Features, Logistic, StageModel};
use std::collections::BTreeMap;

/// Parts of the objects that are left out in turn.
const FOLDS: usize = 5;
/// ADD(-S)-0.1d.
const RIGHT: f64 = 0.1;

/// A model and how good it is.
pub(super) struct Fitted {
    pub(super) model: StageModel,
    /// Objects among the samples.
    pub(super) objects: usize,
    /// By model, on objects that were left out.
    pub(super) checks: Vec<(&'static str, Check)>,
    /// Share of true poses in the 95 % ellipsoid, on objects that were left out: pose, translation, rotation.
    pub(super) coverage: [f64; 3],
    /// Of the pose by the solver's own covariance.
    pub(super) coverage_before: f64,
}

/// How good probabilities are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Check {
    /// Share of the outcomes that are true.
    pub(super) share: f64,
    /// Mean squared distance of probability and outcome.
    pub(super) brier: f64,
    /// The same for the share itself as everything's probability.
    pub(super) chance: f64,
    /// Expected calibration error, ten bins.
    pub(super) calibration_error: f64,
    /// Probability that a true outcome has a higher probability than a false one.
    pub(super) area: f64,
}

/// One of the three models: its name, the outcome that it tells, and what it may look at.
#[derive(Clone, Copy)]
struct Kind {
    name: &'static str,
    outcome: fn(&Sample) -> bool,
    features: &'static [Feature],
}

/// What pictures alone say of the initial pose. How far a refinement moves says less of it than it seems: in synthetic images
/// the flow is mostly right, in others it may not be.
const OF_INITIAL: [Feature; 5] = [
    Feature::PhotometricInitial,
    Feature::SilhouetteInitial,
    Feature::Textured,
    Feature::LnMagnification,
    Feature::LnObjectPx,
];

const KINDS: [Kind; 3] = [
    Kind { name: "better", outcome: Sample::is_better, features: &Feature::ALL },
    Kind { name: "refined right", outcome: |s| s.after < RIGHT, features: &Feature::ALL },
    Kind { name: "initial right", outcome: |s| s.before < RIGHT, features: &OF_INITIAL },
];

/// The models of all samples, checked on each fifth of the objects by models of the others.
pub(super) fn fit_stage(samples: &[Sample], ridge: f64) -> Result<Fitted> {
    let all: Vec<&Sample> = samples.iter().collect();
    let objects: BTreeMap<&str, usize> = samples.iter().map(|s| (s.object.as_str(), 0)).collect();
    let fold: BTreeMap<&str, usize> = objects.keys().enumerate().map(|(i, name)| (*name, i % FOLDS)).collect();
    let mut claims: [Vec<(f64, bool)>; 3] = Default::default();
    let mut inside = Vec::new();
    for left_out in 0..FOLDS.min(objects.len()) {
        let (test, train): (Vec<&Sample>, Vec<&Sample>) =
            samples.iter().partition(|s| fold[s.object.as_str()] == left_out);
        let model = stage_model(&train, ridge)?;
        let of = [&model.better, &model.refined_right, &model.initial_right];
        for sample in test {
            let features = sample.features();
            for (claims, (model, kind)) in claims.iter_mut().zip(of.into_iter().zip(KINDS)) {
                claims.push((model.probability(&features), (kind.outcome)(sample)));
            }
            inside.extend(within(sample, &model, &features));
        }
    }
    let share = |k: usize| inside.iter().filter(|w| w[k]).count() as f64 / inside.len().max(1) as f64;
    Ok(Fitted {
        model: stage_model(&all, ridge)?,
        objects: objects.len(),
        checks: KINDS.iter().zip(&claims).map(|(kind, claims)| (kind.name, check(claims))).collect(),
        coverage: [share(0), share(1), share(2)],
        coverage_before: share(3),
    })
}

fn stage_model(samples: &[&Sample], ridge: f64) -> Result<StageModel> {
    let fit = |kind: Kind| {
        let pairs: Vec<(Features, bool)> = samples.iter().map(|s| (s.features(), (kind.outcome)(s))).collect();
        let found = Logistic::fit(&pairs, kind.features, ridge);
        found.with_context(|| format!("no model of `{}`: both outcomes must occur; take more `--scenes`", kind.name))
    };
    let [better, refined_right, initial_right] = KINDS;
    let mut model = StageModel {
        samples: samples.len(),
        better: fit(better)?,
        refined_right: fit(refined_right)?,
        initial_right: fit(initial_right)?,
        covariance: CovarianceScale {
            translation: 0.0,
            translation_slope: 0.0,
            rotation: 0.0,
            rotation_slope: 0.0,
            decorrelation: 0.0,
        },
    };
    model.covariance = covariance_scale(samples, &model).context("no accepted refinement has a covariance")?;
    Ok(model)
}

/// Whether the truth is in the ellipsoid of an accepted refinement: pose, translation, rotation by the scaled covariance, pose by
/// the solver's own.
fn within(sample: &Sample, model: &StageModel, features: &Features) -> Option<[bool; 4]> {
    let verdict = model.verdict(features);
    let scaled = model.covariance.apply(&sample.covariance(), verdict.refined_right);
    let (found, own) = (mahalanobis2(&sample.error(), &scaled)?, mahalanobis2(&sample.error(), &sample.covariance())?);
    (verdict.better >= 0.5).then_some([
        found.pose <= CHI2_95_OF_6,
        found.translation <= CHI2_95_OF_3,
        found.rotation <= CHI2_95_OF_3,
        own.pose <= CHI2_95_OF_6,
    ])
}

/// Which part of the correlations may be disbelieved.
const DECORRELATIONS: [f64; 9] = [0.0, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0];

/// The scale with the smallest ellipsoids (by the mean logarithm of their volume) of those that hold 95 % of the truths of the
/// accepted refinements.
fn covariance_scale(samples: &[&Sample], model: &StageModel) -> Option<CovarianceScale> {
    let accepted: Vec<(&Sample, f64)> = samples
        .iter()
        .map(|s| (*s, model.verdict(&s.features())))
        .filter(|(_, verdict)| verdict.better >= 0.5)
        .map(|(s, verdict)| (s, verdict.refined_right))
        .collect();
    let scales = DECORRELATIONS.iter().filter_map(|decorrelation| scale_with(&accepted, *decorrelation));
    scales.map(|scale| (volume(&accepted, &scale), scale)).min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, scale)| scale)
}

/// Factors with which 95 % of the truths lie in the ellipsoids: of translation and rotation for themselves, growing with the
/// doubt, then a common one for both together (split conformal prediction with the Mahalanobis distance as score: Vovk et
/// al., Algorithmic Learning in a Random World, 2005, section 2.2; the growth is a quantile regression).
fn scale_with(accepted: &[(&Sample, f64)], decorrelation: f64) -> Option<CovarianceScale> {
    let none =
        CovarianceScale { translation: 0.0, translation_slope: 0.0, rotation: 0.0, rotation_slope: 0.0, decorrelation };
    let factors = |distance2: fn(&Mahalanobis2) -> f64| {
        let point = |(s, confidence): &(&Sample, f64)| {
            let d = mahalanobis2(&s.error(), &none.apply(&s.covariance(), *confidence))?;
            Some((1.0 - confidence, 0.5 * (distance2(&d).max(1e-12) / CHI2_95_OF_3).ln()))
        };
        quantile_line(&accepted.iter().filter_map(point).collect::<Vec<_>>(), 0.95)
    };
    let (translation, translation_slope) = factors(|d| d.translation)?;
    let (rotation, rotation_slope) = factors(|d| d.rotation)?;
    let scale = CovarianceScale { translation, translation_slope, rotation, rotation_slope, decorrelation };
    let together = accepted.iter().filter_map(|(s, confidence)| {
        let d = mahalanobis2(&s.error(), &scale.apply(&s.covariance(), *confidence))?;
        Some(0.5 * (d.pose.max(1e-12) / CHI2_95_OF_6).ln())
    });
    let common = quantile(together.collect(), 0.95)?;
    Some(CovarianceScale { translation: translation + common, rotation: rotation + common, ..scale })
}

/// Mean over the refinements of half the logarithm of the scaled covariance's determinant; infinite without any.
fn volume(accepted: &[(&Sample, f64)], scale: &CovarianceScale) -> f64 {
    let of = |(s, confidence): &(&Sample, f64)| {
        let c = Matrix6::from_row_slice(&scale.apply(&s.covariance(), *confidence));
        let sigma = c.diagonal().map(f64::sqrt);
        let correlation = Matrix6::from_fn(|i, j| c[(i, j)] / (sigma[i] * sigma[j]));
        let volume = sigma.map(f64::ln).sum() + 0.5 * correlation.determinant().ln();
        volume.is_finite().then_some(volume)
    };
    let volumes: Vec<f64> = accepted.iter().filter_map(of).collect();
    if volumes.is_empty() { f64::INFINITY } else { volumes.iter().sum::<f64>() / volumes.len() as f64 }
}

/// The line `y = a + b x` with `b >= 0` below which a share of the points lies, by least pinball loss (Koenker and Bassett,
/// Econometrica 46, 1978): for each slope the best `a` is a quantile, and the loss is convex in the slope.
fn quantile_line(points: &[(f64, f64)], share: f64) -> Option<(f64, f64)> {
    let rest = |b: f64| quantile(points.iter().map(|(x, y)| y - b * x).collect(), share);
    let loss = |b: f64| {
        let a = rest(b).unwrap_or(0.0);
        points.iter().map(|(x, y)| y - a - b * x).map(|r| r.max(0.0) * share - r.min(0.0) * (1.0 - share)).sum::<f64>()
    };
    let (mut low, mut high) = (0.0, 12.0);
    for _ in 0..40 {
        let (left, right) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        if loss(left) <= loss(right) { high = right } else { low = left }
    }
    let slope = (low + high) / 2.0;
    Some((rest(slope)?, slope))
}

/// The smallest value with at least this share of all at or below it, plus one more for the next that comes.
fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let place = (share * (values.len() as f64 + 1.0)).ceil() as usize;
    values.get(place.saturating_sub(1)).or(values.last()).copied()
}

fn check(claims: &[(f64, bool)]) -> Check {
    let n = claims.len().max(1) as f64;
    let outcome = |right: bool| f64::from(u8::from(right));
    let share = claims.iter().filter(|(_, right)| *right).count() as f64 / n;
    let mut bins = [(0.0, 0.0); 10];
    for (p, right) in claims {
        let bin = &mut bins[((p * 10.0) as usize).min(9)];
        *bin = (bin.0 + p, bin.1 + outcome(*right));
    }
    Check {
        share,
        brier: claims.iter().map(|(p, right)| (p - outcome(*right)).powi(2)).sum::<f64>() / n,
        chance: share * (1.0 - share),
        calibration_error: bins.iter().map(|(claimed, right)| (claimed - right).abs()).sum::<f64>() / n,
        area: area(claims),
    }
}

/// Area under the receiver operating characteristic, from ranks (Mann and Whitney); ties count half.
fn area(claims: &[(f64, bool)]) -> f64 {
    let mut sorted = claims.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut falses, mut trues, mut above) = (0.0, 0.0, 0.0);
    for equal in sorted.chunk_by(|a, b| a.0 == b.0) {
        let right = equal.iter().filter(|(_, right)| *right).count() as f64;
        let wrong = equal.len() as f64 - right;
        above += right * (falses + wrong / 2.0);
        (trues, falses) = (trues + right, falses + wrong);
    }
    above / (trues * falses).max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_geometry::standard_normal;
    use pseudoflow_pnp::gate::Stage;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Refinements of ten objects whose errors are ten times what the solver believes, and more where there are few inliers.
    fn samples(n: usize) -> Vec<Sample> {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let draw = |i: usize| {
            let ratio: f64 = rng.random_range(0.1..1.0);
            let grow = 10.0 * (2.0 * (1.0 - ratio)).exp();
            let error: [f64; 6] = std::array::from_fn(|_| 1e-3 * grow * standard_normal(&mut rng));
            let length = error.iter().map(|e| e * e).sum::<f64>().sqrt();
            Sample {
                stage: Stage::Flow,
                object: format!("o/{}", i % 10),
                visible: 1.0,
                before: rng.random_range(0.0..0.3),
                after: 2.0 * length,
                error,
                covariance: (0..36).map(|i| if i % 7 == 0 { 1e-6 } else { 0.0 }).collect(),
                features: [(Feature::InlierRatio, ratio)].into(),
            }
        };
        (0..n).map(draw).collect()
    }

    #[test]
    fn a_boasting_covariance_is_calibrated_on_unseen_objects() {
        let fitted = fit_stage(&samples(4000), 1.0).unwrap();
        assert!(fitted.coverage_before < 0.05, "{}", fitted.coverage_before);
        assert!((fitted.coverage[0] - 0.95).abs() < 0.015, "{:?}", fitted.coverage);
        assert!(fitted.coverage[1] > 0.93 && fitted.coverage[2] > 0.93, "{:?}", fitted.coverage);
        let scale = &fitted.model.covariance;
        assert!(scale.factors(1.0)[0] > 5.0 && scale.translation_slope > 0.3, "{scale:?}");
        let (_, right) = fitted.checks[1];
        assert!(right.calibration_error < 0.05 && right.area > 0.7 && right.brier < right.chance, "{right:?}");
    }

    #[test]
    fn one_outcome_only_is_an_error_that_says_what_to_do() {
        let hopeless: Vec<Sample> = samples(50).into_iter().map(|s| Sample { after: 1.0, ..s }).collect();
        assert!(format!("{:#}", fit_stage(&hopeless, 1.0).err().unwrap()).contains("--scenes"));
    }

    #[test]
    fn the_line_lies_above_its_share_of_the_points() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let points: Vec<(f64, f64)> = (0..5000)
            .map(|_| {
                let x: f64 = rng.random();
                (x, 1.0 + 2.0 * x + 0.5 * standard_normal(&mut rng))
            })
            .collect();
        let (a, b) = quantile_line(&points, 0.95).unwrap();
        assert!((a - (1.0 + 0.5 * 1.645)).abs() < 0.12 && (b - 2.0).abs() < 0.2, "{a} {b}");
        let below = points.iter().filter(|(x, y)| *y <= a + b * x).count();
        assert!((4745..=4760).contains(&below), "{below}");
        assert_eq!(quantile_line(&[], 0.95), None);
    }

    #[test]
    fn areas_are_those_of_pairs() {
        assert_eq!(area(&[(0.9, true), (0.1, false)]), 1.0);
        assert_eq!(area(&[(0.5, true), (0.5, false)]), 0.5);
        assert_eq!(area(&[(0.9, false), (0.1, true), (0.95, true), (0.2, false)]), 0.5);
    }
}
