use crate::html::{escape, page, percent};
use crate::{EvalError, InstanceErrors, Report};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

const RESAMPLINGS: usize = 2000;
const SEED: u64 = 1;

/// The difference of two reports on the instances that both have.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// What the first is.
    pub a: String,
    /// What the second is.
    pub b: String,
    /// Instances that only one of them has.
    pub unpaired: usize,
    /// Over all instances, by score.
    pub overall: BTreeMap<String, Difference>,
    /// By object id and score.
    pub per_object: BTreeMap<u32, BTreeMap<String, Difference>>,
}

/// The difference of a score: second minus first.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Difference {
    /// Paired instances.
    pub n: usize,
    /// Score of the first.
    pub a: f64,
    /// Score of the second.
    pub b: f64,
    /// `b - a`.
    pub difference: f64,
    /// Lower end of the 95 % interval.
    pub low: f64,
    /// Upper end of the 95 % interval.
    pub high: f64,
}

/// A score as a mean over instances.
type Share = (&'static str, fn(&InstanceErrors) -> f64);

const SHARES: [Share; 6] = [
    ("add_s_recall_0.1d", |i| f64::from(u8::from(i.add_s_correct))),
    ("auc_add_s", InstanceErrors::auc_share),
    ("mssd_recall", InstanceErrors::mssd_share),
    ("mspd_recall", InstanceErrors::mspd_share),
    ("vsd_recall", InstanceErrors::vsd_share),
    ("ar", InstanceErrors::ar_share),
];

/// Compares the last set of each report (`refined`, or `estimate`).
///
/// # Errors
/// When a report has no set, or the reports have no instance in common.
pub fn compare(a: &Report, b: &Report) -> Result<Comparison, EvalError> {
    let last = |r: &Report| r.sets.last().cloned().unwrap_or_default();
    compare_sets(a, &last(a), b, &last(b))
}

/// Compares set `set_a` of one report with set `set_b` of another (or the same). The interval is a paired bootstrap:
/// the instances are drawn with replacement 2000 times, both scores taken on the same draw, and the middle 95 % of the
/// differences reported (Efron and Tibshirani, An Introduction to the Bootstrap, 1993, ch. 13).
///
/// # Errors
/// When a set is missing, or the reports have no instance in common.
pub fn compare_sets(a: &Report, set_a: &str, b: &Report, set_b: &str) -> Result<Comparison, EvalError> {
    let (instances_a, instances_b) = (instances(a, set_a)?, instances(b, set_b)?);
    let by_key: BTreeMap<_, &InstanceErrors> = instances_b.iter().map(|i| (i.key(), i)).collect();
    let pairs: Vec<Pair> = instances_a.iter().filter_map(|i| Some((i, *by_key.get(&i.key())?))).collect();
    if pairs.is_empty() {
        return Err(EvalError::NothingInCommon { a: a.title(), b: b.title() });
    }
    let mut objects: BTreeMap<u32, Vec<Pair>> = BTreeMap::new();
    for pair in &pairs {
        objects.entry(pair.0.object_id).or_default().push(*pair);
    }
    Ok(Comparison {
        a: format!("{} {set_a}", a.title()),
        b: format!("{} {set_b}", b.title()),
        unpaired: instances_a.len() + instances_b.len() - 2 * pairs.len(),
        overall: differences(&pairs),
        per_object: objects.iter().map(|(id, pairs)| (*id, differences(pairs))).collect(),
    })
}

/// The errors of an instance in both reports.
type Pair<'a> = (&'a InstanceErrors, &'a InstanceErrors);

fn instances<'a>(report: &'a Report, set: &str) -> Result<&'a [InstanceErrors], EvalError> {
    let found = report.instances.get(set).map(Vec::as_slice);
    found.ok_or_else(|| EvalError::NoBlock {
        dataset: report.title(),
        found: report.sets.clone(),
        wanted: set.to_owned(),
    })
}

fn differences(pairs: &[Pair]) -> BTreeMap<String, Difference> {
    let values: Vec<[(f64, f64); SHARES.len()]> =
        pairs.iter().map(|(a, b)| SHARES.map(|(_, f)| (f(a), f(b)))).collect();
    let n = values.len();
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let mut resampled = vec![Vec::with_capacity(RESAMPLINGS); SHARES.len()];
    for _ in 0..RESAMPLINGS {
        let mut sums = [0.0; SHARES.len()];
        for _ in 0..n {
            let drawn = &values[rng.random_range(0..n)];
            sums.iter_mut().zip(drawn).for_each(|(sum, (a, b))| *sum += b - a);
        }
        resampled.iter_mut().zip(sums).for_each(|(all, sum)| all.push(sum / n as f64));
    }
    let mean = |s: usize, which: fn(&(f64, f64)) -> f64| values.iter().map(|v| which(&v[s])).sum::<f64>() / n as f64;
    let difference = |(s, mut all): (usize, Vec<f64>)| {
        all.sort_by(f64::total_cmp);
        let (a, b) = (mean(s, |v| v.0), mean(s, |v| v.1));
        let (low, high) = (quantile(&all, 0.025), quantile(&all, 0.975));
        (SHARES[s].0.to_owned(), Difference { n, a, b, difference: b - a, low, high })
    };
    resampled.into_iter().enumerate().map(difference).collect()
}

/// Of sorted values, with linear interpolation.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let place = share * (sorted.len() - 1) as f64;
    let (below, above) = (sorted[place.floor() as usize], sorted[place.ceil() as usize]);
    below + (above - below) * place.fract()
}

impl Comparison {
    /// Writes the comparison as JSON.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write_json(&self, path: &Path) -> Result<(), EvalError> {
        let text = serde_json::to_string_pretty(self);
        let text = text.map_err(|source| EvalError::Json { path: path.to_owned(), source })?;
        pseudoflow_files::write_private(path, (text + "\n").as_bytes()).map_err(EvalError::io(path))
    }

    /// Writes the comparison as one self-contained page.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write_html(&self, path: &Path) -> Result<(), EvalError> {
        let n = self.overall.values().next().map_or(0, |d| d.n);
        let mut html = format!(
            "<p>A: {}. B: {}. {n} instances in both; {} in only one, left out.</p><p>Each cell: B − A in percent, with \
             the 95 % interval of a paired bootstrap over instances ({RESAMPLINGS} draws). Coloured where the interval \
             does not hold 0.</p>\n<table><tr><th>object</th><th>n</th>",
            escape(&self.a),
            escape(&self.b),
            self.unpaired
        );
        SHARES.iter().for_each(|(name, _)| html += &format!("<th>{name}</th>"));
        html += "</tr>\n";
        for (id, differences) in &self.per_object {
            write_row(&mut html, &id.to_string(), differences, "");
        }
        write_row(&mut html, "all", &self.overall, " class=\"overall\"");
        html += "</table>";
        let title = format!("{} against {}", self.b, self.a);
        pseudoflow_files::write_private(path, page(&title, &html).as_bytes()).map_err(EvalError::io(path))
    }
}

fn write_row(html: &mut String, object: &str, differences: &BTreeMap<String, Difference>, class: &str) {
    let n = differences.values().next().map_or(0, |d| d.n);
    let _ = write!(html, "<tr{class}><td>{object}</td><td>{n}</td>");
    for d in SHARES.iter().filter_map(|(name, _)| differences.get(*name)) {
        let colour = match (d.low > 0.0, d.high < 0.0) {
            (true, _) => "better",
            (_, true) => "worse",
            _ => "",
        };
        let _ = write!(
            html,
            "<td class=\"{colour}\" title=\"A {} B {}\">{:+.1} <small>[{:+.1}, {:+.1}]</small></td>",
            percent(d.a),
            percent(d.b),
            100.0 * d.difference,
            100.0 * d.low,
            100.0 * d.high
        );
    }
    *html += "</tr>\n";
}

#[cfg(test)]
mod tests;
