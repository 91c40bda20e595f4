use super::picture::{Bilinear, luminance};
use nalgebra::{Point2, Point3, Vector2};
use pseudoflow_geometry::{Intrinsics, Pose, rotation_angle_rad};
use pseudoflow_solver::PnpError;

/// A reference view and the real crop it was compared with. All planes are row-major, S x S, rgb interleaved.
#[derive(Debug, Clone, Copy)]
pub struct GateView<'a> {
    /// S, pixels.
    pub size_px: usize,
    /// The rendering, rgb; S * S * 3 bytes.
    pub reference_rgb: &'a [u8],
    /// Its depth along z, metres, 0 = background; S * S values.
    pub reference_depth_m: &'a [f32],
    /// The real crop, rgb; S * S * 3 bytes.
    pub crop_rgb: &'a [u8],
    /// Intrinsics K' of both.
    pub intrinsics: Intrinsics,
    /// The pose at which the reference was rendered, `camera_from_object`.
    pub initial: Pose,
}

/// What the pictures say about two poses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evidence {
    /// Photometric agreement at the initial pose: zero-mean normalised cross-correlation of luminance between the rendering
    /// and the crop, -1..1, mean over blocks. 0 without blocks.
    pub photometric_initial: f64,
    /// The same with the rendering's surface moved to the refined pose, over the same pixels.
    pub photometric_refined: f64,
    /// Blocks with enough pixels and texture.
    pub blocks: usize,
    /// Contrast of the crop across the rendering's contour at the initial pose, 0..1. 0 without contour points.
    pub silhouette_initial: f64,
    /// The same with the contour moved to the refined pose.
    pub silhouette_refined: f64,
    /// Contour points in view at both poses.
    pub contour_points: usize,
    /// Mean distance that the visible surface points move in the crop, pixels; infinite when one leaves the front.
    pub displacement_px: f64,
    /// Angle between the poses, radians.
    pub rotation_rad: f64,
    /// Share of the surface points that the refined pose keeps inside the crop, 0..1.
    pub share_in_view: f64,
}

/// Measures [`Evidence`]; holds working memory for it.
#[derive(Debug, Clone, Default)]
pub struct Gate {
    reference: Vec<f32>,
    crop: Vec<f32>,
    /// Luminance of the crop where each reference pixel's surface lies at the refined pose; NaN = not in view or turned
    /// away.
    moved: Vec<f32>,
}

/// Sums over a block for the correlation of reference `a` with crop values `b` at both poses.
#[derive(Default)]
struct Block {
    count: f64,
    a: Moments,
    initial: Moments,
    refined: Moments,
}

#[derive(Default)]
struct Moments {
    sum: f64,
    square: f64,
    with_a: f64,
}

impl Moments {
    fn add(&mut self, value: f64, a: f64) {
        self.sum += value;
        self.square += value * value;
        self.with_a += value * a;
    }

    fn variance(&self, n: f64) -> f64 {
        (self.square - self.sum * self.sum / n) / n
    }
}

/// Grey levels squared, added to the crop's variance: a flat crop correlates with nothing.
const NOISE_VARIANCE: f64 = 4.0;
/// A block of the rendering with a lower standard deviation has no texture to compare, grey levels.
const MIN_TEXTURE: f64 = 3.0;
/// Cosine between the surface's normal and the viewing ray below which the surface counts as turned away.
const MIN_FACING: f64 = 0.1;
/// Colour difference across a contour that counts as full contrast, grey levels.
const FULL_CONTRAST: f64 = 48.0;

impl Block {
    fn add(&mut self, a: f32, initial: f32, refined: f32) {
        let a = f64::from(a);
        self.count += 1.0;
        self.a.add(a, a);
        self.initial.add(f64::from(initial), a);
        self.refined.add(f64::from(refined), a);
    }

    fn has_texture(&self, min_count: f64) -> bool {
        self.count >= min_count && self.a.variance(self.count) > MIN_TEXTURE * MIN_TEXTURE
    }

    fn correlation(&self, b: &Moments) -> f64 {
        let n = self.count;
        let covariance = (b.with_a - self.a.sum * b.sum / n) / n;
        covariance / (self.a.variance(n) * (b.variance(n).max(0.0) + NOISE_VARIANCE)).sqrt()
    }
}

impl Gate {
    /// An empty gate.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Compares the initial pose with `refined`. `blocks_across` blocks span the crop (16 give 8 x 8 pixels at 128).
    ///
    /// # Errors
    /// [`PnpError::Plane`] when a plane has the wrong size; [`PnpError::Setting`] when a block would be under 4 pixels.
    pub fn evidence(
        &mut self,
        view: &GateView<'_>,
        refined: &Pose,
        blocks_across: usize,
    ) -> Result<Evidence, PnpError> {
        view.check(blocks_across)?;
        luminance(view.reference_rgb, &mut self.reference);
        luminance(view.crop_rgb, &mut self.crop);
        let motion = Motion { view, refined_from_initial: refined * view.initial.inverse() };
        let (displacement_px, share_in_view) = self.warp(&motion);
        let (photometric_initial, photometric_refined, blocks) =
            self.photometric(view.size_px, view.size_px / blocks_across);
        let (silhouette_initial, silhouette_refined, contour_points) = silhouette(&motion);
        Ok(Evidence {
            photometric_initial,
            photometric_refined,
            blocks,
            silhouette_initial,
            silhouette_refined,
            contour_points,
            displacement_px,
            rotation_rad: rotation_angle_rad(refined, &view.initial),
            share_in_view,
        })
    }

    /// Fills `moved`; returns the mean displacement and the share in view.
    fn warp(&mut self, motion: &Motion<'_>) -> (f64, f64) {
        let size = motion.view.size_px;
        self.moved.clear();
        self.moved.resize(size * size, f32::NAN);
        let (mut count, mut in_view, mut distance) = (0_usize, 0_usize, 0.0);
        for y in 0..size {
            for x in 0..size {
                let Some(target) = motion.target(x, y) else { continue };
                count += 1;
                let Some(target) = target else {
                    distance = f64::INFINITY;
                    continue;
                };
                distance += (target - Point2::new(x as f64, y as f64)).norm();
                let Some(bilinear) = Bilinear::at(target.x, target.y, size) else { continue };
                in_view += 1;
                if motion.still_faces_camera(x, y) {
                    self.moved[y * size + x] = bilinear.mix(|i| self.crop[i]);
                }
            }
        }
        let n = count.max(1) as f64;
        (distance / n, in_view as f64 / n)
    }

    /// Mean correlation at the initial and at the refined pose, and the count of blocks.
    fn photometric(&self, size_px: usize, block_px: usize) -> (f64, f64, usize) {
        let (mut initial, mut refined, mut blocks) = (0.0, 0.0, 0_usize);
        let min_count = (block_px * block_px) as f64 / 4.0;
        for top in (0..size_px).step_by(block_px) {
            for left in (0..size_px).step_by(block_px) {
                let block = self.block(size_px, block_px, top, left);
                if block.has_texture(min_count) {
                    initial += block.correlation(&block.initial);
                    refined += block.correlation(&block.refined);
                    blocks += 1;
                }
            }
        }
        let n = blocks.max(1) as f64;
        (initial / n, refined / n, blocks)
    }

    fn block(&self, size_px: usize, block_px: usize, top: usize, left: usize) -> Block {
        let mut block = Block::default();
        for y in top..(top + block_px).min(size_px) {
            for i in y * size_px + left..y * size_px + (left + block_px).min(size_px) {
                if self.moved[i].is_finite() {
                    block.add(self.reference[i], self.crop[i], self.moved[i]);
                }
            }
        }
        block
    }
}

impl GateView<'_> {
    fn check(&self, blocks_across: usize) -> Result<(), PnpError> {
        let (size_px, n) = (self.size_px, self.size_px * self.size_px);
        let planes = [
            ("reference_rgb", self.reference_rgb.len(), 3 * n),
            ("reference_depth_m", self.reference_depth_m.len(), n),
            ("crop_rgb", self.crop_rgb.len(), 3 * n),
        ];
        if let Some((plane, got, need)) = planes.into_iter().find(|(_, got, need)| got != need) {
            return Err(PnpError::Plane { plane, size_px, got, need });
        }
        if blocks_across == 0 || size_px / blocks_across < 4 {
            let must = "at least 1, and such that a block has at least 4 x 4 pixels";
            return Err(PnpError::Setting { name: "blocks_across", got: blocks_across as f64, must });
        }
        Ok(())
    }

    fn is_foreground(&self, i: usize) -> bool {
        let depth = self.reference_depth_m[i];
        depth > 0.0 && depth.is_finite()
    }

    /// Colour of the crop at a point, `None` outside.
    fn crop_colour(&self, at: Point2<f64>) -> Option<[f32; 3]> {
        let bilinear = Bilinear::at(at.x, at.y, self.size_px)?;
        Some([0, 1, 2].map(|c| bilinear.mix(|i| f32::from(self.crop_rgb[3 * i + c]))))
    }
}

/// Where reference pixels go from the initial to the refined pose.
struct Motion<'a> {
    view: &'a GateView<'a>,
    refined_from_initial: Pose,
}

impl Motion<'_> {
    /// `None` on the background, `Some(None)` when the point comes behind the camera.
    fn target(&self, x: usize, y: usize) -> Option<Option<Point2<f64>>> {
        let i = y * self.view.size_px + x;
        self.view
            .is_foreground(i)
            .then(|| self.view.intrinsics.project(&(self.refined_from_initial * self.point(x, y))))
    }

    /// Surface point of a pixel in the camera's frame at the initial pose.
    fn point(&self, x: usize, y: usize) -> Point3<f64> {
        let depth = f64::from(self.view.reference_depth_m[y * self.view.size_px + x]);
        self.view.intrinsics.unproject(&Point2::new(x as f64, y as f64), depth)
    }

    /// Whether the surface at a foreground pixel still faces the camera at the refined pose: what has turned away shows
    /// something else there. Pixels without neighbours to tell the direction count as facing.
    fn still_faces_camera(&self, x: usize, y: usize) -> bool {
        let size = self.view.size_px;
        let has = |x: usize, y: usize| x < size && y < size && self.view.is_foreground(y * size + x);
        if !has(x + 1, y) || !has(x, y + 1) {
            return true;
        }
        let point = self.point(x, y);
        // Along x cross along y points away from the camera.
        let away = (self.point(x + 1, y) - point).cross(&(self.point(x, y + 1) - point));
        let (away, seen_from) = (self.refined_from_initial * away, self.refined_from_initial * point);
        away.dot(&seen_from.coords) > MIN_FACING * away.norm() * seen_from.coords.norm()
    }
}

/// Mean contrast across the contour at both poses, and the count of points in view at both.
fn silhouette(motion: &Motion<'_>) -> (f64, f64, usize) {
    let view = motion.view;
    let reach = (view.size_px as f64 / 64.0).max(1.5);
    let (mut initial, mut refined, mut count) = (0.0, 0.0, 0_usize);
    for y in 2..view.size_px.saturating_sub(2) {
        for x in 2..view.size_px.saturating_sub(2) {
            let Some(normal) = contour_normal(view, x, y) else { continue };
            let Some(Some(target)) = motion.target(x, y) else { continue };
            let here = contrast(view, Point2::new(x as f64, y as f64), normal * reach);
            let there = contrast(view, target, normal * reach);
            if let (Some(here), Some(there)) = (here, there) {
                initial += here;
                refined += there;
                count += 1;
            }
        }
    }
    let n = count.max(1) as f64;
    (initial / n, refined / n, count)
}

/// The outward direction at a foreground pixel that touches the background, from its 5 x 5 neighbours.
fn contour_normal(view: &GateView<'_>, x: usize, y: usize) -> Option<Vector2<f64>> {
    let inside = |x: usize, y: usize| view.is_foreground(y * view.size_px + x);
    let edge = inside(x, y) && !(inside(x - 1, y) && inside(x + 1, y) && inside(x, y - 1) && inside(x, y + 1));
    if !edge {
        return None;
    }
    let mut out = Vector2::zeros();
    for (dy, dx) in (0..5).flat_map(|dy| (0..5).map(move |dx| (dy, dx))) {
        if !inside(x + dx - 2, y + dy - 2) {
            out += Vector2::new(dx as f64 - 2.0, dy as f64 - 2.0);
        }
    }
    out.try_normalize(1e-9)
}

/// Colour difference between both sides of a contour point, 0..1; `None` outside the crop.
fn contrast(view: &GateView<'_>, at: Point2<f64>, outward: Vector2<f64>) -> Option<f64> {
    let (outer, inner) = (view.crop_colour(at + outward)?, view.crop_colour(at - outward)?);
    let difference = (0..3).map(|c| f64::from(outer[c] - inner[c]).powi(2)).sum::<f64>().sqrt();
    Some((difference / FULL_CONTRAST).min(1.0))
}
