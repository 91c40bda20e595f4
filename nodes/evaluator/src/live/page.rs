//! `report.html`: when each object had which pose, and how old the answers were.

use super::{LiveReport, ON_TIME_MS};
use crate::EvalError;
use crate::html::{escape, page};
use std::fmt::Write;
use std::path::Path;

const WIDTH: f64 = 900.0;
const ROW: f64 = 18.0;
const LEFT: f64 = 150.0;
const AGES: f64 = 120.0;

/// Letters of a timeline, their colours and what they mean.
const MEANINGS: [(char, &str, &str); 6] = [
    ('g', "#2f9e44", "within 0.05 d"),
    ('y', "#a9d25f", "within 0.1 d"),
    ('r', "#d6336c", "wrong"),
    ('p', "#4c6ef5", "published"),
    ('m', "#f0b429", "visible, none published"),
    ('d', "#c9ccd1", "visible, frame dropped"),
];

impl LiveReport {
    /// Writes `report.html`.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write_html(&self, path: &Path) -> Result<(), EvalError> {
        let body = format!("{}<pre>{}</pre>", self.timelines(), escape(&self.to_string()));
        let text = page(&format!("{} in {}", self.source, self.graph), &body);
        pseudoflow_files::write_private(path, text.as_bytes())
            .map_err(|source| EvalError::Io { path: path.to_owned(), source })
    }

    fn timelines(&self) -> String {
        let step = (WIDTH - LEFT) / self.frames.max(1) as f64;
        let height = ROW * (self.objects.len() as f64 + 1.0) + AGES;
        let mut svg = format!("<svg width=\"{WIDTH}\" height=\"{height}\">");
        for (row, (name, object)) in self.objects.iter().enumerate() {
            let y = row as f64 * ROW;
            let _ = write!(svg, "<text x=\"0\" y=\"{:.1}\">{}</text>", y + 13.0, escape(name));
            for (frame, letter) in object.timeline.chars().enumerate() {
                let Some((_, colour, _)) = MEANINGS.iter().find(|(of, ..)| *of == letter) else { continue };
                let x = LEFT + frame as f64 * step;
                let _ = write!(
                    svg,
                    "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{step:.2}\" height=\"{}\" fill=\"{colour}\"/>",
                    ROW - 3.0
                );
            }
        }
        self.ages(&mut svg, step, height);
        let legend = MEANINGS.map(|(_, colour, text)| format!("<span style=\"color:{colour}\">&#9632;</span> {text} "));
        format!("{svg}</svg><p class=\"note\">{}</p>", legend.join(" "))
    }

    /// The age of each answer, up to twice what is on time.
    fn ages(&self, svg: &mut String, step: f64, height: f64) {
        let y = |ms: f64| height - (ms / (2.0 * ON_TIME_MS)).min(1.0) * (AGES - 20.0);
        let _ = write!(svg, "<text x=\"0\" y=\"{:.1}\">age, {ON_TIME_MS} ms at the line</text>", height - AGES + 24.0);
        let (line, right) = (y(ON_TIME_MS), WIDTH);
        let _ = write!(svg, "<line x1=\"{LEFT}\" y1=\"{line}\" x2=\"{right}\" y2=\"{line}\" stroke=\"#aaa\"/>");
        for (frame, age) in self.ages_ms.iter().enumerate() {
            if let Some(age) = age {
                let x = LEFT + (frame as f64 + 0.5) * step;
                let _ = write!(svg, "<circle cx=\"{x:.1}\" cy=\"{:.1}\" r=\"2\" fill=\"#4c6ef5\"/>", y(*age));
            }
        }
    }
}
