use super::{SET_COLOURS, Series, TRUTH_COLOUR, css_colour, escape, histogram, line_chart, optional, page, percent};
use crate::{EvalError, InstanceErrors, OverlayCase, Report, Scores};
use pseudoflow_metrics::{AUC_LIMIT_M, mspd_thresholds, mssd_thresholds, vsd_thresholds};
use std::fmt::Write;
use std::path::Path;

impl Report {
    /// Writes the report as one self-contained page. `pictures` may come from [`crate::overlays`].
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write_html(&self, path: &Path, pictures: &[OverlayCase]) -> Result<(), EvalError> {
        let body = format!(
            "{}<h2>Scores</h2>{}<h2>What is wrong</h2>{}<h2>Recall</h2>{}<h2>Errors</h2>{}{}",
            self.intro(),
            self.table(),
            self.diagnosis_page(),
            self.recall_curves(),
            self.histograms(),
            self.pictures(pictures)
        );
        let text = page(&format!("Pose errors on {}", self.title()), &body);
        pseudoflow_files::write_private(path, text.as_bytes()).map_err(EvalError::io(path))
    }

    pub(super) fn colour(&self, set: &str) -> String {
        let index = self.sets.iter().position(|s| s == set).unwrap_or(0);
        css_colour(SET_COLOURS[index % SET_COLOURS.len()])
    }

    fn intro(&self) -> String {
        let n = self.overall.values().map(|s| s.n).max().unwrap_or(0);
        let mut text = format!(
            "<p>{n} true instances of {} objects. Shares in percent; what was not found counts as wrong. \
             ADD(-S) is ADI for objects with symmetries.</p>",
            self.objects.len()
        );
        for note in &self.notes {
            let _ = write!(text, "<p class=\"note\">Note: {}</p>", escape(note));
        }
        text
    }

    fn table(&self) -> String {
        let mut html = "<table><tr><th>object</th><th>poses</th><th>n</th><th>ADD(-S)-0.1d</th><th>AUC ADD(-S)</th>\
             <th>MSSD</th><th>MSPD</th><th>VSD</th><th>AR</th><th>5 cm 5°</th><th>median rot. °</th>\
             <th>median transl. mm</th><th>ms / object</th></tr>\n"
            .to_owned();
        for (id, sets) in &self.per_object {
            let info = self.objects.get(id);
            let symmetric = if info.is_some_and(|o| o.symmetric) { " (sym.)" } else { "" };
            let name = format!("{id} {}{symmetric}", escape(info.map_or("", |o| &o.name)));
            self.sets.iter().for_each(|set| row(&mut html, &name, set, sets.get(set), ""));
        }
        self.sets.iter().for_each(|set| row(&mut html, "all", set, self.overall.get(set), " class=\"overall\""));
        if let Some(without) = &self.without {
            let name = without.name();
            self.sets.iter().for_each(|set| row(&mut html, &name, set, without.overall.get(set), " class=\"overall\""));
        }
        html + "</table>\n"
    }

    /// A curve for each set, from `points` of its scores and instances.
    fn curves(&self, points: impl Fn(&Scores, &[InstanceErrors]) -> Vec<(f64, f64)>) -> Vec<Series> {
        let series = |set: &String| {
            let (scores, instances) = (self.overall.get(set)?, self.instances.get(set)?);
            Some(Series { name: set.clone(), colour: self.colour(set), points: points(scores, instances) })
        };
        self.sets.iter().filter_map(series).collect()
    }

    fn recall_curves(&self) -> String {
        let at = |thresholds: [f64; 10], recalls: &[f64; 10]| thresholds.into_iter().zip(*recalls).collect::<Vec<_>>();
        let of_diameter = self.curves(|_, all| accuracy(all.iter().map(|i| i.add_s_of_diameter), 0.5));
        let to_10cm =
            self.curves(|_, all| accuracy(all.iter().map(|i| i.add_s_m.map(|m| m * 100.0)), AUC_LIMIT_M * 100.0));
        let mssd = self.curves(|s, _| at(mssd_thresholds(), &s.mssd_recalls));
        let mspd = self.curves(|s, _| at(mspd_thresholds(), &s.mspd_recalls));
        let vsd = self.curves(|s, _| at(vsd_thresholds(), &s.vsd_recalls));
        line_chart("ADD(-S)", "threshold, diameters", 0.5, &of_diameter)
            + &line_chart("ADD(-S) to 10 cm", "threshold, cm", AUC_LIMIT_M * 100.0, &to_10cm)
            + &line_chart("MSSD", "threshold, diameters", 0.5, &mssd)
            + &line_chart("MSPD", "threshold, px at 640 width", 50.0, &mspd)
            + &line_chart("VSD, mean over tolerances", "threshold", 0.5, &vsd)
    }

    fn histograms(&self) -> String {
        let values = |f: &dyn Fn(&InstanceErrors) -> Option<f64>| -> Vec<(String, String, Vec<f64>)> {
            let of_set = |set: &String| {
                let values = self.instances.get(set)?.iter().filter_map(f).collect();
                Some((set.clone(), self.colour(set), values))
            };
            self.sets.iter().filter_map(of_set).collect()
        };
        histogram("Rotation error", "degrees", 30.0, &values(&|i| i.rotation_deg))
            + &histogram("Translation error", "mm", 100.0, &values(&|i| i.translation_m.map(|m| m * 1e3)))
            + &histogram("ADD(-S)", "diameters", 0.5, &values(&|i| i.add_s_of_diameter))
            + &histogram("Projection error", "px", 30.0, &values(&|i| i.projection_px))
            + &histogram("Depth error", "diameters", 0.4, &values(&|i| i.depth_of_diameter.map(f64::abs)))
    }

    fn pictures(&self, cases: &[OverlayCase]) -> String {
        if cases.is_empty() {
            return String::new();
        }
        let mut html = format!(
            "<h2>Best, median and worst</h2><p>By ADD(-S) in diameters of `{}`. Contours: {}\
             <span style=\"color:{}\">■</span> truth.</p>\n",
            self.sets.last().map_or_else(String::new, |s| escape(s)),
            self.sets.iter().fold(String::new(), |text, set| {
                format!("{text}<span style=\"color:{}\">■</span> {} ", self.colour(set), escape(set))
            }),
            css_colour(TRUTH_COLOUR)
        );
        for of_object in cases.chunk_by(|a, b| a.object_id == b.object_id) {
            let name = self.objects.get(&of_object[0].object_id).map_or("", |o| &o.name);
            let _ = writeln!(html, "<h3>{} {}</h3>", of_object[0].object_id, escape(name));
            of_object.iter().for_each(|case| case.write_html(&mut html));
        }
        html
    }
}

fn row(html: &mut String, object: &str, set: &str, scores: Option<&Scores>, class: &str) {
    let Some(s) = scores else { return };
    let shares = [s.add_s_recall, s.auc_add_s, s.mssd_recall, s.mspd_recall, s.vsd_recall, s.ar, s.recall_5cm_5deg];
    let cells: String = shares.iter().fold(String::new(), |text, share| format!("{text}<td>{}</td>", percent(*share)));
    let _ = writeln!(
        html,
        "<tr{class}><td>{object}</td><td>{}</td><td>{}</td>{cells}<td>{}</td><td>{}</td><td>{}</td></tr>",
        escape(set),
        s.n,
        optional(s.median_rotation_deg, 2),
        optional(s.median_translation_m.map(|m| m * 1e3), 2),
        optional(s.ms_per_object, 1)
    );
}

/// The share of errors below each of 101 thresholds up to `limit`; a missing error is never below.
fn accuracy(errors: impl Iterator<Item = Option<f64>>, limit: f64) -> Vec<(f64, f64)> {
    let errors: Vec<f64> = errors.map(|e| e.unwrap_or(f64::INFINITY)).collect();
    let threshold = |i: u32| limit * f64::from(i) / 100.0;
    let below = |t: f64| pseudoflow_metrics::recall(errors.iter().filter(|e| **e < t).count(), errors.len());
    (0..=100).map(|i| (threshold(i), below(threshold(i)))).collect()
}
