use super::{Feature, Features};
use nalgebra::{DMatrix, DVector};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// `p = 1 / (1 + exp(-z))`, `z = bias + sum weight (feature - mean) / scale`, each standardised value kept within
/// `LIMIT`, so that nothing outside what was fitted runs away. An unknown feature counts as its mean.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Logistic {
    /// The logit where every feature has its mean.
    pub bias: f64,
    /// By feature.
    pub terms: BTreeMap<Feature, Term>,
}

/// One feature's part in a [`Logistic`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Term {
    /// Mean of the feature where it was fitted.
    pub mean: f64,
    /// Standard deviation there, over 0.
    pub scale: f64,
    /// Change of the logit for a standard deviation.
    pub weight: f64,
}

/// Standard deviations from the mean beyond which a feature is not believed.
const LIMIT: f64 = 3.0;

impl Term {
    fn standardised(&self, value: f64) -> f64 {
        if value.is_nan() { 0.0 } else { ((value - self.mean) / self.scale).clamp(-LIMIT, LIMIT) }
    }
}

impl Logistic {
    /// The logit.
    #[must_use]
    pub fn logit(&self, features: &Features) -> f64 {
        let term = |(feature, term): (&Feature, &Term)| term.weight * term.standardised(features.get(*feature));
        self.bias + self.terms.iter().map(term).sum::<f64>()
    }

    /// The probability, 0..1.
    #[must_use]
    pub fn probability(&self, features: &Features) -> f64 {
        sigmoid(self.logit(features))
    }

    /// Whether all numbers are finite and scales positive.
    pub(super) fn is_sound(&self) -> bool {
        let sound = |t: &Term| t.mean.is_finite() && t.weight.is_finite() && t.scale.is_finite() && t.scale > 0.0;
        self.bias.is_finite() && self.terms.values().all(sound)
    }

    /// The model of highest likelihood less a ridge `ridge / 2 |weights|^2` (the bias is free), by Newton's method
    /// (iteratively reweighted least squares: Hastie, Tibshirani and Friedman, The Elements of Statistical Learning, section
    /// 4.4.1). Features that are nowhere known, or constant, are left out. `None` without samples of both outcomes.
    #[must_use]
    pub fn fit(samples: &[(Features, bool)], features: &[Feature], ridge: f64) -> Option<Self> {
        let right = samples.iter().filter(|(_, outcome)| *outcome).count();
        if right == 0 || right == samples.len() {
            return None;
        }
        let terms: Vec<(Feature, Term)> = features.iter().filter_map(|f| Some((*f, standard(samples, *f)?))).collect();
        let columns = terms.len() + 1;
        let design = DMatrix::from_fn(samples.len(), columns, |i, j| match j {
            0 => 1.0,
            _ => terms[j - 1].1.standardised(samples[i].0.get(terms[j - 1].0)),
        });
        let outcome = DVector::from_iterator(samples.len(), samples.iter().map(|(_, o)| f64::from(u8::from(*o))));
        let beta = newton(&design, &outcome, ridge.max(1e-9))?;
        let weighted = terms.iter().enumerate().map(|(j, (f, t))| (*f, Term { weight: beta[j + 1], ..*t }));
        Some(Self { bias: beta[0], terms: weighted.collect() })
    }
}

fn sigmoid(z: f64) -> f64 {
    1.0 / (1.0 + (-z).exp())
}

/// Mean and spread of a feature over the samples that know it.
fn standard(samples: &[(Features, bool)], feature: Feature) -> Option<Term> {
    let known: Vec<f64> = samples.iter().map(|(f, _)| f.get(feature)).filter(|v| v.is_finite()).collect();
    let mean = known.iter().sum::<f64>() / known.len().max(1) as f64;
    let scale = (known.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / known.len().max(1) as f64).sqrt();
    (scale > 1e-9).then_some(Term { mean, scale, weight: 0.0 })
}

/// Newton steps, halved where the penalised likelihood would fall.
fn newton(design: &DMatrix<f64>, outcome: &DVector<f64>, ridge: f64) -> Option<DVector<f64>> {
    let columns = design.ncols();
    let penalty = DVector::from_fn(columns, |j, _| if j == 0 { 0.0 } else { ridge });
    let loss = |beta: &DVector<f64>| {
        let fit = (design * beta).iter().zip(outcome).map(|(z, y)| softplus(*z) - y * z).sum::<f64>();
        fit + 0.5 * penalty.component_mul(beta).dot(beta)
    };
    let mut beta = DVector::zeros(columns);
    let mut current = loss(&beta);
    for _ in 0..100 {
        let p = (design * &beta).map(sigmoid);
        let gradient = design.tr_mul(&(outcome - &p)) - penalty.component_mul(&beta);
        let weights = p.map(|p| (p * (1.0 - p)).max(1e-9));
        let weighted = DMatrix::from_fn(design.nrows(), columns, |i, j| design[(i, j)] * weights[i]);
        let hessian = design.tr_mul(&weighted) + DMatrix::from_diagonal(&penalty);
        let mut step = hessian.cholesky()?.solve(&gradient);
        let mut next = loss(&(&beta + &step));
        while next > current && step.amax() > 1e-12 {
            step *= 0.5;
            next = loss(&(&beta + &step));
        }
        beta += &step;
        current = next;
        if step.amax() < 1e-10 {
            break;
        }
    }
    beta.iter().all(|b| b.is_finite()).then_some(beta)
}

/// `ln(1 + exp(z))` without overflow.
fn softplus(z: f64) -> f64 {
    z.max(0.0) + (-z.abs()).exp().ln_1p()
}

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_geometry::standard_normal;
    use rand::{Rng, SeedableRng, rngs::StdRng};

    const USED: [Feature; 2] = [Feature::InlierRatio, Feature::Rotation];

    /// Outcomes drawn from a known model.
    fn samples(n: usize, seed: u64) -> Vec<(Features, bool)> {
        let mut rng = StdRng::seed_from_u64(seed);
        let draw = |_| {
            let (a, b) = (standard_normal(&mut rng), standard_normal(&mut rng));
            let features = Features::default().with(USED[0], 5.0 + 2.0 * a).with(USED[1], 0.1 * b);
            (features, rng.random::<f64>() < sigmoid(0.5 + 1.5 * a - 0.8 * b))
        };
        (0..n).map(draw).collect()
    }

    #[test]
    fn the_model_that_drew_the_outcomes_is_found() {
        let found = Logistic::fit(&samples(20_000, 1), &USED, 1e-3).unwrap();
        let weight = |f| found.terms[&f].weight;
        assert!((found.bias - 0.5).abs() < 0.06, "{found:?}");
        assert!((weight(USED[0]) - 1.5).abs() < 0.08 && (weight(USED[1]) + 0.8).abs() < 0.06, "{found:?}");
        // As many right as claimed.
        let fresh = samples(20_000, 2);
        let claimed = fresh.iter().map(|(f, _)| found.probability(f)).sum::<f64>();
        let right = fresh.iter().filter(|(_, o)| *o).count() as f64;
        assert!((claimed / right - 1.0).abs() < 0.02);
    }

    #[test]
    fn the_gradient_of_the_likelihood_is_zero_at_the_solution() {
        let samples = samples(500, 3);
        let found = Logistic::fit(&samples, &USED, 0.7).unwrap();
        let loss = |m: &Logistic| {
            let z = |f| m.logit(f);
            let fit: f64 = samples.iter().map(|(f, o)| softplus(z(f)) - if *o { z(f) } else { 0.0 }).sum();
            fit + 0.35 * m.terms.values().map(|t| t.weight * t.weight).sum::<f64>()
        };
        let h = 1e-4;
        for feature in USED {
            let moved = |by: f64| {
                let mut m = found.clone();
                if let Some(term) = m.terms.get_mut(&feature) {
                    term.weight += by;
                }
                loss(&m)
            };
            assert!(((moved(h) - moved(-h)) / (2.0 * h)).abs() < 1e-4);
            assert!(moved(h) > loss(&found) && moved(-h) > loss(&found));
        }
    }

    #[test]
    fn separable_outcomes_stay_finite() {
        let all: Vec<(Features, bool)> =
            (0..100).map(|i| (Features::default().with(USED[0], f64::from(i)), i >= 50)).collect();
        let found = Logistic::fit(&all, &USED, 1.0).unwrap();
        assert!(found.is_sound() && found.terms.len() == 1, "the other is nowhere known: {found:?}");
        assert!(found.probability(&all[99].0) > 0.9 && found.probability(&all[0].0) < 0.1);
        assert!(Logistic::fit(&all[50..], &USED, 1.0).is_none(), "one outcome only");
    }

    #[test]
    fn what_is_unknown_or_far_outside_does_not_run_away() {
        let found = Logistic::fit(&samples(500, 4), &USED, 1.0).unwrap();
        let of = |v: f64| found.logit(&Features::default().with(USED[0], v));
        assert_eq!(found.logit(&Features::default()), found.bias);
        assert!(of(11.1) > of(5.0) && of(1e9) == of(1e6));
    }
}
