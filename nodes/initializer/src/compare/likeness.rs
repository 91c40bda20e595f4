//! How well the features of a view fit those of a crop: what a search spends its time on.

use super::views::{View, summit};
use pulp::{Arch, Simd, WithSimd};

/// Largest shift that is tried, cells.
const SHIFT: i32 = 2;
/// Shifts along each axis.
const ACROSS: usize = 2 * SHIFT as usize + 1;
/// Products that are summed side by side, whatever the processor: two of the widest registers, and the same bits everywhere.
const LANES: usize = 32;

impl View {
    /// Mean cosine with the features of a crop (across^2 x channels) at the best of the whole shifts, and where the best shift
    /// lies between them, cells.
    pub(super) fn similarity(&self, crop: &[f32]) -> (f32, [f64; 2]) {
        let all = self.at_shifts(crop, ALL);
        let best = (0..all.len()).max_by(|a, b| all[*a].total_cmp(&all[*b]).then(b.cmp(a))).unwrap_or(0);
        let at = [best % ACROSS, best / ACROSS];
        let between = |k: usize| {
            let inside = (1..ACROSS - 1).contains(&at[k]);
            let step = [1, ACROSS][k];
            let away = if inside { summit([all[best - step], all[best], all[best + step]]) } else { 0.0 };
            at[k] as f64 - f64::from(SHIFT) + away
        };
        (all[best], [between(0), between(1)])
    }

    /// About the same for a tenth of the work, from every fourth cell at every second shift.
    pub(super) fn rough_similarity(&self, crop: &[f32]) -> f32 {
        self.at_shifts(crop, ROUGH).into_iter().fold(f32::NEG_INFINITY, f32::max)
    }

    /// Mean cosines at the shifts, row by row.
    fn at_shifts(&self, crop: &[f32], every: Every) -> [f32; ACROSS * ACROSS] {
        Arch::new().dispatch(AtShifts { view: self, crop, every })
    }
}

/// What is compared: every so many cells, and every so many shifts along each axis.
#[derive(Debug, Clone, Copy)]
struct Every {
    cells: usize,
    shifts: usize,
}

const ALL: Every = Every { cells: 1, shifts: 1 };
const ROUGH: Every = Every { cells: 4, shifts: 2 };

struct AtShifts<'a> {
    view: &'a View,
    crop: &'a [f32],
    every: Every,
}

impl WithSimd for AtShifts<'_> {
    type Output = [f32; ACROSS * ACROSS];

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        let mut out = [f32::NEG_INFINITY; ACROSS * ACROSS];
        for j in (0..ACROSS).step_by(self.every.shifts) {
            for i in (0..ACROSS).step_by(self.every.shifts) {
                out[j * ACROSS + i] = self.at(i as i32 - SHIFT, j as i32 - SHIFT);
            }
        }
        out
    }
}

impl AtShifts<'_> {
    #[inline(always)]
    fn at(&self, right: i32, down: i32) -> f32 {
        let View { across, cells, features, .. } = self.view;
        let channels = (features.len() / cells.len().max(1)).max(1);
        let mut sums = [0.0_f32; LANES];
        for k in (0..cells.len()).step_by(self.every.cells) {
            let [x, y] = [cells[k][0] + right, cells[k][1] + down];
            if x >= 0 && y >= 0 && x < *across && y < *across {
                let at = (y * across + x) as usize * channels;
                add_products(&mut sums, &features[k * channels..][..channels], &self.crop[at..][..channels]);
            }
        }
        sums.iter().sum::<f32>() / cells.len().div_ceil(self.every.cells).max(1) as f32
    }
}

#[inline(always)]
fn add_products(sums: &mut [f32; LANES], a: &[f32], b: &[f32]) {
    let ((a, rest_a), (b, rest_b)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    for (a, b) in a.iter().zip(b) {
        for i in 0..LANES {
            sums[i] += a[i] * b[i];
        }
    }
    for (sum, (a, b)) in sums.iter_mut().zip(rest_a.iter().zip(rest_b)) {
        *sum += a * b;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector2};

    /// A view of a 12 x 12 picture of features, cut out two cells to the right and one down.
    #[test]
    fn a_view_is_found_where_it_was_cut_out() {
        let (across, channels) = (12, 40);
        let noise = |i: usize| {
            let mixed = (i as u32 + 1).wrapping_mul(2_654_435_761);
            let mixed = (mixed ^ (mixed >> 15)).wrapping_mul(2_246_822_519);
            (mixed ^ (mixed >> 13)) as f32 / u32::MAX as f32 - 0.5
        };
        let mut crop: Vec<f32> = (0..across * across * channels).map(noise).collect();
        for cell in crop.chunks_exact_mut(channels) {
            let length = cell.iter().map(|v| v * v).sum::<f32>().sqrt();
            cell.iter_mut().for_each(|v| *v /= length);
        }
        let cells: Vec<[i32; 2]> = (3..8).flat_map(|y| (3..9).map(move |x| [x, y])).collect();
        let cut = |right: i32, down: i32| {
            let at = |[x, y]: &[i32; 2]| ((y + down) as usize * across + (x + right) as usize) * channels;
            View {
                rotation: UnitQuaternion::identity(),
                shape: Vector2::new(1.0, 1.0),
                across: across as i32,
                features: cells.iter().flat_map(|c| &crop[at(c)..][..channels]).copied().collect(),
                cells: cells.clone(),
            }
        };
        let view = cut(2, 1);
        let (similarity, shift) = view.similarity(&crop);
        assert!((similarity - 1.0).abs() < 1e-4, "{similarity}");
        assert!((shift[0] - 2.0).abs() < 0.5 && (shift[1] - 1.0).abs() < 0.5, "{shift:?}");
        let elsewhere: Vec<f32> = crop.iter().rev().copied().collect();
        assert!(view.similarity(&elsewhere).0 < 0.5);
        assert!(view.rough_similarity(&crop) < 0.5, "one down lies between the rough shifts");
        assert!((cut(2, 0).rough_similarity(&crop) - 1.0).abs() < 1e-4);
    }
}
