use pseudoflow_imaging::RgbImage;

/// One level: brightness 0..255, row by row.
#[derive(Debug, Clone, Default)]
pub(crate) struct Level {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) grey: Vec<f32>,
}

/// An image at full size, half, a quarter: pixel x of a level lies at 2 x + 1/2 of the one below it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Pyramid {
    pub(crate) levels: Vec<Level>,
}

/// Levels of a pyramid.
pub(crate) const LEVELS: usize = 3;

impl Pyramid {
    pub(crate) fn new(rgb: &RgbImage) -> Self {
        let (width, height) = (rgb.width() as usize, rgb.height() as usize);
        let grey = rgb.as_raw().as_chunks::<3>().0.iter();
        let grey = grey.map(|[r, g, b]| 0.299 * f32::from(*r) + 0.587 * f32::from(*g) + 0.114 * f32::from(*b));
        Self::of_level(Level { width, height, grey: grey.collect() })
    }

    /// Of brightness that is there already.
    pub(crate) fn of_level(level: Level) -> Self {
        let mut levels = vec![level];
        for _ in 1..LEVELS {
            let next = levels[levels.len() - 1].halved();
            levels.push(next);
        }
        Self { levels }
    }

    /// Mean and standard deviation of the coarsest level: a black frame has neither.
    pub(crate) fn brightness(&self) -> (f32, f32) {
        let Some(level) = self.levels.last().filter(|l| !l.grey.is_empty()) else { return (0.0, 0.0) };
        let n = level.grey.len() as f32;
        let mean = level.grey.iter().sum::<f32>() / n;
        let variance = level.grey.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / n;
        (mean, variance.sqrt())
    }
}

impl Level {
    fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut grey = Vec::with_capacity(width * height);
        for y in 0..height {
            let (top, bottom) = (&self.grey[2 * y * self.width..], &self.grey[(2 * y + 1) * self.width..]);
            grey.extend((0..width).map(|x| 0.25 * (top[2 * x] + top[2 * x + 1] + bottom[2 * x] + bottom[2 * x + 1])));
        }
        Self { width, height, grey }
    }

    /// Whether a place has pixels on all sides.
    pub(crate) fn holds(&self, [x, y]: [f32; 2]) -> bool {
        x >= 0.0 && y >= 0.0 && x < self.width as f32 - 1.0 && y < self.height as f32 - 1.0
    }

    /// Bilinear sample at a place that it [holds](Self::holds).
    pub(crate) fn sample(&self, [x, y]: [f32; 2]) -> f32 {
        let (x0, y0) = (x as usize, y as usize);
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let i = y0 * self.width + x0;
        let (a, b) = (&self.grey[i..i + 2], &self.grey[i + self.width..i + self.width + 2]);
        let (top, bottom) = (a[0] + fx * (a[1] - a[0]), b[0] + fx * (b[1] - b[0]));
        top + fy * (bottom - top)
    }
}

/// Where a place of the full image lies in a level.
pub(crate) fn in_level(at: [f32; 2], level: usize) -> [f32; 2] {
    let scale = (1_u32 << level) as f32;
    at.map(|v| (v + 0.5) / scale - 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_is_the_same_ramp_in_every_level() {
        let image = RgbImage::from_fn(64, 48, |x, y| image_pixel((2 * x + y) as u8));
        let pyramid = Pyramid::new(&image);
        for (l, level) in pyramid.levels.iter().enumerate() {
            let [x, y] = in_level([30.25, 20.5], l);
            assert!((level.sample([x, y]) - 81.0).abs() < 1e-3, "level {l}");
        }
        assert!(!pyramid.levels[0].holds([63.0, 3.0]));
        assert!(Pyramid::new(&RgbImage::new(64, 48)).brightness() == (0.0, 0.0));
    }

    fn image_pixel(v: u8) -> <RgbImage as std::ops::Index<(u32, u32)>>::Output {
        [v, v, v].into()
    }
}
