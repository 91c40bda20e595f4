use super::{Series, escape, line_chart, optional, percent};
use crate::{ConfidenceCalibration, Coverage, Diagnosis, GateCalibration, Report};
use std::collections::BTreeMap;
use std::fmt::Write;

impl Report {
    /// Tables and figures of what is wrong.
    pub(super) fn diagnosis_page(&self) -> String {
        if self.diagnosis.is_empty() {
            return "<p class=\"note\">An old report: it has no diagnosis.</p>".to_owned();
        }
        self.depth_table() + &self.figures() + &self.gate_table() + &self.claims_table()
    }

    fn rows<'a>(
        &'a self,
        by_set: &'a BTreeMap<String, Diagnosis>,
    ) -> impl Iterator<Item = (&'a String, &'a Diagnosis)> {
        self.sets.iter().filter_map(|set| Some((set, by_set.get(set)?)))
    }

    fn depth_table(&self) -> String {
        let mut html = "<p>Medians are over what has an estimate. The depth of a pose is that of the middle of the object's \
             bounding box; positive is too far. With the true depth: the estimate moved along the viewing ray of that middle \
             to its true depth.</p><table><tr><th>object</th><th>poses</th><th>n</th><th>median rot. °</th>\
             <th>median proj. px</th><th>median depth, d</th><th>median |depth|, d</th><th>ADD(-S)-0.1d</th>\
             <th>with the true depth</th><th>right, then wrong</th><th>wrong, then right</th></tr>\n"
            .to_owned();
        for (id, by_set) in &self.object_diagnosis {
            let name = format!("{id} {}", escape(self.objects.get(id).map_or("", |o| &o.name)));
            self.rows(by_set).for_each(|(set, d)| depth_row(&mut html, &name, set, d, ""));
        }
        self.rows(&self.diagnosis).for_each(|(set, d)| depth_row(&mut html, "all", set, d, " class=\"overall\""));
        if let Some(without) = &self.without {
            let name = without.name();
            let rows = self.rows(&without.diagnosis);
            rows.for_each(|(set, d)| depth_row(&mut html, &name, set, d, " class=\"overall\""));
        }
        html + "</table>\n"
    }

    fn figures(&self) -> String {
        let visible = |d: &Diagnosis| -> Vec<(f64, f64)> {
            d.by_visible_share.iter().map(|b| ((b.from + b.to) / 2.0, b.add_s_recall)).collect()
        };
        let claimed = |c: &ConfidenceCalibration| c.bins.iter().map(|b| (b.claimed, b.observed)).collect();
        let series = |name: &str, points| Series { name: name.to_owned(), colour: self.colour(name), points };
        let by_share: Vec<Series> = self.rows(&self.diagnosis).map(|(set, d)| series(set, visible(d))).collect();
        let honest = Series { name: "honest".into(), colour: "#999".into(), points: vec![(0.0, 0.0), (1.0, 1.0)] };
        let of_sets = self.rows(&self.diagnosis);
        let confidence: Vec<Series> =
            of_sets.filter_map(|(set, d)| Some(series(set, claimed(d.confidence.as_ref()?)))).collect();
        let mut html = String::new();
        if by_share.iter().any(|s| !s.points.is_empty()) {
            html += &line_chart("ADD(-S)-0.1d by visible share", "visible share", 1.0, &by_share);
        }
        if !confidence.is_empty() {
            let all: Vec<Series> = std::iter::once(honest).chain(confidence).collect();
            html += &line_chart("Observed share of right poses", "claimed confidence", 1.0, &all);
        }
        html
    }

    fn gate_table(&self) -> String {
        let rows: String = self.rows(&self.diagnosis).fold(String::new(), |text, (set, d)| {
            text + &d.gate.as_ref().map_or_else(String::new, |gate| gate_row(set, gate))
        });
        if rows.is_empty() {
            return rows;
        }
        format!(
            "<h3>The gate</h3><p>Every decision of every pass. Gain: ADD(-S) before minus after, diameters.</p>\
             <table><tr><th>poses</th><th>accepted</th><th>of these better</th><th>median gain, d</th><th>spoilt</th>\
             <th>mended</th><th>refused</th><th>of these worse</th><th>median gain, d</th><th>saved</th><th>missed</th>\
             </tr>\n{rows}</table>\n"
        )
    }

    fn claims_table(&self) -> String {
        let rows: String = self
            .rows(&self.diagnosis)
            .fold(String::new(), |text, (set, d)| text + &claims_row(set, d.confidence.as_ref(), d.coverage.as_ref()));
        if rows.is_empty() {
            return rows;
        }
        format!(
            "<h3>Confidence and covariance</h3><p>Rank correlation of the confidence with the accuracy; calibration error \
             and Brier score of the confidence as the probability of ADD(-S)-0.1d; share of the true poses within the 95 % \
             ellipsoid of the covariance.</p><table><tr><th>poses</th><th>n</th><th>rank corr.</th><th>calibration error</th>\
             <th>Brier</th><th>n with covariance</th><th>pose</th><th>translation</th><th>rotation</th>\
             <th>pose, of the right ones</th></tr>\n{rows}</table>\n"
        )
    }
}

fn depth_row(html: &mut String, object: &str, set: &str, d: &Diagnosis, class: &str) {
    let (spoilt, mended) = d.changes.as_ref().map_or_else(
        || ("–".to_owned(), "–".to_owned()),
        |c| (format!("{} of {}", c.spoilt, c.right_before), format!("{} of {}", c.mended, c.wrong_before)),
    );
    let _ = writeln!(
        html,
        "<tr{class}><td>{object}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td>\
         <td>{}</td><td>{spoilt}</td><td>{mended}</td></tr>",
        escape(set),
        d.n,
        optional(d.median_rotation_deg, 2),
        optional(d.median_projection_px, 2),
        optional(d.median_depth_of_diameter, 3),
        optional(d.median_abs_depth_of_diameter, 3),
        percent(d.add_s_recall),
        percent(d.add_s_recall_true_depth),
    );
}

fn gate_row(set: &str, gate: &GateCalibration) -> String {
    format!(
        "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td>\
         <td>{}</td><td>{}</td></tr>\n",
        escape(set),
        gate.accepted,
        percent(gate.accepted_improved),
        optional(gate.accepted_median_gain, 3),
        gate.accepted_spoilt,
        gate.accepted_mended,
        gate.refused,
        percent(gate.refused_worse),
        optional(gate.refused_median_gain, 3),
        gate.refused_saved,
        gate.refused_missed,
    )
}

fn claims_row(set: &str, confidence: Option<&ConfidenceCalibration>, coverage: Option<&Coverage>) -> String {
    if confidence.is_none() && coverage.is_none() {
        return String::new();
    }
    let number = |value: Option<f64>| optional(value, 3);
    let count = |n: Option<usize>| n.map_or_else(|| "–".to_owned(), |n| n.to_string());
    let share = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), percent);
    format!(
        "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td>\
         <td>{}</td></tr>\n",
        escape(set),
        count(confidence.map(|c| c.n)),
        number(confidence.and_then(|c| c.rank_correlation)),
        number(confidence.map(|c| c.calibration_error)),
        number(confidence.map(|c| c.brier)),
        count(coverage.map(|c| c.n)),
        share(coverage.map(|c| c.pose)),
        share(coverage.map(|c| c.translation)),
        share(coverage.map(|c| c.rotation)),
        share(coverage.map(|c| c.pose_of_right)),
    )
}
