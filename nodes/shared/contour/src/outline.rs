//! Outlines of a mask: closed curves along the borders between pixels.

/// Border pieces at the object's side of which a pixel lies: right, down, left, up.
const SIDES: [(i32, i32); 4] = [(1, 0), (0, 1), (-1, 0), (0, -1)];

/// One piece of a border.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Border {
    /// The pixel of the object.
    pub(crate) pixel: (i32, i32),
    /// Which of its sides, as in `SIDES`.
    side: usize,
}

impl Border {
    /// Its middle, pixels.
    pub(crate) fn middle(&self) -> [f32; 2] {
        let (dx, dy) = SIDES[self.side];
        [self.pixel.0 as f32 + 0.5 * dx as f32, self.pixel.1 as f32 + 0.5 * dy as f32]
    }
}

/// A mask that can be asked beyond its edges.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Mask<'a> {
    pub(crate) inside: &'a [u8],
    pub(crate) size_px: i32,
}

impl Mask<'_> {
    pub(crate) fn is_inside(&self, x: i32, y: i32) -> bool {
        let within = x >= 0 && y >= 0 && x < self.size_px && y < self.size_px;
        within && self.inside[(y * self.size_px + x) as usize] != 0
    }

    fn has_border(&self, (x, y): (i32, i32), side: usize) -> bool {
        let (dx, dy) = SIDES[side];
        self.is_inside(x, y) && !self.is_inside(x + dx, y + dy)
    }

    /// The piece after `at`, going round the object with it on the right hand (clockwise in an image whose y points down).
    fn next(&self, at: Border) -> Border {
        let (dx, dy) = SIDES[at.side];
        let turned = (at.side + 1) % 4;
        let (fx, fy) = SIDES[turned];
        let (x, y) = at.pixel;
        if self.is_inside(x + fx + dx, y + fy + dy) && self.is_inside(x + fx, y + fy) {
            // Concave corner: the pixel diagonally ahead is the object's.
            return Border { pixel: (x + fx + dx, y + fy + dy), side: (at.side + 3) % 4 };
        }
        match self.is_inside(x + fx, y + fy) {
            true => Border { pixel: (x + fx, y + fy), side: at.side },
            false => Border { pixel: (x, y), side: turned },
        }
    }

    /// All outlines, outer ones and those of holes.
    pub(crate) fn outlines(&self) -> Vec<Vec<Border>> {
        let mut seen = vec![0_u8; self.inside.len()];
        let mut outlines = Vec::new();
        for y in 0..self.size_px {
            for x in 0..self.size_px {
                // Every closed curve has a piece on the left of some pixel.
                let start = Border { pixel: (x, y), side: 2 };
                if self.has_border(start.pixel, 2) && seen[(y * self.size_px + x) as usize] & 4 == 0 {
                    outlines.push(self.follow(start, &mut seen));
                }
            }
        }
        outlines
    }

    fn follow(&self, start: Border, seen: &mut [u8]) -> Vec<Border> {
        let mut outline = Vec::new();
        let mut at = start;
        loop {
            seen[(at.pixel.1 * self.size_px + at.pixel.0) as usize] |= 1 << at.side;
            outline.push(at);
            at = self.next(at);
            if at == start {
                return outline;
            }
        }
    }
}

/// A closed curve, smoothed.
#[derive(Debug, Clone)]
pub(crate) struct Curve {
    /// Points, pixels.
    pub(crate) points: Vec<[f32; 2]>,
    /// Unit vectors away from the object.
    pub(crate) normals: Vec<[f32; 2]>,
}

/// Half the pieces that a point of the curve is averaged over.
const REACH: i32 = 4;

/// The middles of the pieces, averaged over their neighbours with binomial-like weights: steps of whole pixels become the line
/// that they stand for.
pub(crate) fn smooth(outline: &[Border]) -> Curve {
    let n = outline.len() as i32;
    let middles: Vec<[f32; 2]> = outline.iter().map(Border::middle).collect();
    let at = |i: i32| middles[i.rem_euclid(n) as usize];
    let weight = |k: i32| (-0.5 * (k as f32 / 2.0).powi(2)).exp();
    let total: f32 = (-REACH..=REACH).map(weight).sum();
    let mean = |i: i32, axis: usize| (-REACH..=REACH).map(|k| weight(k) * at(i + k)[axis]).sum::<f32>() / total;
    let points: Vec<[f32; 2]> = (0..n).map(|i| [mean(i, 0), mean(i, 1)]).collect();
    let normals = (0..n).map(|i| {
        let (a, b) = (points[(i - 3).rem_euclid(n) as usize], points[(i + 3).rem_euclid(n) as usize]);
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let length = (dx * dx + dy * dy).sqrt().max(1e-6);
        // With the object on the right of the way, the left is outside.
        [dy / length, -dx / length]
    });
    let normals = normals.collect();
    Curve { points, normals }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn disc(size_px: i32, radius: f32, hole: f32) -> Vec<u8> {
        let middle = (size_px - 1) as f32 / 2.0;
        let place = |i: i32| ((i % size_px) as f32 - middle, (i / size_px) as f32 - middle);
        let radius_of = |i: i32| place(i).0.hypot(place(i).1);
        (0..size_px * size_px).map(|i| u8::from(radius_of(i) <= radius && radius_of(i) >= hole)).collect()
    }

    #[test]
    fn the_outline_of_a_disc_is_its_circle() {
        let inside = disc(120, 50.0, 20.0);
        let outlines = Mask { inside: &inside, size_px: 120 }.outlines();
        assert_eq!(outlines.len(), 2, "outside and hole");
        for (outline, (radius, sign)) in outlines.iter().zip([(50.0, 1.0), (20.0, -1.0)]) {
            let curve = smooth(outline);
            let radii = curve.points.iter().map(|p| (p[0] - 59.5).hypot(p[1] - 59.5));
            let mean = radii.clone().sum::<f32>() / outline.len() as f32;
            assert!((mean - radius).abs() < 0.15, "{mean} {radius}");
            assert!(radii.clone().all(|r| (r - radius).abs() < 0.6));
            for (p, n) in curve.points.iter().zip(&curve.normals) {
                let outwards = (n[0] * (p[0] - 59.5) + n[1] * (p[1] - 59.5)) / radius;
                assert!(sign * outwards > 0.95, "{p:?} {n:?}");
            }
        }
    }

    #[test]
    fn pixels_that_touch_at_a_corner_are_two_outlines_or_one_but_every_piece_counts_once() {
        let mut inside = vec![0; 36];
        (inside[7], inside[14]) = (1, 1);
        let outlines = Mask { inside: &inside, size_px: 6 }.outlines();
        assert_eq!(outlines.iter().map(Vec::len).sum::<usize>(), 8);
    }
}
