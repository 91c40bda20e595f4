//! The page about a training: curves of the trainer's log, the verdict, and held-out instances before and after.

use super::chart::{Curve, chart};
use super::judge::{self, Judgement};
use super::{Args, training};
use anyhow::{Context as _, Result};
use base64::Engine as _;
use pseudoflow_cli::training::files;
use pseudoflow_geometry::{Crop, Intrinsics, pose_from_quaternion};
use pseudoflow_imaging::raster::{Rasteriser, SoftwareRasteriser};
use pseudoflow_imaging::{
    INITIAL_COLOUR, ObjectSet, REFINED_COLOUR, RgbImage, draw_pose_contour, encode_jpeg, resample,
};
use pseudoflow_player::{LoadedFrame, open_recording};
use pseudoflow_pnp::judge::{JudgedFrame, JudgedInstance};
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

/// Width and height of the pictures.
const PANEL_PX: u32 = 220;

/// Writes the page into `out`; the training's files are in `folder`.
pub(super) fn write(args: &Args, folder: &Path, judgement: &Judgement, out: &Path) -> Result<PathBuf> {
    let mut body = format!("<pre>{}</pre>\n", judge::text(&judgement.verdict));
    body += &curves(&folder.join(files::LOG))?;
    body += &labels(&folder.join(training::LABELS))?;
    body += "<h2>Held-out instances</h2>\n<p class=\"note\">Red: refined with the weights that went in. Green: with those \
             that came out. No truth is known here; the gain is that of the agreement.</p>\n";
    body += &pictures(args, judgement)?;
    let path = out.join("report.html");
    let title = format!("Adaptation of {}", args.training.weights.display());
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

/// One held-out instance.
#[derive(Clone, Copy)]
struct Case<'a> {
    frame: &'a JudgedFrame,
    instance: &'a JudgedInstance,
}

/// The largest gains, the middle and the largest losses.
fn chosen(frames: &[JudgedFrame]) -> Vec<Case<'_>> {
    const EACH: usize = 4;
    let cases = frames.iter().flat_map(|frame| frame.instances.iter().map(move |instance| Case { frame, instance }));
    let mut order: Vec<Case<'_>> = cases.collect();
    order.sort_by(|a, b| b.instance.gain().total_cmp(&a.instance.gain()));
    if order.len() <= 3 * EACH {
        return order;
    }
    let middle = order.len() / 2 - EACH / 2;
    [&order[..EACH], &order[middle..middle + EACH], &order[order.len() - EACH..]].concat()
}

fn pictures(args: &Args, judgement: &Judgement) -> Result<String> {
    let objects = ObjectSet::load(&args.training.objects)?;
    let mut rasteriser = SoftwareRasteriser::new();
    for object in objects.iter() {
        rasteriser.add_object(object.id, &object.mesh)?;
    }
    let mut recordings = open_recording(&args.recordings())?;
    let mut html = String::new();
    for case in chosen(&judgement.frames) {
        let frame = recordings.load(judgement.played.number(case.frame.frame) as usize)?;
        let data = data_uri(&encode_jpeg(&picture(case.instance, frame, &rasteriser)?, JPEG_QUALITY)?);
        let name = objects.get(case.instance.object_id).map(|o| o.name.clone())?;
        let _ = writeln!(
            html,
            "<figure><img width=\"{PANEL_PX}\" alt=\"{name}\" src=\"{data}\"><figcaption>{name}, \
             scene {}, image {}: {:+.2}</figcaption></figure>",
            case.frame.scene_id,
            case.frame.image_id,
            case.instance.gain()
        );
    }
    Ok(html)
}

/// The instance's crop with the contours of both poses.
fn picture(of: &JudgedInstance, frame: LoadedFrame, rasteriser: &SoftwareRasteriser) -> Result<RgbImage> {
    let [fx, fy, cx, cy] = frame.header.intrinsics;
    let [x0, y0, side] = of.crop;
    let crop = Crop { x0, y0, side, size_px: PANEL_PX };
    let image = RgbImage::from_raw(frame.header.width, frame.header.height, frame.rgb).context("a frame is cut off")?;
    let (mut picture, camera) = (resample(&image, &crop), crop.intrinsics(&Intrinsics { fx, fy, cx, cy }));
    let of_after = of.after.as_ref().map(|after| (after, REFINED_COLOUR));
    for (judged, colour) in std::iter::once((&of.before, INITIAL_COLOUR)).chain(of_after) {
        let pose = pose_from_quaternion(&judged.pose.0, &judged.pose.1)?;
        draw_pose_contour(&mut picture, rasteriser, of.object_id, &pose, &camera, colour)?;
    }
    Ok(picture)
}
