//! Self-contained pages: no script, no file beside them.

mod chart;
mod diagnosis;
mod report_page;

pub(crate) use chart::{Series, histogram, line_chart};

/// Colours of the sets, in their order; the truth's is [`TRUTH_COLOUR`].
pub(crate) const SET_COLOURS: [[u8; 3]; 4] = [[220, 60, 40], [30, 140, 60], [40, 90, 200], [160, 60, 180]];

/// The colour of the truth in pictures.
pub(crate) const TRUTH_COLOUR: [u8; 3] = [30, 170, 240];

pub(crate) fn css_colour([r, g, b]: [u8; 3]) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

pub(crate) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

pub(crate) fn page(title: &str, body: &str) -> String {
    let title = escape(title);
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title}</title><style>\n\
         body{{font:15px/1.45 system-ui,sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;color:#222}}\n\
         table{{border-collapse:collapse;margin:1em 0}}td,th{{padding:.2em .6em;text-align:right;border-bottom:1px solid #ddd}}\n\
         td:first-child,th:first-child{{text-align:left}}tr.overall td{{font-weight:600;border-top:2px solid #888}}\n\
         figure{{display:inline-block;margin:.4em .6em .4em 0;vertical-align:top}}figcaption{{font-size:12px;color:#555}}\n\
         .note{{color:#555}}.better{{color:#1e7a34}}.worse{{color:#b3261e}}svg text{{font:11px system-ui,sans-serif;fill:#444}}\n\
         img{{display:block}}\n</style></head><body>\n<h1>{title}</h1>\n{body}\n</body></html>\n"
    )
}

/// A share as a percentage with one digit.
pub(crate) fn percent(share: f64) -> String {
    format!("{:.1}", 100.0 * share)
}

/// A number, or a dash where there is none.
pub(crate) fn optional(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "–".to_owned(), |v| format!("{v:.digits$}"))
}
