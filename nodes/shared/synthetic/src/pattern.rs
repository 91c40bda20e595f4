//! Procedural surfaces for tables, walls, clutter and occluders. A pattern is a colour (sRGB, 0 to 1) at each
//! point of a plane whose unit is about the size of the object.

use super::random::Draw;
use rand::Rng;

/// A procedural surface.
#[derive(Debug, Clone)]
pub(super) struct Pattern {
    kind: Kind,
    palette: [[f32; 3]; 4],
    /// Cells of the pattern per unit.
    frequency: f32,
    /// Rotation of the pattern in the plane: cosine and sine.
    turn: [f32; 2],
    /// Strength of the fine noise over everything.
    grain: f32,
    seed: u32,
}

#[derive(Debug, Clone, Copy)]
enum Kind {
    Plain,
    Gradient,
    Clouds { octaves: u32 },
    Stripes { warp: f32, sharp: bool },
    Tiles { joint: f32 },
    Checker,
    Cells,
    Print,
    Shapes,
}

impl Pattern {
    /// Draws a surface; `busy` excludes the plain ones.
    pub(super) fn draw(rng: &mut impl Rng, busy: bool) -> Self {
        let (saturation, base) = (rng.uniform32(0.1, 1.0), rng.uniform32(0.05, 0.95));
        let spread = rng.uniform32(0.05, 0.9);
        let palette = std::array::from_fn(|_| {
            let value = (base + spread * rng.uniform32(-1.0, 1.0)).clamp(0.02, 1.0);
            rng.colour(saturation, (value * 0.9, value))
        });
        let warp = rng.log_uniform32(0.05, 1.5);
        let kind = match rng.below(if busy { 6 } else { 10 }) {
            0 => Kind::Print,
            1 => Kind::Shapes,
            2 => Kind::Cells,
            3 => Kind::Tiles { joint: rng.uniform32(0.02, 0.15) },
            4 => Kind::Stripes { warp, sharp: rng.chance(0.4) },
            5 => Kind::Clouds { octaves: 5 },
            6 => Kind::Checker,
            7 => Kind::Gradient,
            8 => Kind::Clouds { octaves: 3 },
            _ => Kind::Plain,
        };
        let angle = rng.uniform32(0.0, std::f32::consts::TAU);
        let (frequency, grain) = (rng.log_uniform32(0.7, 12.0), 0.12 * rng.random::<f32>().powi(2));
        Self { kind, palette, frequency, turn: [angle.cos(), angle.sin()], grain, seed: rng.random() }
    }

    /// A surface the colour of skin, cloth or paper: one hue with soft variation.
    pub(super) fn soft(rng: &mut impl Rng, colour: [f32; 3]) -> Self {
        let palette = std::array::from_fn(|_| colour.map(|c| (c * rng.uniform32(0.85, 1.1)).min(1.0)));
        let seed = rng.random();
        Self { kind: Kind::Clouds { octaves: 3 }, palette, frequency: 3.0, turn: [1.0, 0.0], grain: 0.03, seed }
    }

    /// The colour at a point of the plane.
    pub(super) fn colour(&self, u: f32, v: f32) -> [f32; 3] {
        let (cos, sin) = (self.turn[0], self.turn[1]);
        let (x, y) = ((cos * u - sin * v) * self.frequency, (sin * u + cos * v) * self.frequency);
        let colour = self.pattern(x, y);
        if self.grain < 0.005 {
            return colour;
        }
        let grain = self.grain * (value_noise(x * 9.0, y * 9.0, self.seed ^ 0x51) - 0.5);
        colour.map(|c| (c + grain).clamp(0.0, 1.0))
    }

    fn pattern(&self, x: f32, y: f32) -> [f32; 3] {
        let seed = self.seed;
        match self.kind {
            Kind::Plain => self.palette[0],
            Kind::Gradient => self.blend(0.5 + 0.5 * (x * 0.3).sin()),
            Kind::Clouds { octaves } => self.blend(fractal_noise(x, y, seed, octaves)),
            Kind::Stripes { warp, sharp } => {
                let wave = (std::f32::consts::TAU * (x + warp * fractal_noise(x * 0.5, y * 0.15, seed, 3))).sin();
                let t = if sharp { (wave * 6.0).clamp(-1.0, 1.0) } else { wave };
                self.blend(0.5 + 0.5 * t)
            }
            Kind::Tiles { joint } => {
                let (fx, fy) = (x - x.whole(), y - y.whole());
                match fx.min(fy).min(1.0 - fx).min(1.0 - fy) < joint {
                    true => self.palette[3],
                    false => self.blend(cell_value(x, y, seed)),
                }
            }
            Kind::Checker => self.palette[((x.whole() + y.whole()) as i32 & 1) as usize],
            Kind::Cells => self.cells(x, y),
            Kind::Print => self.print(x, y),
            Kind::Shapes => self.shapes(x, y),
        }
    }

    /// Between the first three colours of the palette.
    fn blend(&self, t: f32) -> [f32; 3] {
        let t = t.clamp(0.0, 1.0) * 2.0;
        let (from, to) = if t < 1.0 { (0, 1) } else { (1, 2) };
        let t = t - from as f32;
        std::array::from_fn(|k| self.palette[from][k] + t * (self.palette[to][k] - self.palette[from][k]))
    }

    /// Worley cells: the colour of the nearest of one random point per cell.
    fn cells(&self, x: f32, y: f32) -> [f32; 3] {
        let (cx, cy) = (x.whole(), y.whole());
        let (mut best, mut value) = (f32::MAX, 0.0);
        for (i, j) in (-1..=1).flat_map(|i| (-1..=1).map(move |j| (i as f32, j as f32))) {
            let (px, py) = (cx + i, cy + j);
            let (h, g) = (cell_value(px, py, self.seed), cell_value(px, py, self.seed ^ 0x9e37));
            let distance = (px + h - x).powi(2) + (py + g - y).powi(2);
            if distance < best {
                (best, value) = (distance, cell_value(px, py, self.seed ^ 0x77));
            }
        }
        self.blend(value)
    }

    /// Lines of print: small dark cells on a light ground, words of random length.
    fn print(&self, x: f32, y: f32) -> [f32; 3] {
        let (sx, sy) = (x * 4.0, y * 2.0);
        let line = sy - sy.whole();
        let word = cell_value(sx * 0.22, sy, self.seed) > 0.3;
        let ink = word && (0.2..0.75).contains(&line) && cell_value(sx * 2.0, sy * 5.0, self.seed ^ 3) > 0.45;
        let paper = if cell_value(x * 0.25, y * 0.2, self.seed ^ 9) > 0.5 { 0 } else { 2 };
        self.palette[if ink { 1 } else { paper }]
    }

    /// Discs and bars of random size, one for each cell at most, three layers.
    fn shapes(&self, x: f32, y: f32) -> [f32; 3] {
        for (layer, scale) in [(1_u32, 0.9_f32), (2, 0.5), (3, 0.27)] {
            let (px, py) = (x * scale + 13.7 * layer as f32, y * scale);
            let h = |salt| cell_value(px, py, self.seed ^ (layer * 101 + salt));
            let (dx, dy) = (px - px.whole() - 0.3 - 0.4 * h(1), py - py.whole() - 0.3 - 0.4 * h(2));
            let size = 0.12 + 0.2 * h(3);
            let inside = if h(4) < 0.5 { dx * dx + dy * dy < size * size } else { dx.abs() < size && dy.abs() < 0.1 };
            if inside && h(5) < 0.8 {
                let tint = 0.6 + 0.8 * h(6);
                return self.palette[1 + (h(7) * 2.99) as usize].map(|c| (c * tint).min(1.0));
            }
        }
        self.palette[0]
    }
}

/// [`f32::floor`] for numbers that fit an i32; the standard function is a call into libm on plain x86-64.
trait Whole {
    fn whole(self) -> f32;
}

impl Whole for f32 {
    fn whole(self) -> f32 {
        let towards_zero = self as i32 as f32;
        towards_zero - f32::from(u8::from(towards_zero > self))
    }
}

fn hash(x: i32, y: i32, seed: u32) -> u32 {
    let mut h =
        (x as u32).wrapping_mul(0x9e37_79b1) ^ (y as u32).wrapping_mul(0x85eb_ca77) ^ seed.wrapping_mul(0xc2b2_ae3d);
    h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
    h ^ (h >> 15)
}

/// A random number in `[0, 1)` for each cell of the integer grid.
fn cell_value(x: f32, y: f32, seed: u32) -> f32 {
    (hash(x.whole() as i32, y.whole() as i32, seed) >> 8) as f32 / 16_777_216.0
}

/// Smooth noise in `[0, 1)`, one random value at each integer point.
pub(super) fn value_noise(x: f32, y: f32, seed: u32) -> f32 {
    let (x0, y0) = (x.whole(), y.whole());
    let (tx, ty) = (x - x0, y - y0);
    let (sx, sy) = (tx * tx * (3.0 - 2.0 * tx), ty * ty * (3.0 - 2.0 * ty));
    let (ix, iy) = (x0 as i32, y0 as i32);
    let at = |i: i32, j: i32| (hash(ix.wrapping_add(i), iy.wrapping_add(j), seed) >> 8) as f32 / 16_777_216.0;
    let top = at(0, 0) + sx * (at(1, 0) - at(0, 0));
    let bottom = at(0, 1) + sx * (at(1, 1) - at(0, 1));
    top + sy * (bottom - top)
}

/// Sum of octaves of [`value_noise`], stretched to fill about `[0, 1]`.
pub(super) fn fractal_noise(x: f32, y: f32, seed: u32, octaves: u32) -> f32 {
    let (mut sum, mut weight, mut total, mut scale) = (0.0, 1.0, 0.0, 1.0);
    for octave in 0..octaves {
        sum += weight * value_noise(x * scale, y * scale, seed.wrapping_add(octave));
        total += weight;
        weight *= 0.55;
        scale *= 2.03;
    }
    (0.5 + 1.4 * (sum / total - 0.5)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::super::random::stream;
    use super::*;

    #[test]
    fn every_pattern_stays_in_range_and_most_vary() {
        let mut varied = 0;
        for index in 0..200 {
            let pattern = Pattern::draw(&mut stream(1, index), index % 2 == 0);
            let colours: Vec<[f32; 3]> =
                (0..100).map(|i| pattern.colour(i as f32 * 0.13 - 4.0, i as f32 * 0.07)).collect();
            assert!(colours.iter().flatten().all(|c| (0.0..=1.0).contains(c)), "{pattern:?}");
            varied += usize::from(colours.iter().any(|c| *c != colours[0]));
        }
        assert!(varied > 150, "{varied}");
    }

    #[test]
    fn noise_is_continuous() {
        for i in 0..1000 {
            let x = i as f32 * 0.01 - 5.0;
            assert!((value_noise(x, 0.3, 7) - value_noise(x + 0.01, 0.3, 7)).abs() < 0.05);
        }
    }
}
