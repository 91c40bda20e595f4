use super::augment::{augmented, grey, planes};
use super::shrink;
use pseudoflow_msgs::{FlowFields, PseudoLabels, ReferenceViews};
use pseudoflow_network::{REFERENCE_CHANNELS, reference_geometry};
use rand_chacha::ChaCha8Rng;

/// One instance of one frame, ready to train with.
#[derive(Debug, Clone)]
pub struct Sample {
    /// Rendered views: `n x 3 x S x S`, colours in [-1, 1]; or `n x 5 x S x S` with [`reference_geometry`] behind them.
    pub reference: Vec<f32>,
    /// The real crop: `S x S x 3`.
    pub real_rgb: Vec<u8>,
    /// Draws the colours that the student sees; none: it sees the crop as it is.
    pub colours: Option<ChaCha8Rng>,
    /// Labels of the views, pixels: `n x 2 x S x S`; ignored where the mask is 0.
    pub flow_px: Vec<f32>,
    /// 1 where a label counts: `n x S x S`.
    pub mask: Vec<f32>,
    /// What the photometric loss compares; none without partners.
    pub photo: Option<Photo>,
}

/// The form in which the student takes a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SampleForm {
    /// How many times smaller its crops are than the teacher's.
    pub by: usize,
    /// Whether it takes the depth of the renderings.
    pub geometry: bool,
}

/// The real images of a sample's photometric loss, grey values 0..255 without augmentation.
#[derive(Debug, Clone)]
pub struct Photo {
    /// The real crop: `S x S`.
    pub grey: Vec<f32>,
    /// Not 0 on the object in view 0: `S x S`.
    pub mask: Vec<u8>,
    /// Not 0 where view 0 has a label: `S x S`.
    pub valid: Vec<u8>,
    /// Partners: the crop `S x S`, and the teacher's flow from view 0 to it `S x S x 2`.
    pub partners: Vec<(Vec<f32>, Vec<f32>)>,
}

/// `n x S x S x 2` as planes `n x 2 x S x S`.
fn flow_planes(interleaved: &[f32], area: usize) -> Vec<f32> {
    let field = |field: &[f32]| -> Vec<f32> {
        (0..2).flat_map(|axis| field.iter().skip(axis).step_by(2).copied().collect::<Vec<_>>()).collect()
    };
    interleaved.chunks_exact(2 * area).flat_map(field).collect()
}

impl Sample {
    /// The sample of an instance; `colours` draws the student's colours, without it the student sees the crop as it is.
    #[must_use]
    pub fn of(
        views: &ReferenceViews<'_>,
        flow: &FlowFields<'_>,
        labels: &PseudoLabels<'_>,
        instance: usize,
        form: SampleForm,
        colours: Option<ChaCha8Rng>,
    ) -> Self {
        let (n, size_px) = (views.header.views_per_instance as usize, views.header.size_px as usize);
        let (by, area) = (form.by, size_px * size_px);
        let of_views = |values: usize| instance * n * values..(instance + 1) * n * values;
        let real_rgb = shrink::rgb(&views.real_rgb[instance * 3 * area..(instance + 1) * 3 * area], size_px, by);
        let masks = labels.valid[of_views(area)].chunks_exact(area);
        let label = |(field, valid): (&[f32], &[u8])| shrink::flow(field, size_px, by, |p| valid[p] != 0);
        let fields = labels.label_px[of_views(2 * area)].chunks_exact(2 * area);
        let flow_px: Vec<f32> = fields.zip(masks.clone()).flat_map(label).collect();
        Self {
            reference: (instance * n..(instance + 1) * n).flat_map(|view| reference(views, view, form)).collect(),
            real_rgb,
            colours,
            flow_px: flow_planes(&flow_px, area / (by * by)),
            mask: masks.flat_map(|m| shrink::mask(m, size_px, by)).map(|v| f32::from(u8::from(v != 0))).collect(),
            photo: photo(views, flow, labels, instance, by),
        }
    }

    /// Rendered views.
    #[must_use]
    pub fn views(&self) -> usize {
        self.mask.len() * 3 / self.real_rgb.len()
    }

    /// The real crop as the student sees it this time, in [-1, 1]: `3 x S x S`.
    pub(super) fn real(&mut self) -> Vec<f32> {
        let size_px = (self.real_rgb.len() / 3).isqrt();
        match &mut self.colours {
            Some(rng) => augmented(&self.real_rgb, size_px, rng),
            None => planes(&self.real_rgb),
        }
    }
}

/// A rendered view as the student takes it.
fn reference(views: &ReferenceViews<'_>, view: usize, form: SampleForm) -> Vec<f32> {
    let size_px = views.header.size_px as usize;
    let area = size_px * size_px;
    let mut out = planes(&shrink::rgb(&views.rgb[view * 3 * area..(view + 1) * 3 * area], size_px, form.by));
    if form.geometry {
        let depth_m = shrink::depth(&views.depth_m[view * area..(view + 1) * area], size_px, form.by);
        let colours = out.len();
        out.resize(colours / 3 * REFERENCE_CHANNELS, 0.0);
        let focal_px = views.views[view].crop_intrinsics[0] / form.by as f64;
        reference_geometry(&depth_m, size_px / form.by, focal_px, &mut out[colours..]);
    }
    out
}

fn photo(
    views: &ReferenceViews<'_>,
    flow: &FlowFields<'_>,
    labels: &PseudoLabels<'_>,
    instance: usize,
    by: usize,
) -> Option<Photo> {
    let (n, m) = (views.header.views_per_instance as usize, views.header.partners_per_instance as usize);
    let size_px = views.header.size_px as usize;
    let area = size_px * size_px;
    let present = (instance * m..(instance + 1) * m).filter(|partner| views.partners[*partner].present == 1);
    let small_grey = |crops: &[u8], i: usize| grey(&shrink::rgb(&crops[i * 3 * area..(i + 1) * 3 * area], size_px, by));
    let partner = |partner: usize| {
        let field = views.views.len() + partner;
        let field = &flow.flow_px[field * 2 * area..(field + 1) * 2 * area];
        (small_grey(views.partner_rgb, partner), shrink::flow(field, size_px, by, |_| true))
    };
    let partners: Vec<_> = present.map(partner).collect();
    let first = instance * n * area..(instance * n + 1) * area;
    (!partners.is_empty()).then(|| Photo {
        grey: small_grey(views.real_rgb, instance),
        mask: shrink::mask(&views.mask[first.clone()], size_px, by),
        valid: shrink::mask(&labels.valid[first], size_px, by),
        partners,
    })
}
