//! RAFT's correlation lookup: bilinear windows of the correlation pyramid (Teed and Deng, ECCV 2020, section 3.2).

use super::{Array, BackwardCall, Kernel, View};
use rayon::prelude::*;

/// Samples, for each pixel p of the first image and each level l, the window of (2 r + 1)^2 whole offsets around
/// `coords(p) / 2^l`, bilinearly, with zeros outside.
///
/// Inputs: the pyramid (N, P, Q) where row p holds the flattened correlation maps of all levels, and the
/// coordinates (N, 2, h, w) in pixels of level 0 with P = h w, which get no gradient (RAFT detaches them).
/// Output: (N, L (2 r + 1)^2, h, w). In each level's block the *first* window index moves x, the second y, as in the
/// authors' code: their trained weights expect it.
#[derive(Debug, Clone)]
pub(crate) struct Lookup {
    /// Window radius r, px of the level.
    pub(crate) radius: usize,
    /// Height and width of each level.
    pub(crate) levels: Vec<[usize; 2]>,
}

/// Where a window lies in its level: whole part and fraction of the corner at offset (-r, -r).
#[derive(Clone, Copy)]
struct Corner {
    x: i64,
    y: i64,
    fx: f32,
    fy: f32,
}

impl Lookup {
    /// Channels of the output.
    pub(crate) fn channels(&self) -> usize {
        let side = 2 * self.radius + 1;
        self.levels.len() * side * side
    }

    fn corner(&self, x: f32, y: f32, level: usize) -> Corner {
        let scale = 1.0 / (1_u32 << level) as f32;
        let (x, y) = (x * scale, y * scale);
        let (floor_x, floor_y) = (x.floor(), y.floor());
        // Far outside is outside: the clamp keeps the integer arithmetic safe.
        let whole = |v: f32| v.clamp(-1e6, 1e6) as i64 - self.radius as i64;
        Corner { x: whole(floor_x), y: whole(floor_y), fx: x - floor_x, fy: y - floor_y }
    }

    /// Copies the (2 r + 2)^2 texels at a corner into `patch`, row-major, zeros outside.
    fn gather(&self, map: &[f32], [h, w]: [usize; 2], corner: Corner, patch: &mut [f32]) {
        let side = 2 * self.radius + 2;
        patch.fill(0.0);
        self.overlap([h, w], corner, |row, first, start, count| {
            patch[row * side + first..][..count].copy_from_slice(&map[start..start + count]);
        });
    }

    /// Adds a patch back: the transpose of [`Self::gather`].
    fn scatter(&self, map: &mut [f32], size: [usize; 2], corner: Corner, patch: &[f32]) {
        let side = 2 * self.radius + 2;
        self.overlap(size, corner, |row, first, start, count| {
            let source = &patch[row * side + first..][..count];
            map[start..start + count].iter_mut().zip(source).for_each(|(m, v)| *m += v);
        });
    }

    /// Calls `f(patch_row, first_patch_column, map_index, count)` for each patch row that meets the map.
    fn overlap(&self, [h, w]: [usize; 2], corner: Corner, mut f: impl FnMut(usize, usize, usize, usize)) {
        let side = 2 * self.radius as i64 + 2;
        let first = (-corner.x).clamp(0, side);
        let end = (w as i64 - corner.x).clamp(first, side);
        for row in 0..side {
            let y = corner.y + row;
            if end > first && (0..h as i64).contains(&y) {
                let start = y as usize * w + (corner.x + first) as usize;
                f(row as usize, first as usize, start, (end - first) as usize);
            }
        }
    }

    /// The four bilinear weights as (dy, dx, weight).
    fn taps(corner: Corner) -> [(usize, usize, f32); 4] {
        let Corner { fx, fy, .. } = corner;
        [(0, 0, (1.0 - fy) * (1.0 - fx)), (0, 1, (1.0 - fy) * fx), (1, 0, fy * (1.0 - fx)), (1, 1, fy * fx)]
    }

    /// Calls `f(level, offset of the level in a pyramid row, corner)` for each level at one pixel.
    fn each_level(&self, x: f32, y: f32, mut f: impl FnMut(usize, usize, Corner)) {
        let mut offset = 0;
        for (level, [h, w]) in self.levels.iter().enumerate() {
            f(level, offset, self.corner(x, y, level));
            offset += h * w;
        }
    }

    fn forward_image(&self, pyramid: &[f32], coords: &[f32], out: &mut [f32]) {
        let pixels = coords.len() / 2;
        let q = pyramid.len() / pixels;
        let (side, window) = (2 * self.radius + 2, 2 * self.radius + 1);
        let mut patch = vec![0.0; side * side];
        for p in 0..pixels {
            let row = &pyramid[p * q..][..q];
            self.each_level(coords[p], coords[pixels + p], |level, offset, corner| {
                self.gather(&row[offset..], self.levels[level], corner, &mut patch);
                let [t00, t01, t10, t11] = Self::taps(corner).map(|t| t.2);
                for i in 0..window {
                    for j in 0..window {
                        let at = j * side + i;
                        let value =
                            t00 * patch[at] + t01 * patch[at + 1] + t10 * patch[at + side] + t11 * patch[at + side + 1];
                        out[((level * window + i) * window + j) * pixels + p] = value;
                    }
                }
            });
        }
    }

    fn backward_image(&self, grad: &[f32], coords: &[f32], dpyramid: &mut [f32]) {
        let pixels = coords.len() / 2;
        let q = dpyramid.len() / pixels;
        let (side, window) = (2 * self.radius + 2, 2 * self.radius + 1);
        let mut patch = vec![0.0; side * side];
        for (p, row) in dpyramid.chunks_exact_mut(q).enumerate() {
            self.each_level(coords[p], coords[pixels + p], |level, offset, corner| {
                patch.fill(0.0);
                let [t00, t01, t10, t11] = Self::taps(corner).map(|t| t.2);
                for i in 0..window {
                    for j in 0..window {
                        let g = grad[((level * window + i) * window + j) * pixels + p];
                        let at = j * side + i;
                        patch[at] += t00 * g;
                        patch[at + 1] += t01 * g;
                        patch[at + side] += t10 * g;
                        patch[at + side + 1] += t11 * g;
                    }
                }
                self.scatter(&mut row[offset..], self.levels[level], corner, &patch);
            });
        }
    }
}

impl Kernel for Lookup {
    fn forward(&self, inputs: &[View<'_>], _keep: bool) -> (Array, Vec<f32>) {
        let [pyramid, coords] = [inputs[0], inputs[1]];
        let [n, _, h, w] = coords.nchw();
        let row: usize = self.levels.iter().map(|[h, w]| h * w).sum();
        assert_eq!(pyramid.shape, [n, h * w, row], "shape of the correlation pyramid");
        let mut out = Array::zeros(&[n, self.channels(), h, w]);
        out.data
            .par_chunks_mut(self.channels() * h * w)
            .zip(pyramid.data.par_chunks(h * w * row))
            .zip(coords.data.par_chunks(2 * h * w))
            .for_each(|((out, pyramid), coords)| self.forward_image(pyramid, coords, out));
        (out, Vec::new())
    }

    fn backward(&self, call: &BackwardCall<'_>) -> Vec<Option<Array>> {
        let [pyramid, coords] = [call.inputs[0], call.inputs[1]];
        let [n, _, h, w] = coords.nchw();
        let mut dpyramid = Array::zeros(pyramid.shape);
        dpyramid
            .data
            .par_chunks_mut(pyramid.data.len() / n)
            .zip(coords.data.par_chunks(2 * h * w))
            .zip(call.grad.par_chunks(self.channels() * h * w))
            .for_each(|((d, coords), grad)| self.backward_image(grad, coords, d));
        vec![Some(dpyramid), None]
    }
}
