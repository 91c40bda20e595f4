use pseudoflow_imaging::{RgbImage, flow_to_colour, heat_map, side_by_side};
use pseudoflow_msgs::{FlowFields, PseudoLabels, ReferenceViews};

/// Sigma of this many pixels of a 256 px crop is the hottest colour.
const HOTTEST_PX_AT_256: f32 = 4.0;
/// Flow of this share of the crop's side has the full colour.
const LONGEST: f32 = 0.2;

/// View 0 of an instance for the eye, each with its name: rendering, real crop, the teacher's flow, sigma (as in the
/// paper's figure; blue where too few views see the point), and the rendering, dark where there is no label. `None` when
/// there is no such instance.
#[must_use]
pub fn label_pictures(
    views: &ReferenceViews<'_>,
    flow: &FlowFields<'_>,
    labels: &PseudoLabels<'_>,
    instance: usize,
) -> Option<[(&'static str, RgbImage); 5]> {
    let (n, size_px) = (views.header.views_per_instance as usize, views.header.size_px);
    let (area, view) = ((size_px as usize).pow(2), instance * n);
    if instance >= views.header.instances as usize {
        return None;
    }
    let image = |plane: &[u8], at: usize| {
        RgbImage::from_raw(size_px, size_px, plane[at * 3 * area..(at + 1) * 3 * area].to_vec())
    };
    let on_object = &views.mask[view * area..(view + 1) * area];
    let field = flow.flow_px[view * 2 * area..(view + 1) * 2 * area].chunks_exact(2).zip(on_object);
    let shown: Vec<[f32; 2]> = field.map(|(f, on)| if *on == 0 { [f32::NAN; 2] } else { [f[0], f[1]] }).collect();
    let sigma = &labels.sigma_px[view * area..(view + 1) * area];
    let rendering = image(views.rgb, view)?;
    let mut labelled = rendering.clone();
    let valid = &labels.valid[view * area..(view + 1) * area];
    for (pixel, valid) in labelled.pixels_mut().zip(valid) {
        if *valid == 0 {
            pixel.0 = pixel.0.map(|v| v / 4);
        }
    }
    Some([
        ("labels/rendering", rendering),
        ("labels/crop", image(views.real_rgb, instance)?),
        ("labels/flow", flow_to_colour(&shown, size_px, size_px, LONGEST * size_px as f32)),
        ("labels/sigma", heat_map(sigma, size_px, size_px, 0.0, HOTTEST_PX_AT_256 * size_px as f32 / 256.0)),
        ("labels/valid", labelled),
    ])
}

/// [`label_pictures`] beside each other.
#[must_use]
pub fn label_panel(
    views: &ReferenceViews<'_>,
    flow: &FlowFields<'_>,
    labels: &PseudoLabels<'_>,
    instance: usize,
) -> Option<RgbImage> {
    let tiles = label_pictures(views, flow, labels, instance)?.map(|(_, picture)| picture);
    tiles.into_iter().reduce(|panel, tile| side_by_side(&panel, &tile))
}
