use super::escape;
use std::fmt::Write;

const WIDTH: f64 = 320.0;
const HEIGHT: f64 = 210.0;
const LEFT: f64 = 38.0;
const RIGHT: f64 = 10.0;
const TOP: f64 = 22.0;
const BOTTOM: f64 = 34.0;

/// A curve of a chart.
pub(crate) struct Series {
    pub(crate) name: String,
    pub(crate) colour: String,
    pub(crate) points: Vec<(f64, f64)>,
}

/// Curves over `0..x_max`, `0..1`, as inline SVG.
pub(crate) fn line_chart(title: &str, x_label: &str, x_max: f64, series: &[Series]) -> String {
    let place = |(x, y): &(f64, f64)| {
        let x = LEFT + (x / x_max).clamp(0.0, 1.0) * (WIDTH - LEFT - RIGHT);
        let y = HEIGHT - BOTTOM - y.clamp(0.0, 1.0) * (HEIGHT - TOP - BOTTOM);
        format!("{x:.1},{y:.1}")
    };
    let mut svg = frame(title, x_label, x_max, 1.0, "");
    for Series { colour, points, .. } in series {
        let path: Vec<String> = points.iter().map(place).collect();
        let _ = write!(
            svg,
            "<polyline fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\" points=\"{}\"/>",
            path.join(" ")
        );
    }
    finish(svg, series)
}

/// How often values fall into 20 bins of `0..x_max`; what lies beyond is in the last.
pub(crate) fn histogram(title: &str, x_label: &str, x_max: f64, values: &[(String, String, Vec<f64>)]) -> String {
    const BINS: usize = 20;
    let bin = |v: &f64| ((v / x_max * BINS as f64) as usize).min(BINS - 1);
    let count = |values: &[f64]| {
        let mut counts = [0_usize; BINS];
        values.iter().for_each(|v| counts[bin(v)] += 1);
        counts
    };
    let counts: Vec<[usize; BINS]> = values.iter().map(|(_, _, v)| count(v)).collect();
    let highest = counts.iter().flatten().copied().max().unwrap_or(0).max(1) as f64;
    let mut svg = frame(title, x_label, x_max, highest, "+");
    let bar = (WIDTH - LEFT - RIGHT) / (BINS * values.len().max(1)) as f64;
    for (s, (counts, (_, colour, _))) in counts.iter().zip(values).enumerate() {
        for (i, n) in counts.iter().enumerate().filter(|(_, n)| **n > 0) {
            let height = *n as f64 / highest * (HEIGHT - TOP - BOTTOM);
            let (x, y) = (LEFT + (i * values.len() + s) as f64 * bar, HEIGHT - BOTTOM - height);
            let _ = write!(
                svg,
                "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{bar:.1}\" height=\"{height:.1}\" fill=\"{colour}\" fill-opacity=\".8\"/>"
            );
        }
    }
    let legend =
        values.iter().map(|(name, colour, _)| Series { name: name.clone(), colour: colour.clone(), points: vec![] });
    finish(svg, &legend.collect::<Vec<_>>())
}

fn frame(title: &str, x_label: &str, x_max: f64, y_max: f64, last: &str) -> String {
    let (right, bottom) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
    let mut svg = format!(
        "<figure><svg width=\"{WIDTH}\" height=\"{HEIGHT}\" role=\"img\"><text x=\"{LEFT}\" y=\"14\" font-weight=\"600\">{}</text>\
         <text x=\"{right}\" y=\"{:.0}\" text-anchor=\"end\">{}</text>",
        escape(title),
        HEIGHT - 4.0,
        escape(x_label)
    );
    for i in 0..=5 {
        let share = f64::from(i) / 5.0;
        let (x, y) = (LEFT + share * (right - LEFT), bottom - share * (bottom - TOP));
        let (x_text, y_text) = (number(share * x_max), number(share * y_max));
        let more = if i == 5 { last } else { "" };
        let _ = write!(
            svg,
            "<line x1=\"{LEFT}\" x2=\"{right}\" y1=\"{y:.1}\" y2=\"{y:.1}\" stroke=\"#e4e4e4\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{y_text}</text>\
             <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{x_text}{more}</text>",
            LEFT - 4.0,
            y + 4.0,
            bottom + 14.0
        );
    }
    svg
}

fn finish(mut svg: String, series: &[Series]) -> String {
    svg += "</svg><figcaption>";
    for Series { name, colour, .. } in series {
        let _ = write!(svg, "<span style=\"color:{colour}\">■</span> {} ", escape(name));
    }
    svg + "</figcaption></figure>\n"
}

/// With as many digits as an axis needs.
fn number(v: f64) -> String {
    let text = format!("{v:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_is_in_a_bar_and_names_are_escaped() {
        let values = vec![("a<b".to_owned(), "#000000".to_owned(), vec![0.0, 0.5, 99.0])];
        let svg = histogram("t", "x", 1.0, &values);
        assert_eq!(svg.matches("<rect").count(), 3);
        assert!(svg.contains("a&lt;b") && !svg.contains("a<b"));
    }

    #[test]
    fn a_curve_starts_and_ends_at_the_axes() {
        let series = [Series { name: "s".into(), colour: "#123456".into(), points: vec![(0.0, 0.0), (2.0, 1.0)] }];
        let svg = line_chart("t", "x", 2.0, &series);
        assert!(svg.contains("points=\"38.0,176.0 310.0,22.0\""), "{svg}");
    }
}
