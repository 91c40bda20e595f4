//! The run's log (CSV, one line a step) and its plot (SVG).

use super::StepReport;
use crate::TrainerError;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

const HEADER: &str = "step,size_px,loss_px,epe_px,grad_norm,learning_rate";

/// The log of a run. It is kept whole and written at each checkpoint, so that it never runs ahead of it.
#[derive(Debug)]
pub(super) struct RunLog {
    path: PathBuf,
    pub(super) reports: Vec<StepReport>,
}

impl RunLog {
    pub(super) fn new(path: PathBuf) -> Self {
        Self { path, reports: Vec::new() }
    }

    /// The log of an earlier part of the run, up to and with `step`.
    pub(super) fn resumed(path: PathBuf, step: u64) -> Result<Self, TrainerError> {
        let text = std::fs::read_to_string(&path).map_err(TrainerError::io(&path))?;
        let reports: Option<Vec<StepReport>> = text.lines().skip(1).map(parse).collect();
        let mut reports = reports.ok_or_else(|| TrainerError::Log { path: path.clone() })?;
        reports.retain(|r| r.step <= step);
        Ok(Self { path, reports })
    }

    pub(super) fn save(&self) -> Result<(), TrainerError> {
        let mut text = format!("{HEADER}\n");
        for r in &self.reports {
            let StepReport { step, size_px, loss_px, epe_px, grad_norm, learning_rate } = r;
            let _ = writeln!(text, "{step},{size_px},{loss_px},{epe_px},{grad_norm},{learning_rate}");
        }
        write_atomically(&self.path, text.as_bytes())
    }

    /// Mean loss and end point error over the last `count` steps, pixels.
    pub(super) fn recent(&self, count: usize) -> (f32, f32) {
        let last = &self.reports[self.reports.len().saturating_sub(count)..];
        let mean = |f: fn(&StepReport) -> f32| last.iter().map(f).sum::<f32>() / last.len().max(1) as f32;
        (mean(|r| r.loss_px), mean(|r| r.epe_px))
    }

    /// Writes the curves of loss and end point error, each averaged over 1/200 of the run.
    pub(super) fn save_plot(&self, path: &Path) -> Result<(), TrainerError> {
        write_atomically(path, self.plot().as_bytes())
    }

    fn plot(&self) -> String {
        let window = self.reports.len().div_ceil(200).max(1);
        let averaged = |f: fn(&StepReport) -> f32| -> Vec<(f64, f64)> {
            let mean = |part: &[StepReport]| part.iter().map(|r| f64::from(f(r))).sum::<f64>() / part.len() as f64;
            self.reports.chunks(window).map(|part| (part[part.len() / 2].step as f64, mean(part))).collect()
        };
        let curves = [
            ("loss, px", "#b03020", averaged(|r| r.loss_px)),
            ("end point error, px", "#2050a0", averaged(|r| r.epe_px)),
        ];
        let top = curves.iter().flat_map(|c| &c.2).map(|p| p.1).fold(0.0, f64::max).max(1e-6);
        let last = self.reports.last().map_or(1.0, |r| r.step as f64);
        draw(&curves, top, last)
    }
}

/// Name, colour and points of a curve.
type Curve<'a> = (&'a str, &'a str, Vec<(f64, f64)>);

/// Axes from 0 to `last` steps and 0 to `top` pixels.
fn draw(curves: &[Curve<'_>], top: f64, last: f64) -> String {
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

fn parse(line: &str) -> Option<StepReport> {
    let mut parts = line.split(',');
    let report = StepReport {
        step: parts.next()?.parse().ok()?,
        size_px: parts.next()?.parse().ok()?,
        loss_px: parts.next()?.parse().ok()?,
        epe_px: parts.next()?.parse().ok()?,
        grad_norm: parts.next()?.parse().ok()?,
        learning_rate: parts.next()?.parse().ok()?,
    };
    parts.next().is_none().then_some(report)
}

/// Writes beside the target, then renames.
pub(crate) fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), TrainerError> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    std::fs::write(&partial, bytes).map_err(TrainerError::io(path))?;
    std::fs::rename(&partial, path).map_err(TrainerError::io(path))
}
