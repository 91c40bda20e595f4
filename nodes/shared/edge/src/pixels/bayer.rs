//! Bayer mosaics by bilinear interpolation: a colour that a pixel lacks is the mean of its neighbours that have it. Beyond the
//! border the mosaic goes on as its mirror image, which keeps the pattern.

/// Where the red pixels of a mosaic are: column and row of the first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Pattern {
    red: (usize, usize),
}

impl Pattern {
    /// The pattern of the first two pixels of the first row, then of the second: `rggb`, `bggr`, `gbrg`, `grbg`.
    pub(super) fn named(name: &str) -> Option<Self> {
        let red = match name {
            "rggb" => (0, 0),
            "bggr" => (1, 1),
            "gbrg" => (0, 1),
            "grbg" => (1, 0),
            _ => return None,
        };
        Some(Self { red })
    }
}

pub(super) fn demosaic(plane: &[u8], width: usize, height: usize, pattern: Pattern, rgb: &mut Vec<u8>) {
    // Mirrored about the border's pixel: -1 is 1.
    let mirror = |i: usize, step: isize, size: usize| match i as isize + step {
        -1 => 1,
        beyond if beyond == size as isize => size - 2,
        inside => inside as usize,
    };
    for y in 0..height {
        let rows = [-1, 0, 1].map(|step| &plane[mirror(y, step, height) * width..][..width]);
        for x in 0..width {
            let columns = [-1, 0, 1].map(|step| mirror(x, step, width));
            let at = |row: usize, column: usize| u32::from(rows[row][columns[column]]);
            let own = at(1, 1);
            let beside = (at(1, 0) + at(1, 2)).div_ceil(2);
            let above = (at(0, 1) + at(2, 1)).div_ceil(2);
            let cross = (at(1, 0) + at(1, 2) + at(0, 1) + at(2, 1) + 2) / 4;
            let corners = (at(0, 0) + at(0, 2) + at(2, 0) + at(2, 2) + 2) / 4;
            let pixel = match ((x + pattern.red.0).is_multiple_of(2), (y + pattern.red.1).is_multiple_of(2)) {
                (true, true) => [own, cross, corners],
                (false, false) => [corners, cross, own],
                (false, true) => [beside, own, above],
                (true, false) => [above, own, beside],
            };
            rgb.extend(pixel.map(|value| value as u8));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A plain colour as a mosaic comes back as that colour, whatever the pattern.
    #[test]
    fn plain_colours_come_back() {
        let colour = [200, 90, 30];
        for (name, order) in
            [("rggb", [0, 1, 1, 2]), ("bggr", [2, 1, 1, 0]), ("gbrg", [1, 2, 0, 1]), ("grbg", [1, 0, 2, 1])]
        {
            let plane: Vec<u8> = (0..5 * 4).map(|i| colour[order[i / 5 % 2 * 2 + i % 5 % 2]]).collect();
            let mut rgb = Vec::new();
            demosaic(&plane, 5, 4, Pattern::named(name).unwrap(), &mut rgb);
            assert!(rgb.chunks_exact(3).all(|pixel| pixel == colour), "{name}: {rgb:?}");
        }
    }
}
