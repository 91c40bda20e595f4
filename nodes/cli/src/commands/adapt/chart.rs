//! Curves over training steps as inline SVG.

use std::fmt::Write as _;

const WIDTH: f64 = 900.0;
const HEIGHT: f64 = 260.0;
const LEFT: f64 = 60.0;
const BOTTOM: f64 = 34.0;
const TOP: f64 = 14.0;
const COLOURS: [&str; 4] = ["#b03020", "#2050a0", "#1e7a34", "#a040b0"];
const LINES: usize = 4;

/// One curve: step and value.
pub(super) struct Curve {
    pub(super) name: String,
    pub(super) points: Vec<(f64, f64)>,
}

/// Draws curves from 0 to their largest step and value.
pub(super) fn chart(unit: &str, curves: &[Curve]) -> String {
    let points = || curves.iter().flat_map(|curve| &curve.points);
    let last = points().map(|p| p.0).fold(1.0, f64::max);
    let top = points().map(|p| p.1).fold(1e-9, f64::max);
    let x = |step: f64| LEFT + (WIDTH - LEFT - 10.0) * step / last;
    let y = |value: f64| HEIGHT - BOTTOM - (HEIGHT - BOTTOM - TOP) * value / top;
    let mut svg = format!("<svg width=\"{WIDTH}\" height=\"{HEIGHT}\" font-size=\"12\" fill=\"#444\">");
    for i in 0..=LINES {
        let share = i as f64 / LINES as f64;
        let (value, step) = (share * top, share * last);
        let _ = write!(
            svg,
            "<path d=\"M{LEFT} {0:.1}H{1}\" stroke=\"#ddd\"/><text x=\"{2}\" y=\"{0:.1}\" text-anchor=\"end\">{value:.2}</text>\
             <text x=\"{3:.1}\" y=\"{4}\" text-anchor=\"middle\">{step:.0}</text>",
            y(value),
            WIDTH - 10.0,
            LEFT - 6.0,
            x(step),
            HEIGHT - 16.0
        );
    }
    for (i, curve) in curves.iter().enumerate() {
        let (colour, down) = (COLOURS[i % COLOURS.len()], 28 + 16 * i);
        let path: Vec<String> = curve.points.iter().map(|p| format!("{:.1},{:.1}", x(p.0), y(p.1))).collect();
        let _ = write!(
            svg,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/><text x=\"{}\" y=\"{down}\" \
             fill=\"{colour}\" text-anchor=\"end\">{} ({unit})</text>",
            path.join(" "),
            WIDTH - 16.0,
            curve.name
        );
    }
    svg + "</svg>"
}
