//! The detector's loss, with its gradients: focal loss of the classes, and for cells inside an object the distance of its
//! box corners from the rays through their predicted pixels (Hu et al. 2021, section 3.3), plus that in the image, plus that
//! of the surface point from the true one.

use pseudoflow_network::{CORNERS, Grid, SURFACE_UNIT};
use rayon::prelude::*;

/// What a synthetic image shows. The network's input is its image.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneTruth {
    /// fx, fy, cx, cy of the input, pixels.
    pub intrinsics: [f32; 4],
    /// For each cell the instance that is seen at its centre, counted from 1; 0 for none.
    pub owner: Vec<u8>,
    /// For each cell with an owner the point of its surface that is seen at the centre, diameters from the middle of the
    /// object's box.
    pub surface: Vec<[f32; 3]>,
    /// The instances.
    pub instances: Vec<InstanceTruth>,
}

/// One object of a [`SceneTruth`].
#[derive(Debug, Clone, PartialEq)]
pub struct InstanceTruth {
    /// Place of the object among the network's outputs.
    pub class: usize,
    /// Box corners in the camera's frame, metres, all before the camera.
    pub corners_m: [[f32; 3]; CORNERS],
    /// Diameter, metres.
    pub diameter_m: f32,
    /// Larger side of the projection, pixels of the input.
    pub side_px: f32,
    /// Left, top, right and bottom of the projection, hidden parts included, pixels of the input.
    pub rectangle_px: [f32; 4],
}

/// What the network says about a batch.
#[derive(Debug, Clone, Copy)]
pub struct DetectorOutput<'a> {
    /// (n, objects, cells).
    pub logits: &'a [f32],
    /// (n, 16 objects, cells).
    pub offsets: &'a [f32],
    /// (n, 3 objects, cells).
    pub surface: &'a [f32],
    /// (n, 4, cells).
    pub rectangles: &'a [f32],
    /// Objects.
    pub objects: usize,
}

/// Weights of the loss's parts. Where an object is and how large matters most, since views are compared there: with
/// corners and surface points at three and six, what a small network can hardly learn about turns, the classes were a
/// twelfth of the loss, and small objects were not found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LossWeights {
    /// Of the classes.
    pub class: f32,
    /// Of the distance from the rays, in diameters.
    pub space: f32,
    /// Of the distance in the image, in sides of the projection.
    pub image: f32,
    /// Of the surface point, in diameters.
    pub surface: f32,
    /// Of the rectangle's edges, in sides.
    pub rectangle: f32,
}

impl Default for LossWeights {
    fn default() -> Self {
        Self { class: 4.0, space: 1.0, image: 0.3, surface: 2.0, rectangle: 4.0 }
    }
}

/// Value and gradients of a loss.
#[derive(Debug, Clone, PartialEq)]
pub struct DetectionLoss {
    /// Sum of all parts.
    pub total: f32,
    /// The classes' part.
    pub class: f32,
    /// Mean distance of the corners from their rays at cells inside objects, diameters.
    pub space_diameters: f32,
    /// Mean distance of the corners in the image, sides of the projection.
    pub image_sides: f32,
    /// Mean distance of the surface points, diameters.
    pub surface_diameters: f32,
    /// Mean distance of the rectangle's edges, sides of the projection.
    pub rectangle_sides: f32,
    /// Cells inside objects.
    pub positives: usize,
    /// As [`DetectorOutput::logits`].
    pub logit_gradient: Vec<f32>,
    /// As [`DetectorOutput::offsets`].
    pub offset_gradient: Vec<f32>,
    /// As [`DetectorOutput::surface`].
    pub surface_gradient: Vec<f32>,
    /// As [`DetectorOutput::rectangles`].
    pub rectangle_gradient: Vec<f32>,
}

/// Focal loss's constants (Lin et al. 2017).
const ALPHA: f32 = 0.25;
const GAMMA: f32 = 2.0;

/// Distances below this are nearly free, in diameters or sides.
const EPSILON: f32 = 0.01;

/// Sums over one image.
struct ImageLoss {
    class: f64,
    space: f64,
    image: f64,
    surface: f64,
    rectangle: f64,
}

/// A cell inside an object that its level takes.
struct Positive {
    cell: usize,
    instance: usize,
    weight: f32,
}

/// The loss of a batch, and its gradients. The same for every number of threads.
///
/// # Panics
/// When lengths do not fit the grid.
#[must_use]
pub fn detection_loss(
    output: &DetectorOutput<'_>,
    truth: &[SceneTruth],
    grid: &Grid,
    weights: &LossWeights,
) -> DetectionLoss {
    let (cells, objects) = (grid.cells.len(), output.objects);
    assert_eq!(output.logits.len(), truth.len() * objects * cells, "logits of every image, object and cell");
    assert_eq!(output.offsets.len(), truth.len() * objects * 2 * CORNERS * cells, "offsets of every corner");
    assert_eq!(output.surface.len(), truth.len() * objects * 3 * cells, "a surface point of every object");
    let positives: Vec<Vec<Positive>> = truth.iter().map(|scene| positives(scene, grid)).collect();
    let count: usize = positives.iter().map(Vec::len).sum();
    let weight_sum = positives.iter().flatten().map(|p| f64::from(p.weight)).sum::<f64>().max(1e-9) as f32;
    let mut logit_gradient = vec![0.0; output.logits.len()];
    let mut offset_gradient = vec![0.0; output.offsets.len()];
    let mut surface_gradient = vec![0.0; output.surface.len()];
    let mut rectangle_gradient = vec![0.0; output.rectangles.len()];
    let class_scale = 1.0 / count.max(1) as f32;
    let (logit_chunk, offset_chunk, surface_chunk) =
        (objects * cells, objects * 2 * CORNERS * cells, objects * 3 * cells);
    let images: Vec<ImageLoss> = (
        output.logits.par_chunks_exact(logit_chunk),
        output.offsets.par_chunks_exact(offset_chunk),
        (output.surface.par_chunks_exact(surface_chunk), output.rectangles.par_chunks_exact(4 * cells)),
        logit_gradient.par_chunks_exact_mut(logit_chunk),
        offset_gradient.par_chunks_exact_mut(offset_chunk),
        (surface_gradient.par_chunks_exact_mut(surface_chunk), rectangle_gradient.par_chunks_exact_mut(4 * cells)),
        truth.par_iter(),
        positives.par_iter(),
    )
        .into_par_iter()
        .map(|(logits, offsets, (surface, rectangles), by_logit, by_offset, by_more, scene, positives)| {
            let (by_surface, by_rectangle) = by_more;
            let class = focal(logits, scene, positives, (class_scale, weights.class), by_logit);
            let corners = Corners { scene, grid, weights, scale: 1.0 / (weight_sum * CORNERS as f32) };
            let (space, image) = corners.loss(offsets, positives, by_offset);
            let surface = corners.surface(surface, positives, by_surface);
            let rectangle = corners.rectangle(rectangles, positives, by_rectangle);
            ImageLoss { class, space, image, surface, rectangle }
        })
        .collect();
    let sum = |part: fn(&ImageLoss) -> f64| images.iter().map(part).sum::<f64>() as f32;
    let (class, space, image) = (sum(|i| i.class), sum(|i| i.space), sum(|i| i.image));
    let (surface, rectangle) = (sum(|i| i.surface), sum(|i| i.rectangle));
    DetectionLoss {
        total: weights.class * class
            + weights.space * space
            + weights.image * image
            + weights.surface * surface
            + weights.rectangle * rectangle,
        class,
        space_diameters: space,
        image_sides: image,
        surface_diameters: surface,
        rectangle_sides: rectangle,
        positives: count,
        logit_gradient,
        offset_gradient,
        surface_gradient,
        rectangle_gradient,
    }
}

/// Large objects have many cells; each instance counts at each level with the root of their number.
fn positives(scene: &SceneTruth, grid: &Grid) -> Vec<Positive> {
    assert_eq!(scene.owner.len(), grid.cells.len(), "an owner of every cell");
    assert_eq!(scene.surface.len(), grid.cells.len(), "a surface point of every cell");
    let mut found: Vec<Positive> = Vec::new();
    let mut counts = vec![[0_usize; super::STRIDES.len()]; scene.instances.len()];
    for (cell, owner) in scene.owner.iter().enumerate().filter(|(_, owner)| **owner > 0) {
        let instance = usize::from(*owner) - 1;
        let level = grid.cells[cell].level;
        if Grid::takes(level, scene.instances[instance].side_px) {
            counts[instance][level] += 1;
            found.push(Positive { cell, instance, weight: 0.0 });
        }
    }
    for positive in &mut found {
        let level = grid.cells[positive.cell].level;
        positive.weight = 1.0 / (counts[positive.instance][level] as f32).sqrt();
    }
    found
}

/// Focal loss of one image's logits (objects, cells) times a scale, and its gradient, times a weight.
fn focal(
    logits: &[f32],
    scene: &SceneTruth,
    positives: &[Positive],
    (scale, weight): (f32, f32),
    gradient: &mut [f32],
) -> f64 {
    let cells = scene.owner.len();
    let mut is_object = vec![false; logits.len()];
    positives.iter().for_each(|p| is_object[scene.instances[p.instance].class * cells + p.cell] = true);
    let mut sum = 0.0_f64;
    for ((logit, is_object), gradient) in logits.iter().zip(is_object).zip(gradient) {
        // The background's loss is the object's at the negative logit, but for alpha.
        let (x, alpha, sign) = if is_object { (*logit, ALPHA, 1.0) } else { (-*logit, 1.0 - ALPHA, -1.0) };
        let (p, log_p) = (1.0 / (1.0 + (-x).exp()), -softplus(-x));
        let focus = alpha * (1.0 - p).powf(GAMMA);
        sum += f64::from(-focus * log_p * scale);
        *gradient = sign * weight * scale * focus * (GAMMA * p * log_p - (1.0 - p));
    }
    sum
}

/// ln(1 + e^x), safe for large x.
fn softplus(x: f32) -> f32 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

/// The parts of corners, surface and rectangle for one image.
struct Corners<'a> {
    scene: &'a SceneTruth,
    grid: &'a Grid,
    weights: &'a LossWeights,
    scale: f32,
}

impl Corners<'_> {
    fn loss(&self, offsets: &[f32], positives: &[Positive], gradient: &mut [f32]) -> (f64, f64) {
        let cells = self.grid.cells.len();
        let (mut space, mut image) = (0.0_f64, 0.0_f64);
        for positive in positives {
            let cell = &self.grid.cells[positive.cell];
            let instance = &self.scene.instances[positive.instance];
            for (corner, point) in instance.corners_m.iter().enumerate() {
                let at = (instance.class * 2 * CORNERS + 2 * corner) * cells + positive.cell;
                let offset = [offsets[at], offsets[at + cells]];
                let pixel = [0, 1].map(|k| cell.centre_px[k] + cell.unit_px * offset[k]);
                let weight = positive.weight * self.scale;
                let (in_space, by_space) = from_ray(pixel, point, instance.diameter_m, &self.scene.intrinsics);
                let (in_image, by_image) = from_pixel(pixel, point, instance.side_px, &self.scene.intrinsics);
                space += f64::from(weight * in_space);
                image += f64::from(weight * in_image);
                for k in 0..2 {
                    let slope = self.weights.space * by_space[k] + self.weights.image * by_image[k];
                    gradient[at + k * cells] = weight * slope * cell.unit_px;
                }
            }
        }
        (space, image)
    }

    /// The rectangles' part: the mean distance of the four edges.
    fn rectangle(&self, rectangles: &[f32], positives: &[Positive], gradient: &mut [f32]) -> f64 {
        let cells = self.grid.cells.len();
        let mut sum = 0.0_f64;
        for positive in positives {
            let cell = &self.grid.cells[positive.cell];
            let instance = &self.scene.instances[positive.instance];
            let weight = positive.weight * self.scale * CORNERS as f32 / 4.0;
            for (edge, truth) in instance.rectangle_px.iter().enumerate() {
                let at = edge * cells + positive.cell;
                let found = cell.centre_px[edge % 2] + cell.unit_px * rectangles[at];
                let away = (found - truth) / instance.side_px;
                let (value, slope) = rounded(away * away);
                sum += f64::from(weight * value);
                gradient[at] = self.weights.rectangle * weight * 2.0 * slope * away * cell.unit_px / instance.side_px;
            }
        }
        sum
    }

    /// The surface points' part.
    fn surface(&self, surface: &[f32], positives: &[Positive], gradient: &mut [f32]) -> f64 {
        let cells = self.grid.cells.len();
        let mut sum = 0.0_f64;
        for positive in positives {
            let at = self.scene.instances[positive.instance].class * 3 * cells + positive.cell;
            let truth = self.scene.surface[positive.cell];
            let away: [f32; 3] = std::array::from_fn(|k| SURFACE_UNIT * surface[at + k * cells] - truth[k]);
            let (value, slope) = rounded(away.iter().map(|a| a * a).sum());
            let weight = positive.weight * self.scale * CORNERS as f32;
            sum += f64::from(weight * value);
            for (k, away) in away.into_iter().enumerate() {
                gradient[at + k * cells] = self.weights.surface * weight * 2.0 * slope * away * SURFACE_UNIT;
            }
        }
        sum
    }
}

/// sqrt(q + e^2) - e and its slope, of a squared distance q.
fn rounded(squared: f32) -> (f32, f32) {
    let root = (squared + EPSILON * EPSILON).sqrt();
    (root - EPSILON, 0.5 / root)
}

/// Distance of a point from the ray through a pixel, diameters, and its gradient with respect to the pixel.
fn from_ray(pixel: [f32; 2], point: &[f32; 3], diameter_m: f32, [fx, fy, cx, cy]: &[f32; 4]) -> (f32, [f32; 2]) {
    let p = point.map(|v| v / diameter_m);
    let v = [(pixel[0] - cx) / fx, (pixel[1] - cy) / fy, 1.0];
    let dot = |a: &[f32; 3], b: &[f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let (vv, vp) = (dot(&v, &v), dot(&v, &p));
    let along = vp / vv;
    let away: [f32; 3] = std::array::from_fn(|k| p[k] - along * v[k]);
    let (value, slope) = rounded(dot(&away, &away));
    // d|away|^2/dv = -2 along away, as `away` is perpendicular to v.
    (value, [-2.0 * slope * along * away[0] / fx, -2.0 * slope * along * away[1] / fy])
}

/// Distance of a pixel from a point's projection, in sides, and its gradient with respect to the pixel.
fn from_pixel(pixel: [f32; 2], point: &[f32; 3], side_px: f32, [fx, fy, cx, cy]: &[f32; 4]) -> (f32, [f32; 2]) {
    let to = [fx * point[0] / point[2] + cx, fy * point[1] / point[2] + cy];
    let away = [(pixel[0] - to[0]) / side_px, (pixel[1] - to[1]) / side_px];
    let (value, slope) = rounded(away[0] * away[0] + away[1] * away[1]);
    (value, away.map(|a| 2.0 * slope * a / side_px))
}
