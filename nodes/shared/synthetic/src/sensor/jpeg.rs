//! What JPEG does to an image, without writing a file: ITU-T T.81's colour transform, 8 x 8 cosine transform and
//! quantisation with the tables of its Annex K, scaled by quality as libjpeg does.

use super::filter::LinearImage;

/// Luminance and chrominance quantisation at quality 50 (T.81, Annex K.1), row-major.
const LUMA: [u8; 64] = [
    16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55, 14, 13, 16, 24, 40, 57, 69, 56, 14, 17, 22, 29, 51,
    87, 80, 62, 18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113, 92, 49, 64, 78, 87, 103, 121, 120, 101,
    72, 92, 95, 98, 112, 100, 103, 99,
];
const CHROMA: [u8; 64] = [
    17, 18, 24, 47, 99, 99, 99, 99, 18, 21, 26, 66, 99, 99, 99, 99, 24, 26, 56, 99, 99, 99, 99, 99, 47, 66, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99,
];

/// Settings of a JPEG encoder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Jpeg {
    /// 1 to 100, as libjpeg counts.
    pub(crate) quality: u8,
    /// Whether colour has half the resolution (4:2:0), as cameras write it.
    pub(crate) subsampled: bool,
}

/// One plane of values around 0, a multiple of 8 wide and high.
struct Plane {
    width: usize,
    height: usize,
    data: Vec<f32>,
}

impl Jpeg {
    /// Encodes and decodes display values (0 to 1). Blocks start at the image's corner.
    pub(super) fn pass(&self, image: &mut LinearImage) {
        let (width, height) = (image.width.next_multiple_of(16), image.height.next_multiple_of(16));
        let mut planes: [Plane; 3] = std::array::from_fn(|_| Plane { width, height, data: vec![0.0; width * height] });
        for y in 0..height {
            let row = &image.data[3 * y.min(image.height - 1) * image.width..][..3 * image.width];
            let line = y * width..(y + 1) * width;
            let [luma, blue, red] = planes.each_mut().map(|p| &mut p.data[line.clone()]);
            for x in 0..width {
                let at = 3 * x.min(image.width - 1);
                let [r, g, b] = [row[at], row[at + 1], row[at + 2]].map(|c| 255.0 * c);
                luma[x] = 0.299 * r + 0.587 * g + 0.114 * b - 128.0;
                blue[x] = -0.168_736 * r - 0.331_264 * g + 0.5 * b;
                red[x] = 0.5 * r - 0.418_688 * g - 0.081_312 * b;
            }
        }
        planes[0].quantise(&self.table(&LUMA));
        let table = self.table(&CHROMA);
        for plane in &mut planes[1..] {
            if self.subsampled {
                let mut half = plane.halved();
                half.quantise(&table);
                plane.fill_doubled(&half);
            } else {
                plane.quantise(&table);
            }
        }
        for y in 0..image.height {
            let row = &mut image.data[3 * y * image.width..][..3 * image.width];
            let [luma, blue, red] = planes.each_ref().map(|p| &p.data[y * width..][..image.width]);
            for (x, pixel) in row.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                let (y, cb, cr) = (luma[x] + 128.0, blue[x], red[x]);
                *pixel = [y + 1.402 * cr, y - 0.344_136 * cb - 0.714_136 * cr, y + 1.772 * cb].map(|c| c / 255.0);
            }
        }
    }

    fn table(&self, base: &[u8; 64]) -> [f32; 64] {
        let quality = f32::from(self.quality.clamp(1, 100));
        let scale = if quality < 50.0 { 5000.0 / quality } else { 200.0 - 2.0 * quality };
        base.map(|v| ((f32::from(v) * scale + 50.0) / 100.0).floor().clamp(1.0, 255.0))
    }
}

/// `COSINES[k][n]`: the orthonormal 8-point DCT-II.
fn cosines() -> &'static [[f32; 8]; 8] {
    static TABLE: std::sync::LazyLock<[[f32; 8]; 8]> = std::sync::LazyLock::new(|| {
        std::array::from_fn(|k| {
            let scale = if k == 0 { 0.125_f64.sqrt() } else { 0.5 };
            let angle = |n: usize| std::f64::consts::PI * (2 * n + 1) as f64 * k as f64 / 16.0;
            std::array::from_fn(|n| (scale * angle(n).cos()) as f32)
        })
    });
    &TABLE
}

type Block = [[f32; 8]; 8];

fn transposed(block: &Block) -> Block {
    std::array::from_fn(|i| std::array::from_fn(|j| block[j][i]))
}

/// `left x right`.
fn product(left: &Block, right: &Block) -> Block {
    let mut out = [[0.0; 8]; 8];
    for (row, weights) in out.iter_mut().zip(left) {
        for (weight, values) in weights.iter().zip(right) {
            (0..8).for_each(|j| row[j] += weight * values[j]);
        }
    }
    out
}

/// The nearest whole number; the standard function is a call into libm on plain x86-64.
fn rounded(v: f32) -> f32 {
    const SHIFT: f32 = 12_582_912.0; // 1.5 x 2^23
    (v + SHIFT) - SHIFT
}

impl Plane {
    fn quantise(&mut self, table: &[f32; 64]) {
        let forward = cosines();
        let backward = transposed(forward);
        let inverse = table.map(|q| 1.0 / q);
        for y in (0..self.height).step_by(8) {
            for x in (0..self.width).step_by(8) {
                let at = |i: usize| (y + i) * self.width + x;
                let block: Block = std::array::from_fn(|i| {
                    self.data[at(i)..at(i) + 8].first_chunk::<8>().copied().unwrap_or_default()
                });
                let mut spectrum = product(&product(forward, &block), &backward);
                for (k, value) in spectrum.as_flattened_mut().iter_mut().enumerate() {
                    *value = rounded(*value * inverse[k]) * table[k];
                }
                let block = product(&product(&backward, &spectrum), forward);
                (0..8).for_each(|i| self.data[at(i)..at(i) + 8].copy_from_slice(&block[i]));
            }
        }
    }

    fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            let (above, below) = self.data[2 * y * self.width..][..2 * self.width].split_at(self.width);
            let pairs = above.as_chunks::<2>().0.iter().zip(below.as_chunks::<2>().0);
            data.extend(pairs.map(|(a, b)| 0.25 * (a[0] + a[1] + b[0] + b[1])));
        }
        Self { width, height, data }
    }

    fn fill_doubled(&mut self, half: &Self) {
        for (y, row) in self.data.chunks_exact_mut(self.width).enumerate() {
            let source = &half.data[y / 2 * half.width..][..half.width];
            row.as_chunks_mut::<2>().0.iter_mut().zip(source).for_each(|(pair, v)| *pair = [*v; 2]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_imaging::{RgbImage, decode_rgb, encode_jpeg};

    fn picture() -> LinearImage {
        let mut image = LinearImage::new(48, 32);
        for (i, pixel) in image.data.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let (x, y) = ((i % 48) as f32, (i / 48) as f32);
            let v = 0.5 + 0.3 * (0.35 * x).sin() * (0.2 * y).cos() + if x > 20.0 && y > 11.0 { 0.15 } else { 0.0 };
            *pixel = [v, 0.8 * v, 0.3 + 0.5 * (1.0 - v)];
        }
        image
    }

    fn bytes(image: &LinearImage) -> Vec<u8> {
        image.data.iter().map(|c| (c.clamp(0.0, 1.0) * 255.0 + 0.5) as u8).collect()
    }

    /// The library's encoder writes 4:4:4 with the same tables.
    #[test]
    fn it_does_what_a_real_encoder_and_decoder_do() {
        for quality in [30, 60, 90] {
            let mut image = picture();
            let raw = RgbImage::from_raw(48, 32, bytes(&image)).unwrap();
            let real = decode_rgb(&encode_jpeg(&raw, quality).unwrap(), "(test)").unwrap();
            Jpeg { quality, subsampled: false }.pass(&mut image);
            let ours = bytes(&image);
            let change = |after: &[u8]| -> Vec<f32> {
                raw.as_raw().iter().zip(after).map(|(a, b)| f32::from(*b) - f32::from(*a)).collect()
            };
            let (ours, real) = (change(&ours), change(real.as_raw()));
            let product = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
            let likeness = product(&ours, &real) / (product(&ours, &ours) * product(&real, &real)).sqrt();
            let strength = (product(&ours, &ours) / product(&real, &real)).sqrt();
            assert!(likeness > 0.65 && (0.85..1.15).contains(&strength), "quality {quality}: {likeness}, {strength}");
        }
    }

    #[test]
    fn coarse_colour_keeps_grey_and_the_mean() {
        let mut image = picture();
        let mean = |image: &LinearImage| image.data.iter().sum::<f32>() / image.data.len() as f32;
        let before = mean(&image);
        Jpeg { quality: 95, subsampled: true }.pass(&mut image);
        assert!((mean(&image) - before).abs() < 0.005);
    }
}
