//! The report as text: a page of a terminal.

use pseudoflow_evaluator::{Diagnosis, Report, Scores};
use std::collections::BTreeMap;

/// Scores and errors by object and set, then what is wrong with all of them.
pub(super) fn table(report: &Report) -> String {
    let mut text = format!(
        "{:24} {:9} {:>5} {:>12} {:>7} {:>6} {:>6} {:>6} {:>6} {:>7} {:>7} {:>8} {:>7} {:>7} {:>8}\n",
        "object",
        "poses",
        "n",
        "ADD(-S)-0.1d",
        "true z",
        "AUC",
        "MSSD",
        "MSPD",
        "VSD",
        "AR",
        "rot deg",
        "proj px",
        "dz d",
        "|dz| d",
        "ms"
    );
    for (id, sets) in &report.per_object {
        let name = report.objects.get(id).map_or_else(|| id.to_string(), |object| format!("{id} {}", object.name));
        rows(&mut text, report, &name, sets, report.object_diagnosis.get(id));
    }
    rows(&mut text, report, "all", &report.overall, Some(&report.diagnosis));
    if let Some(without) = &report.without {
        rows(&mut text, report, &without.name(), &without.overall, Some(&without.diagnosis));
    }
    for set in &report.sets {
        if let (Some(scores), Some(diagnosis)) = (report.overall.get(set), report.diagnosis.get(set)) {
            text += &found(set, scores);
            text += &remarks(set, diagnosis);
        }
    }
    text
}

/// A row for each set.
fn rows(
    text: &mut String,
    report: &Report,
    object: &str,
    scores: &BTreeMap<String, Scores>,
    diagnosis: Option<&BTreeMap<String, Diagnosis>>,
) {
    for set in &report.sets {
        let Some(s) = scores.get(set) else { continue };
        let d = diagnosis.and_then(|of| of.get(set));
        let number = |value: Option<f64>, digits: usize| value.map_or("-".into(), |v| format!("{v:.digits$}"));
        let of = |f: fn(&Diagnosis) -> Option<f64>, digits| number(d.and_then(f), digits);
        *text += &format!(
            "{object:24} {set:9} {:>5} {:>12.3} {:>7} {:>6.3} {:>6.3} {:>6.3} {:>6.3} {:>7.3} {:>7} {:>8} {:>7} {:>7} {:>8}\n",
            s.n,
            s.add_s_recall,
            of(|d| Some(d.add_s_recall_true_depth), 3),
            s.auc_add_s,
            s.mssd_recall,
            s.mspd_recall,
            s.vsd_recall,
            s.ar,
            of(|d| d.median_rotation_deg, 1),
            of(|d| d.median_projection_px, 1),
            d.and_then(|d| d.median_depth_of_diameter).map_or("-".into(), |v| format!("{v:+.3}")),
            of(|d| d.median_abs_depth_of_diameter, 3),
            number(s.ms_per_object, 1),
        );
    }
}

/// How many of the well visible instances were found.
fn found(set: &str, scores: &Scores) -> String {
    let share = |recall| format!("{set}: found {recall:.3} of what is at least 60 % visible\n");
    scores.detection_recall.map_or_else(String::new, share)
}

fn remarks(set: &str, d: &Diagnosis) -> String {
    let mut text = String::new();
    if !d.by_visible_share.is_empty() {
        let bin = |b: &pseudoflow_evaluator::VisibleBin| {
            format!("{:.0}-{:.0} %: {:.3} of {}", 100.0 * b.from, 100.0 * b.to, b.add_s_recall, b.n)
        };
        let bins: Vec<String> = d.by_visible_share.iter().map(bin).collect();
        text += &format!("{set}: ADD(-S)-0.1d by visible share: {}\n", bins.join("; "));
    }
    if let Some(c) = &d.changes {
        text += &format!(
            "{set}: right before, wrong after: {} of {}; wrong before, right after: {} of {}\n",
            c.spoilt, c.right_before, c.mended, c.wrong_before
        );
    }
    if let Some(g) = &d.gate {
        text += &format!(
            "{set}: gate accepted {} ({:.3} of them better, median gain {:+.3} d), refused {} ({:.3} would have been worse, \
             median gain {:+.3} d)\n",
            g.accepted,
            g.accepted_improved,
            g.accepted_median_gain.unwrap_or(0.0),
            g.refused,
            g.refused_worse,
            g.refused_median_gain.unwrap_or(0.0)
        );
    }
    if let Some(c) = &d.confidence {
        let correlation = c.rank_correlation.map_or("-".into(), |r| format!("{r:.3}"));
        text += &format!(
            "{set}: confidence: rank correlation with accuracy {correlation}, calibration error {:.3}, Brier {:.3}\n",
            c.calibration_error, c.brier
        );
    }
    if let Some(c) = &d.coverage {
        text += &format!(
            "{set}: truth within the 95 % ellipsoid: {:.3} of {} (translation {:.3}, rotation {:.3}; of the right poses {:.3})\n",
            c.pose, c.n, c.translation, c.rotation, c.pose_of_right
        );
    }
    text
}
