//! Between the network's planes and the message's pairs.

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
    fn planes_become_pairs() {
        let mut pairs = [0.0; 8];
        interleave(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0], 2, &mut pairs);
        assert_eq!(pairs, [1.0, 5.0, 2.0, 6.0, 3.0, 7.0, 4.0, 8.0]);
    }
}
