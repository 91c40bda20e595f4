use crate::depth::mask;
use crate::html::{SET_COLOURS, TRUTH_COLOUR, escape};
use crate::{EvalDataset, EvalError, EvalImage, InstanceErrors, NamedEstimates, Report};
use pseudoflow_geometry::Crop;
use pseudoflow_imaging::{draw_contour, encode_jpeg, resample};
use pseudoflow_metrics::MatrixPose;
use rayon::prelude::*;
use std::fmt::Write;

const PANEL_PX: u32 = 220;
const JPEG_QUALITY: u8 = 85;

/// Pictures of one instance: each set's pose, then the truth.
#[derive(Debug, Clone, PartialEq)]
pub struct OverlayCase {
    /// Object.
    pub object_id: u32,
    /// Which case, where, and how wrong.
    pub caption: String,
    /// Name and JPEG of each picture; no picture for a set that did not find the instance.
    pub panels: Vec<(String, Vec<u8>)>,
}

/// Pictures of the best, median and worst instance of each object, by ADD(-S) in diameters of the last set (what it
/// did not find is worst). `sets` are those that the report was made from.
///
/// # Errors
/// When an image cannot be read.
pub fn overlays(
    dataset: &EvalDataset,
    sets: &[NamedEstimates],
    report: &Report,
) -> Result<Vec<OverlayCase>, EvalError> {
    let Some(last) = sets.last().and_then(|set| report.instances.get(&set.name)) else { return Ok(Vec::new()) };
    let mut chosen: Vec<(&str, usize)> = Vec::new();
    for object_id in report.objects.keys() {
        let mut order: Vec<usize> = (0..last.len()).filter(|i| last[*i].object_id == *object_id).collect();
        order.sort_by(|a, b| error(&last[*a]).total_cmp(&error(&last[*b])));
        let places = [("best", 0), ("median", order.len() / 2), ("worst", order.len().saturating_sub(1))];
        let mut cases: Vec<(&str, usize)> = places.iter().filter_map(|(n, i)| Some((*n, *order.get(*i)?))).collect();
        cases.dedup_by_key(|(_, i)| *i);
        chosen.extend(cases);
    }
    chosen.into_par_iter().map(|(label, i)| case(dataset, sets, report, label, i)).collect()
}

fn error(instance: &InstanceErrors) -> f64 {
    instance.add_s_of_diameter.unwrap_or(f64::INFINITY)
}

fn case(
    dataset: &EvalDataset,
    sets: &[NamedEstimates],
    report: &Report,
    label: &str,
    index: usize,
) -> Result<OverlayCase, EvalError> {
    let mut caption = label.to_owned();
    let mut poses: Vec<(String, [u8; 3], MatrixPose)> = Vec::new();
    for (s, set) in sets.iter().enumerate() {
        let instance = &report.instances[&set.name][index];
        if s == 0 {
            let _ = write!(caption, ": scene {}, image {}", instance.scene_id, instance.image_id);
        }
        match (instance.estimate.and_then(|row| set.estimates.get(row)), instance.add_s_of_diameter) {
            (Some(e), Some(d)) => {
                let _ = write!(caption, "; {} {d:.3} d", set.name);
                poses.push((set.name.clone(), SET_COLOURS[s % SET_COLOURS.len()], e.camera_from_object));
            }
            _ => caption += &format!("; {} not found", set.name),
        }
    }
    let instance = &report.instances[&sets[0].name][index];
    let at = |image: &&EvalImage| (image.scene_id, image.frame.image_id) == (instance.scene_id, instance.image_id);
    let panels = match dataset.images.iter().find(at) {
        Some(image) => {
            poses.push(("truth".to_owned(), TRUTH_COLOUR, image.truth[instance.instance as usize].camera_from_object));
            panels(dataset, image, instance.object_id, &poses)?
        }
        None => Vec::new(),
    };
    Ok(OverlayCase { object_id: instance.object_id, caption, panels })
}

fn panels(
    dataset: &EvalDataset,
    image: &EvalImage,
    object_id: u32,
    poses: &[(String, [u8; 3], MatrixPose)],
) -> Result<Vec<(String, Vec<u8>)>, EvalError> {
    let object = dataset.objects.get(object_id)?;
    // The truth stands last; the crop is around it, with room for a pose beside it.
    let Some((_, _, truth)) = poses.last() else { return Ok(Vec::new()) };
    let crop = Crop::around(&object.hull_m, &truth.pose(), &image.frame.intrinsics, 1.7, PANEL_PX);
    let Some(crop) = crop else { return Ok(Vec::new()) };
    let background = resample(&image.frame.load_image()?, &crop);
    let camera = crop.intrinsics(&image.frame.intrinsics);
    let panel = |(name, colour, pose): &(String, [u8; 3], MatrixPose)| {
        let mut picture = background.clone();
        let mask = mask(&dataset.models[&object_id], pose, &camera, PANEL_PX);
        draw_contour(&mut picture, &mask, *colour, 2);
        Ok((name.clone(), encode_jpeg(&picture, JPEG_QUALITY)?))
    };
    poses.iter().map(panel).collect()
}

impl OverlayCase {
    pub(crate) fn write_html(&self, html: &mut String) {
        let _ = writeln!(html, "<p>{}</p>", escape(&self.caption));
        for (name, jpeg) in &self.panels {
            let _ = writeln!(
                html,
                "<figure><img width=\"{PANEL_PX}\" height=\"{PANEL_PX}\" alt=\"{0}\" src=\"data:image/jpeg;base64,{1}\">\
                 <figcaption>{0}</figcaption></figure>",
                escape(name),
                base64(jpeg)
            );
        }
    }
}

/// RFC 4648 with padding.
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let group = (0..3).fold(0_u32, |g, i| g << 8 | u32::from(chunk.get(i).copied().unwrap_or(0)));
        for i in 0..4 {
            let digit = char::from(DIGITS[(group >> (18 - 6 * i)) as usize & 63]);
            text.push(if i <= chunk.len() { digit } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_that_of_the_rfc() {
        let cases =
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foob", "Zm9vYg=="), ("foobar", "Zm9vYmFy")];
        for (plain, encoded) in cases {
            assert_eq!(base64(plain.as_bytes()), encoded);
        }
    }
}
