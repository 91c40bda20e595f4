//! Between images (interleaved bytes) and the network's planes.

use rayon::prelude::*;

/// `n` RGB images, `S x S x 3` bytes each, to `n x 3 x S x S` in `[-1, 1]`, as RAFT's authors scale them:
/// `2 v / 255 - 1`.
///
/// # Panics
/// When `planes` is not three times as long as there are pixels in `rgb`.
pub fn normalise(rgb: &[u8], size_px: usize, planes: &mut [f32]) {
    assert_eq!(rgb.len(), planes.len(), "three planes for three channels");
    let area = size_px * size_px;
    planes.par_chunks_exact_mut(3 * area).zip(rgb.par_chunks_exact(3 * area)).for_each(|(planes, rgb)| {
        for (channel, plane) in planes.chunks_exact_mut(area).enumerate() {
            for (value, pixel) in plane.iter_mut().zip(rgb.chunks_exact(3)) {
                *value = f32::from(pixel[channel]) * (2.0 / 255.0) - 1.0;
            }
        }
    });
}

/// `n x 2 x S x S` planes of dx and dy to `n x S x S x 2` pairs.
///
/// # Panics
/// When the lengths differ.
pub fn interleave(planes: &[f32], size_px: usize, pairs: &mut [f32]) {
    assert_eq!(planes.len(), pairs.len(), "as many pairs as plane values");
    let area = size_px * size_px;
    for (planes, pairs) in planes.chunks_exact(2 * area).zip(pairs.chunks_exact_mut(2 * area)) {
        let (dx, dy) = planes.split_at(area);
        for ((pair, dx), dy) in pairs.chunks_exact_mut(2).zip(dx).zip(dy) {
            pair.copy_from_slice(&[*dx, *dy]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_become_planes() {
        let mut planes = [9.0; 12];
        normalise(&[0, 255, 51, 0, 255, 51, 0, 255, 51, 0, 255, 51], 2, &mut planes);
        assert_eq!(planes[0..4], [-1.0; 4]);
        assert_eq!(planes[4..8], [1.0; 4]);
        assert!((planes[8] + 0.6).abs() < 1e-6);
    }

    #[test]
    fn planes_become_pairs() {
        let mut pairs = [0.0; 8];
        interleave(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0], 2, &mut pairs);
        assert_eq!(pairs, [1.0, 5.0, 2.0, 6.0, 3.0, 7.0, 4.0, 8.0]);
    }
}
