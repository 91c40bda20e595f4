//! The mean of four pixels by weights of 1/256, in whole numbers: one pixel at a time, or four where the processor has AVX2.
//! Both give the same bits.

use super::Tap;

/// Samples all taps; behind the image, `source` goes on for a row and 8 bytes.
pub(super) fn sample(taps: &[Tap], source: &[u8], stride: usize, target: &mut [[u8; 3]]) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the line above found AVX2 on this machine.
        return unsafe { four::sample(taps, source, stride, target) };
    }
    one::sample(taps, source, stride, target);
}

/// Eight bytes: a pixel, the one on its right, and two bytes that say nothing.
#[inline(always)]
fn two_pixels(source: &[u8], at: usize) -> u64 {
    source[at..].first_chunk().map_or(0, |bytes| u64::from_le_bytes(*bytes))
}

mod one {
    use super::{Tap, two_pixels};

    pub(super) fn sample(taps: &[Tap], source: &[u8], stride: usize, target: &mut [[u8; 3]]) {
        for (pixel, tap) in target.iter_mut().zip(taps) {
            let row = |at: usize| {
                let bytes = two_pixels(source, at);
                blend(lanes(bytes), lanes(bytes >> 24), u64::from(tap.right))
            };
            let at = tap.offset as usize;
            let mixed = blend(row(at), row(at + stride), u64::from(tap.below));
            *pixel = [mixed as u8, (mixed >> 16) as u8, (mixed >> 32) as u8];
        }
    }

    /// Three bytes to three lanes of 16 bits.
    #[inline(always)]
    fn lanes(bytes: u64) -> u64 {
        (bytes & 0xff) | (bytes & 0xff00) << 8 | (bytes & 0xff_0000) << 16
    }

    /// (a (256 - w) + b w) / 256 in each lane, rounded.
    #[inline(always)]
    fn blend(a: u64, b: u64, weight: u64) -> u64 {
        ((a * (256 - weight) + b * weight + 0x0080_0080_0080) >> 8) & 0x00ff_00ff_00ff
    }

    #[cfg(test)]
    mod tests {
        use super::*;

        #[test]
        fn blends_are_exact_at_their_ends_and_do_not_overflow() {
            for (a, b) in [(255, 255), (255, 0), (0, 255), (17, 99)] {
                let packed = |v: u64| lanes(v | v << 8 | v << 16);
                assert_eq!(blend(packed(a), packed(b), 0), packed(a));
                assert_eq!(blend(packed(a), packed(b), 256), packed(b));
                assert_eq!(blend(packed(a), packed(b), 128) & 0xff, (a + b).div_ceil(2));
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod four {
    use super::{Tap, one, two_pixels};
    use std::arch::x86_64::*;

    /// `shuffle` of 16 bytes, for both halves of a register; a byte of -1 becomes 0.
    #[target_feature(enable = "avx2")]
    fn pattern(bytes: [i8; 16]) -> __m256i {
        let half = |i: usize| i64::from_le_bytes(std::array::from_fn(|k| bytes[8 * i + k] as u8));
        _mm256_set_epi64x(half(1), half(0), half(1), half(0))
    }

    #[target_feature(enable = "avx2")]
    pub(super) fn sample(taps: &[Tap], source: &[u8], stride: usize, target: &mut [[u8; 3]]) {
        let (blocks, rest) = taps.as_chunks::<4>();
        let (whole, end) = target.split_at_mut(4 * blocks.len());
        // Two pixels of eight bytes in each half: three channels of each as numbers of 16 bits, of the left and the right one.
        let left = pattern([0, -1, 1, -1, 2, -1, -1, -1, 8, -1, 9, -1, 10, -1, -1, -1]);
        let right = pattern([3, -1, 4, -1, 5, -1, -1, -1, 11, -1, 12, -1, 13, -1, -1, -1]);
        // A tap has 4 bytes of offset, 2 of `right`, 2 of `below`.
        let of_right = pattern([4, 5, 4, 5, 4, 5, 4, 5, 12, 13, 12, 13, 12, 13, 12, 13]);
        let of_below = pattern([6, 7, 6, 7, 6, 7, 6, 7, 14, 15, 14, 15, 14, 15, 14, 15]);
        let together = pattern([0, 2, 4, 8, 10, 12, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1]);
        for (block, pixels) in blocks.iter().zip(whole.as_chunks_mut::<4>().0) {
            let [a, b, c, d] = bytemuck::cast::<[Tap; 4], [i64; 4]>(*block);
            let tap = _mm256_set_epi64x(d, c, b, a);
            let (across, down) = (_mm256_shuffle_epi8(tap, of_right), _mm256_shuffle_epi8(tap, of_below));
            let row = |away: usize| {
                let [a, b, c, d] = block.map(|tap| two_pixels(source, tap.offset as usize + away) as i64);
                let bytes = _mm256_set_epi64x(d, c, b, a);
                blend(_mm256_shuffle_epi8(bytes, left), _mm256_shuffle_epi8(bytes, right), across)
            };
            let packed = _mm256_shuffle_epi8(blend(row(0), row(stride), down), together);
            let (low, high) = (_mm256_extract_epi64::<0>(packed), _mm256_extract_epi64::<2>(packed));
            let bytes: &mut [u8; 12] = bytemuck::cast_mut(pixels);
            bytes[..6].copy_from_slice(&low.to_le_bytes()[..6]);
            bytes[6..].copy_from_slice(&high.to_le_bytes()[..6]);
        }
        one::sample(rest, source, stride, end);
    }

    /// (a (256 - w) + b w) / 256 in each lane, rounded: at most 255 x 256 + 128, which 16 bits hold.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn blend(a: __m256i, b: __m256i, weight: __m256i) -> __m256i {
        let rest = _mm256_sub_epi16(_mm256_set1_epi16(256), weight);
        let sum = _mm256_add_epi16(_mm256_mullo_epi16(a, rest), _mm256_mullo_epi16(b, weight));
        _mm256_srli_epi16::<8>(_mm256_add_epi16(sum, _mm256_set1_epi16(128)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_at_a_time_are_the_same_to_the_bit() {
        let (width, height) = (31, 7);
        let source: Vec<u8> = (0..width * (height + 1) * 3 + 8).map(|i| (i * i * 37 % 256) as u8).collect();
        let tap = |i: usize| Tap {
            offset: (3 * (i * 53 % (width * height))) as u32,
            right: (i * 29 % 257) as u16,
            below: (i * 101 % 257) as u16,
        };
        let taps: Vec<Tap> = (0..203).map(tap).collect();
        let (mut fast, mut slow) = (vec![[0; 3]; taps.len()], vec![[1; 3]; taps.len()]);
        sample(&taps, &source, 3 * width, &mut fast);
        one::sample(&taps, &source, 3 * width, &mut slow);
        assert_eq!(fast, slow);
    }
}
