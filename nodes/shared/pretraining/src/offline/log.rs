//! The run's log (CSV, one line a step) and its plot (SVG).

use crate::PretrainError;
use pseudoflow_network::storage::write_atomically;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Name, colour and value of a curve of the plot.
pub(crate) type Curve<R> = (&'static str, &'static str, fn(&R) -> f32);

/// One line of a log.
pub(crate) trait Row: Sized + 'static {
    /// Names of the columns.
    const HEADER: &'static str;
    /// What the plot shows.
    const CURVES: &'static [Curve<Self>];
    /// The step it reports.
    fn step(&self) -> u64;
    /// As text.
    fn line(&self) -> String;
    /// From text.
    fn parse(line: &str) -> Option<Self>;
}

/// The log of a run. It is kept whole and written at each checkpoint, so that it never runs ahead of it.
#[derive(Debug)]
pub(crate) struct RunLog<R> {
    path: PathBuf,
    pub(crate) reports: Vec<R>,
}

impl<R: Row> RunLog<R> {
    pub(crate) fn new(path: PathBuf) -> Self {
        Self { path, reports: Vec::new() }
    }

    /// The log of an earlier part of the run, up to and with `step`.
    pub(crate) fn resumed(path: PathBuf, step: u64) -> Result<Self, PretrainError> {
        let text = std::fs::read_to_string(&path).map_err(PretrainError::io(&path))?;
        let reports: Option<Vec<R>> = text.lines().skip(1).map(R::parse).collect();
        let mut reports = reports.ok_or_else(|| PretrainError::Log { path: path.clone() })?;
        reports.retain(|r| r.step() <= step);
        Ok(Self { path, reports })
    }

    /// The CSV file.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn save(&self) -> Result<(), PretrainError> {
        let mut text = format!("{}\n", R::HEADER);
        for report in &self.reports {
            let _ = writeln!(text, "{}", report.line());
        }
        Ok(write_atomically(&self.path, text.as_bytes())?)
    }

    /// Mean of a value over the last `count` steps.
    pub(crate) fn recent(&self, count: usize, value: fn(&R) -> f32) -> f32 {
        let last = &self.reports[self.reports.len().saturating_sub(count)..];
        last.iter().map(value).sum::<f32>() / last.len().max(1) as f32
    }

    /// Writes the curves, each averaged over 1/200 of the run.
    pub(crate) fn save_plot(&self, path: &Path) -> Result<(), PretrainError> {
        Ok(write_atomically(path, self.plot().as_bytes())?)
    }

    fn plot(&self) -> String {
        let window = self.reports.len().div_ceil(200).max(1);
        let averaged = |f: fn(&R) -> f32| -> Vec<(f64, f64)> {
            let mean = |part: &[R]| part.iter().map(|r| f64::from(f(r))).sum::<f64>() / part.len() as f64;
            self.reports.chunks(window).map(|part| (part[part.len() / 2].step() as f64, mean(part))).collect()
        };
        let lines: Vec<Line<'_>> = R::CURVES.iter().map(|(name, colour, f)| (*name, *colour, averaged(*f))).collect();
        let top = lines.iter().flat_map(|c| &c.2).map(|p| p.1).fold(0.0, f64::max).max(1e-6);
        let last = self.reports.last().map_or(1.0, |r| r.step() as f64);
        draw(&lines, top, last)
    }
}

/// Name, colour and points of a curve.
type Line<'a> = (&'a str, &'a str, Vec<(f64, f64)>);

/// Axes from 0 to `last` steps and 0 to `top`.
fn draw(curves: &[Line<'_>], top: f64, last: f64) -> String {
    const W: f64 = 800.0;
    const H: f64 = 400.0;
    let (x, y) = (|step: f64| 60.0 + (W - 80.0) * step / last, |v: f64| H - 40.0 - (H - 60.0) * v / top);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{W}\" height=\"{H}\" font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"{W}\" height=\"{H}\" fill=\"white\"/>\n"
    );
    for i in 0..=4 {
        let (value, step) = (top * f64::from(i) / 4.0, last * f64::from(i) / 4.0);
        let _ = writeln!(
            svg,
            "<path d=\"M60 {0:.1}H{1}\" stroke=\"#ddd\"/><text x=\"52\" y=\"{0:.1}\" text-anchor=\"end\">{value:.2}</text>",
            y(value),
            W - 20.0
        );
        let _ = writeln!(svg, "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"middle\">{step:.0}</text>", x(step), H - 20.0);
    }
    for (i, (name, colour, points)) in curves.iter().enumerate() {
        let line: Vec<String> = points.iter().map(|p| format!("{:.1},{:.1}", x(p.0), y(p.1))).collect();
        let _ = writeln!(
            svg,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/>",
            line.join(" ")
        );
        let _ = writeln!(
            svg,
            "<text x=\"{}\" y=\"{}\" fill=\"{colour}\" text-anchor=\"end\">{name}</text>",
            W - 24.0,
            30 + 18 * i
        );
    }
    let _ = writeln!(svg, "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">step</text>\n</svg>", W / 2.0, H - 4.0);
    svg
}
