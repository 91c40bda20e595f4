use rayon::prelude::*;

/// Images of `area` pixels (interleaved RGB bytes) to three planes each in `[-1, 1]`, as RAFT's authors scale them:
/// `2 v / 255 - 1`.
///
/// ```
/// use pseudoflow_inference::normalise;
///
/// let mut planes = [0.0; 6]; // red, green, blue of two pixels
/// normalise(&[255, 0, 0, 255, 0, 255], 2, &mut planes);
/// assert_eq!(planes, [1.0, 1.0, -1.0, -1.0, -1.0, 1.0]);
/// ```
/// # Panics
/// When `planes` is not three times as long as there are pixels in `rgb`.
pub fn normalise(rgb: &[u8], area: usize, planes: &mut [f32]) {
    assert_eq!(rgb.len(), planes.len(), "three planes for three channels");
    planes.par_chunks_exact_mut(3 * area).zip(rgb.par_chunks_exact(3 * area)).for_each(|(planes, rgb)| {
        for (channel, plane) in planes.chunks_exact_mut(area).enumerate() {
            for (value, pixel) in plane.iter_mut().zip(rgb.chunks_exact(3)) {
                *value = f32::from(pixel[channel]) * (2.0 / 255.0) - 1.0;
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_become_planes() {
        let mut planes = [9.0; 12];
        normalise(&[0, 255, 51, 0, 255, 51, 0, 255, 51, 0, 255, 51], 4, &mut planes);
        assert_eq!(planes[0..4], [-1.0; 4]);
        assert_eq!(planes[4..8], [1.0; 4]);
        assert!((planes[8] + 0.6).abs() < 1e-6);
    }
}
