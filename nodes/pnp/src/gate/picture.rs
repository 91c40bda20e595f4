//! Luminance and colour of a picture between its pixels.

/// Luminance (ITU-R BT.601) of interleaved rgb, 0..255.
pub(super) fn luminance(rgb: &[u8], out: &mut Vec<f32>) {
    out.clear();
    let value = |p: &[u8; 3]| 0.299 * f32::from(p[0]) + 0.587 * f32::from(p[1]) + 0.114 * f32::from(p[2]);
    out.extend(rgb.as_chunks::<3>().0.iter().map(value));
}

/// Where a point lies between four pixels.
pub(super) struct Bilinear {
    corner: usize,
    stride: usize,
    fx: f32,
    fy: f32,
}

impl Bilinear {
    /// `None` outside the centres of the outermost pixels of a square picture.
    pub(super) fn at(x: f64, y: f64, size_px: usize) -> Option<Self> {
        let last = size_px.checked_sub(1)?;
        let inside = |v: f64| (0.0..=last as f64).contains(&v);
        if size_px < 2 || !inside(x) || !inside(y) {
            return None;
        }
        let (ix, iy) = ((x as usize).min(last - 1), (y as usize).min(last - 1));
        Some(Self {
            corner: iy * size_px + ix,
            stride: size_px,
            fx: (x - ix as f64) as f32,
            fy: (y - iy as f64) as f32,
        })
    }

    /// Bilinear mean of what `pixel` returns for the four pixels.
    pub(super) fn mix(&self, pixel: impl Fn(usize) -> f32) -> f32 {
        let row = |i: usize| pixel(i) + self.fx * (pixel(i + 1) - pixel(i));
        let (top, bottom) = (row(self.corner), row(self.corner + self.stride));
        top + self.fy * (bottom - top)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_positions_read_the_pixel_and_the_rest_is_linear() {
        let plane: Vec<f32> = (0..16).map(|i| (i % 4) as f32 + 10.0 * (i / 4) as f32).collect();
        let read = |x, y| Bilinear::at(x, y, 4).map(|b| b.mix(|i| plane[i]));
        assert_eq!(read(3.0, 3.0), Some(33.0));
        assert_eq!(read(1.0, 2.0), Some(21.0));
        assert_eq!(read(0.5, 1.25), Some(13.0));
        assert_eq!(read(3.01, 0.0), None);
        assert_eq!(read(f64::NAN, 0.0), None);
    }
}
