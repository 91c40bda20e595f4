use crate::RgbImage;

/// A texture with its mip levels. Sampling is linear in the sRGB-encoded values.
///
/// Texels that no triangle uses are first filled from their neighbours, so that the levels for small images do
/// not bleed the background of the atlas into the object.
#[derive(Debug, Clone)]
pub struct Texture {
    levels: Vec<Level>,
    repeat: bool,
}

/// One mip level, row-major from the top row.
#[derive(Debug, Clone)]
pub struct Level {
    /// Texels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Texels as RGBA; A is not used.
    pub data: Vec<[u8; 4]>,
}

/// One level while the pyramid is built: colour sums weighted by coverage.
struct Weighted {
    width: usize,
    height: usize,
    colour: Vec<[f32; 3]>,
    weight: Vec<f32>,
}

impl Texture {
    /// Builds the mip levels. Coordinates outside `[0, 1]` make the texture repeat, else it is clamped.
    #[must_use]
    pub fn new(image: &RgbImage, texcoords: &[[f32; 2]], triangles: &[[u32; 3]]) -> Self {
        let repeat = texcoords.iter().flatten().any(|c| !(-1e-3..=1.001).contains(c));
        let mut levels = vec![Weighted::base(image, texcoords, triangles, repeat)];
        while levels.last().is_some_and(|l| l.width > 1 || l.height > 1) {
            let next = levels[levels.len() - 1].halved();
            levels.push(next);
        }
        for i in (0..levels.len() - 1).rev() {
            let (fine, coarse) = levels.split_at_mut(i + 1);
            fine[i].fill_from(&coarse[0]);
        }
        Self { levels: levels.iter().map(Weighted::quantised).collect(), repeat }
    }

    /// The mip levels, finest first, each half as wide and high (rounded down, at least 1).
    #[must_use]
    pub fn levels(&self) -> &[Level] {
        &self.levels
    }

    /// Whether coordinates wrap around (else they are clamped to the edge).
    #[must_use]
    pub fn repeats(&self) -> bool {
        self.repeat
    }

    /// The colour (0 to 1, sRGB-encoded) at `uv` for a pixel whose neighbours to the right and below lie at
    /// `uv + d_dx` and `uv + d_dy`. Trilinear, with up to [`MAX_TAPS`] samples along the longer axis of the
    /// footprint. The GPU rasteriser's shader does the same.
    #[must_use]
    pub fn sample(&self, uv: [f32; 2], d_dx: [f32; 2], d_dy: [f32; 2]) -> [f32; 3] {
        let size = [self.levels[0].width as f32, self.levels[0].height as f32];
        let length = |d: [f32; 2]| ((d[0] * size[0]).powi(2) + (d[1] * size[1]).powi(2)).sqrt();
        let (along_x, along_y) = (length(d_dx), length(d_dy));
        let (major, minor, axis) = if along_x >= along_y { (along_x, along_y, d_dx) } else { (along_y, along_x, d_dy) };
        let taps = ((major / minor.max(1e-6)).min(MAX_TAPS) + 0.5) as i32 as f32;
        let taps = taps.max(1.0);
        let level = (major / taps).max(1.0).log2();
        if taps < 1.5 {
            return self.trilinear(uv, level);
        }
        let mut sum = [0.0; 3];
        for tap in 0..taps as usize {
            let at = (tap as f32 + 0.5) / taps - 0.5;
            let colour = self.trilinear([uv[0] + at * axis[0], uv[1] + at * axis[1]], level);
            (0..3).for_each(|k| sum[k] += colour[k]);
        }
        sum.map(|c| c / taps)
    }

    fn trilinear(&self, uv: [f32; 2], level: f32) -> [f32; 3] {
        let top = self.levels.len() - 1;
        let low = (level as usize).min(top);
        let fine = self.levels[low].bilinear(uv, self.repeat);
        let t = level - low as f32;
        if low == top || t < 1e-3 {
            return fine;
        }
        let coarse = self.levels[low + 1].bilinear(uv, self.repeat);
        std::array::from_fn(|k| fine[k] + t * (coarse[k] - fine[k]))
    }
}

/// Most samples along the longer axis of a pixel's footprint in the texture.
pub const MAX_TAPS: f32 = 4.0;

impl Level {
    fn bilinear(&self, uv: [f32; 2], repeat: bool) -> [f32; 3] {
        let x = uv[0] * self.width as f32 - 0.5;
        let y = (1.0 - uv[1]) * self.height as f32 - 0.5;
        let (x_floor, y_floor) = (floor(x), floor(y));
        let (tx, ty) = (x - x_floor as f32, y - y_floor as f32);
        let column = |i: i32| bring_inside(i, self.width as i32, repeat);
        let row = |i: i32| bring_inside(i, self.height as i32, repeat) * self.width as usize;
        let (x0, x1) = (column(x_floor), column(x_floor.saturating_add(1)));
        let (y0, y1) = (row(y_floor), row(y_floor.saturating_add(1)));
        let (a, b, c, d) = (self.data[y0 + x0], self.data[y0 + x1], self.data[y1 + x0], self.data[y1 + x1]);
        let (wa, wb, wc, wd) = ((1.0 - tx) * (1.0 - ty), tx * (1.0 - ty), (1.0 - tx) * ty, tx * ty);
        std::array::from_fn(|k| {
            (wa * f32::from(a[k]) + wb * f32::from(b[k]) + wc * f32::from(c[k]) + wd * f32::from(d[k])) / 255.0
        })
    }
}

/// The whole number at or below; the standard function is a call into libm on plain x86-64.
fn floor(value: f32) -> i32 {
    let towards_zero = value as i32;
    towards_zero.saturating_sub(i32::from((towards_zero as f32) > value))
}

fn bring_inside(i: i32, size: i32, repeat: bool) -> usize {
    if repeat { i.rem_euclid(size) as usize } else { i.clamp(0, size - 1) as usize }
}

impl Weighted {
    fn base(image: &RgbImage, texcoords: &[[f32; 2]], triangles: &[[u32; 3]], repeat: bool) -> Self {
        let (width, height) = (image.width().max(1) as usize, image.height().max(1) as usize);
        let mut colour: Vec<[f32; 3]> = image.pixels().map(|p| p.0.map(f32::from)).collect();
        colour.resize(width * height, [0.0; 3]);
        let mut level = Self { width, height, colour, weight: vec![f32::from(u8::from(repeat)); width * height] };
        if !repeat {
            triangles.iter().for_each(|t| level.cover(t.map(|i| texcoords[i as usize])));
        }
        level
    }

    /// Marks the texels whose centre lies in a triangle or within half a texel of its edges' lines.
    fn cover(&mut self, uv: [[f32; 2]; 3]) {
        let p = uv.map(|c| [c[0] * self.width as f32 - 0.5, (1.0 - c[1]) * self.height as f32 - 0.5]);
        let bounds = |k: usize, size: usize| {
            let (low, high) = p.iter().fold((f32::MAX, f32::MIN), |(l, h), c| (l.min(c[k]), h.max(c[k])));
            ((low - 0.5).ceil().max(0.0) as usize, ((high + 0.5).floor() as i64).clamp(-1, size as i64 - 1) + 1)
        };
        let ((x0, x1), (y0, y1)) = (bounds(0, self.width), bounds(1, self.height));
        let area = (p[1][0] - p[0][0]) * (p[2][1] - p[0][1]) - (p[1][1] - p[0][1]) * (p[2][0] - p[0][0]);
        let sign = if area < 0.0 { -1.0 } else { 1.0 };
        let edges = [(0, 1), (1, 2), (2, 0)].map(|(i, j)| {
            let (dx, dy) = (p[j][0] - p[i][0], p[j][1] - p[i][1]);
            (p[i], sign * dx, sign * dy, -0.5 * (dx.abs() + dy.abs()))
        });
        for y in y0..y1.max(0) as usize {
            for x in x0..x1.max(0) as usize {
                let inside = |&(o, dx, dy, slack): &([f32; 2], f32, f32, f32)| {
                    dx * (y as f32 - o[1]) - dy * (x as f32 - o[0]) >= slack
                };
                if edges.iter().all(inside) {
                    self.weight[y * self.width + x] = 1.0;
                }
            }
        }
    }

    fn halved(&self) -> Self {
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let (mut colour, mut weight) = (vec![[0.0_f32; 3]; width * height], vec![0.0_f32; width * height]);
        for y in 0..height {
            for x in 0..width {
                let (sum, total) = self.block(x, y, width, height);
                if total > 0.0 {
                    colour[y * width + x] = sum.map(|c| c / total);
                    weight[y * width + x] = (total / 4.0).min(1.0);
                }
            }
        }
        Self { width, height, colour, weight }
    }

    /// Weighted sum over the texels of this level under texel (x, y) of the next.
    fn block(&self, x: usize, y: usize, width: usize, height: usize) -> ([f32; 3], f32) {
        let end = |i: usize, of: usize, size: usize| if i + 1 == of { size } else { 2 * i + 2 };
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for row in 2 * y..end(y, height, self.height) {
            for i in row * self.width + 2 * x..row * self.width + end(x, width, self.width) {
                (0..3).for_each(|k| sum[k] += self.weight[i] * self.colour[i][k]);
                total += self.weight[i];
            }
        }
        (sum, total)
    }

    /// Fills what no triangle covers with the colour of the coarser level.
    fn fill_from(&mut self, coarse: &Self) {
        for y in 0..self.height {
            for x in 0..self.width {
                let i = y * self.width + x;
                if self.weight[i] == 0.0 {
                    self.colour[i] =
                        coarse.colour[(y / 2).min(coarse.height - 1) * coarse.width + (x / 2).min(coarse.width - 1)];
                }
            }
        }
    }

    fn quantised(&self) -> Level {
        let texel = |c: &[f32; 3]| {
            let [r, g, b] = c.map(|v| (v + 0.5).clamp(0.0, 255.0) as u8);
            [r, g, b, 255]
        };
        Level { width: self.width as u32, height: self.height as u32, data: self.colour.iter().map(texel).collect() }
    }
}
