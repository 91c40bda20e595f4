//! The page about a training: curves of the trainer's log, the verdict, and held-out instances before and after.

use super::chart::{Curve, chart};
use super::judge::{Case, PANEL_PX, Verdict};
use super::{Args, training};
use anyhow::{Context as _, Result};
use base64::Engine as _;
use pseudoflow_geometry::pose_from_quaternion;
use pseudoflow_imaging::raster::{Rasteriser, SoftwareRasteriser};
use pseudoflow_imaging::{INITIAL_COLOUR, ObjectSet, REFINED_COLOUR, RgbImage, draw_pose_contour, encode_jpeg};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

const JPEG_QUALITY: u8 = 85;
/// Points of a curve.
const POINTS: usize = 200;

const STYLE: &str = "<style>body{font:15px/1.45 system-ui,sans-serif;max-width:1000px;margin:2em auto;color:#222}\
    figure{display:inline-block;margin:.4em}figcaption{font-size:12px;color:#555;max-width:220px}.note{color:#555}</style>";

/// Curves of the log: title, unit, columns.
const CURVES: [(&str, &str, &[&str]); 4] = [
    ("Losses", "loss", &["loss_flow", "loss_photo"]),
    ("Disagreement of the views (median sigma)", "px", &["median_sigma_px"]),
    ("Pixels with a label", "share", &["valid_fraction"]),
    ("Age of the teacher that labels", "steps", &["staleness_steps"]),
];

pub(super) fn write(args: &Args, folder: &Path, verdict: &Verdict) -> Result<PathBuf> {
    let out = args.report.clone().unwrap_or_else(|| folder.to_owned());
    std::fs::create_dir_all(&out).with_context(|| format!("{}: cannot be made", out.display()))?;
    let json = serde_json::to_vec_pretty(verdict)?;
    std::fs::write(out.join("verdict.json"), json).with_context(|| format!("{}: cannot be written", out.display()))?;
    let mut body = format!("<pre>{}</pre>\n", verdict.text());
    body += &curves(&folder.join(training::LOG))?;
    body += &labels(&folder.join(training::LABELS))?;
    body += "<h2>Held-out instances</h2>\n<p class=\"note\">Red: refined with the weights that went in. Green: with those \
             that came out. No truth is known here; the gain is that of the agreement.</p>\n";
    body += &pictures(args, verdict)?;
    let path = out.join("report.html");
    let title = format!("Adaptation of {}", args.weights.display());
    let page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title}</title>{STYLE}</head><body>\n<h1>{title}</h1>\n{body}</body></html>\n"
    );
    std::fs::write(&path, page).with_context(|| format!("{}: cannot be written", path.display()))?;
    Ok(path)
}

/// Label pictures in the order of the training.
fn labels(folder: &Path) -> Result<String> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path()).collect();
    files.sort();
    let mut html =
        "<h2>Labels while training</h2>\n<p class=\"note\">Rendering, real crop, the teacher's flow, disagreement of \
                    the views (black 0 to white 4 px of 256, blue: seen by too few), what is kept.</p>\n"
            .to_owned();
    for file in files {
        let jpeg = std::fs::read(&file).with_context(|| format!("{}: cannot be read", file.display()))?;
        let name = file.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        let _ = writeln!(
            html,
            "<figure><img width=\"900\" alt=\"labels\" src=\"{}\"><figcaption>sample {}</figcaption></figure>",
            data_uri(&jpeg),
            name.trim_start_matches('0')
        );
    }
    Ok(html)
}

fn data_uri(jpeg: &[u8]) -> String {
    format!("data:image/jpeg;base64,{}", base64::engine::general_purpose::STANDARD.encode(jpeg))
}

fn curves(log: &Path) -> Result<String> {
    let text = std::fs::read_to_string(log).with_context(|| format!("{}: cannot be read", log.display()))?;
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let rows: Vec<Vec<f64>> =
        lines.map(|line| line.split(',').map(|v| v.parse().unwrap_or(f64::NAN)).collect()).collect();
    let mut html = String::new();
    for (title, unit, columns) in CURVES {
        let series = columns.iter().filter_map(|name| {
            let (step, at) = (names.iter().position(|n| *n == "step")?, names.iter().position(|n| n == name)?);
            Some(Curve { name: name.replace('_', " "), points: averaged(&rows, step, at) })
        });
        let curves: Vec<Curve> = series.filter(|curve| !curve.points.is_empty()).collect();
        if !curves.is_empty() {
            let _ = write!(html, "<h2>{title}</h2>\n{}\n", chart(unit, &curves));
        }
    }
    Ok(html)
}

/// Means over equal parts of the training; NaN (no label in a step) is left out.
fn averaged(rows: &[Vec<f64>], step: usize, column: usize) -> Vec<(f64, f64)> {
    let points = rows.chunks(rows.len().div_ceil(POINTS).max(1)).filter_map(|part| {
        let values: Vec<f64> =
            part.iter().filter_map(|row| row.get(column)).copied().filter(|v| v.is_finite()).collect();
        let at = *part.get(part.len() / 2)?.get(step)?;
        (!values.is_empty()).then(|| (at, values.iter().sum::<f64>() / values.len() as f64))
    });
    points.collect()
}

/// The largest gains, the middle and the largest losses.
fn chosen(cases: &[Case]) -> Vec<&Case> {
    const EACH: usize = 4;
    let mut order: Vec<&Case> = cases.iter().collect();
    order.sort_by(|a, b| b.gain().total_cmp(&a.gain()));
    if order.len() <= 3 * EACH {
        return order;
    }
    let middle = order.len() / 2 - EACH / 2;
    [&order[..EACH], &order[middle..middle + EACH], &order[order.len() - EACH..]].concat()
}

fn pictures(args: &Args, verdict: &Verdict) -> Result<String> {
    let objects = ObjectSet::load(&args.objects)?;
    let mut rasteriser = SoftwareRasteriser::new();
    for object in objects.iter() {
        rasteriser.add_object(object.id, &object.mesh)?;
    }
    let mut html = String::new();
    for case in chosen(&verdict.cases) {
        let picture = picture(case, &rasteriser)?;
        let data = data_uri(&encode_jpeg(&picture, JPEG_QUALITY)?);
        let name = objects.get(case.before.pose.object_id).map(|o| o.name.clone())?;
        let _ = writeln!(
            html,
            "<figure><img width=\"{PANEL_PX}\" alt=\"{name}\" src=\"{data}\"><figcaption>{name}, \
             scene {}, image {}: {:+.2}</figcaption></figure>",
            case.scene_id,
            case.image_id,
            case.gain()
        );
    }
    Ok(html)
}

fn picture(case: &Case, rasteriser: &SoftwareRasteriser) -> Result<RgbImage> {
    let mut picture = case.crop.clone();
    for (judged, colour) in [(&case.before, INITIAL_COLOUR), (&case.after, REFINED_COLOUR)] {
        let pose = pose_from_quaternion(&judged.pose.rotation_xyzw, &judged.pose.translation_m)?;
        draw_pose_contour(&mut picture, rasteriser, judged.pose.object_id, &pose, &case.crop_intrinsics, colour)?;
    }
    Ok(picture)
}
