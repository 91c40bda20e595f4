//! Y'CbCr to R'G'B' by ITU-R BT.601 with Y' from 16 to 235 and Cb, Cr from 16 to 240, in fixed point of 20 bits.

/// Which byte of four is which.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Order {
    /// U, Y, V, Y.
    Uyvy,
    /// Y, U, Y, V.
    Yuyv,
}

const BITS: i32 = 20;
/// 255/219, and the factors of Cr in R, Cb and Cr in G, Cb in B, times 2^20 (BT.601: 255/224 times 1.402, 0.344136,
/// 0.714136, 1.772).
const LUMA: i32 = 1_220_945;
const CR_RED: i32 = 1_673_555;
const CB_GREEN: i32 = 410_792;
const CR_GREEN: i32 = 852_458;
const CB_BLUE: i32 = 2_115_221;

fn pixel(y: u8, u: u8, v: u8) -> [u8; 3] {
    let (y, u, v) = (LUMA * (i32::from(y) - 16).max(0), i32::from(u) - 128, i32::from(v) - 128);
    let half = 1 << (BITS - 1);
    let value = |sum: i32| ((sum + half) >> BITS).clamp(0, 255) as u8;
    [value(y + CR_RED * v), value(y - CB_GREEN * u - CR_GREEN * v), value(y + CB_BLUE * u)]
}

/// A row of pairs.
pub(super) fn packed(row: &[u8], order: Order, rgb: &mut Vec<u8>) {
    for four in row.as_chunks::<4>().0 {
        let [u, first, v, second] = match order {
            Order::Uyvy => *four,
            Order::Yuyv => [four[1], four[0], four[3], four[2]],
        };
        rgb.extend(pixel(first, u, v));
        rgb.extend(pixel(second, u, v));
    }
}

/// A plane of Y, and behind it one of pairs for each 2 x 2 pixels.
pub(super) fn planes(data: &[u8], width: usize, height: usize, step: usize, u_first: bool, rgb: &mut Vec<u8>) {
    let (luma, colours) = data.split_at(step * height);
    for y in 0..height {
        let row = &luma[y * step..][..width];
        let pairs = &colours[y / 2 * step..][..width];
        for (two, pair) in row.as_chunks::<2>().0.iter().zip(pairs.as_chunks::<2>().0) {
            let (u, v) = if u_first { (pair[0], pair[1]) } else { (pair[1], pair[0]) };
            two.iter().for_each(|y| rgb.extend(pixel(*y, u, v)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grey_is_grey_and_primaries_are_themselves() {
        assert_eq!(pixel(16, 128, 128), [0; 3]);
        assert_eq!(pixel(235, 128, 128), [255; 3]);
        let red = pixel(81, 90, 240);
        assert!(red[0] >= 253 && red[1] <= 2 && red[2] <= 2, "{red:?}");
    }

    #[test]
    fn all_orders_mean_the_same() {
        let (mut uyvy, mut yuyv, mut nv12, mut nv21) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        packed(&[90, 50, 200, 60], Order::Uyvy, &mut uyvy);
        packed(&[50, 90, 60, 200], Order::Yuyv, &mut yuyv);
        planes(&[50, 60, 50, 60, 90, 200], 2, 2, 2, true, &mut nv12);
        planes(&[50, 60, 50, 60, 200, 90], 2, 2, 2, false, &mut nv21);
        assert_eq!((&uyvy, &nv12), (&yuyv, &nv21));
        assert_eq!(nv12, [uyvy.clone(), uyvy].concat());
    }
}
