//! Images in linear light and the filters of lens, motion and sharpening.

/// An image in linear light: `height` rows of `width` RGB triples.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LinearImage {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) data: Vec<f32>,
}

impl LinearImage {
    /// A black image.
    pub(crate) fn new(width: usize, height: usize) -> Self {
        Self { width, height, data: vec![0.0; 3 * width * height] }
    }

    /// A part of it; must lie within.
    pub(crate) fn part(&self, x0: usize, y0: usize, width: usize, height: usize) -> Self {
        let rows = (y0..y0 + height).flat_map(|y| &self.data[3 * (y * self.width + x0)..][..3 * width]);
        Self { width, height, data: rows.copied().collect() }
    }

    /// The RGB triples.
    pub(super) fn pixels(&self) -> &[[f32; 3]] {
        self.data.as_chunks::<3>().0
    }

    /// Gaussian blur, borders repeated.
    pub(super) fn blur(&mut self, sigma_px: f32) {
        if sigma_px < 0.2 {
            return;
        }
        let radius = (2.5 * sigma_px).ceil() as i32;
        let weights: Vec<f32> = (-radius..=radius).map(|i| (-0.5 * (i as f32 / sigma_px).powi(2)).exp()).collect();
        let total: f32 = weights.iter().sum();
        let taps: Vec<(i32, f32)> = (-radius..=radius).zip(weights.iter().map(|w| w / total)).collect();
        self.filter(&taps.iter().map(|&(i, w)| (i, 0, w)).collect::<Vec<_>>());
        self.filter(&taps.iter().map(|&(i, w)| (0, i, w)).collect::<Vec<_>>());
    }

    /// The mean over a disc: a lens out of focus.
    pub(super) fn defocus(&mut self, radius_px: f32) {
        let radius = radius_px.ceil() as i32;
        let inside = |x: i32, y: i32| (radius_px + 0.5 - (x as f32).hypot(y as f32)).clamp(0.0, 1.0);
        let square = (-radius..=radius).flat_map(|y| (-radius..=radius).map(move |x| (x, y)));
        let taps: Vec<_> = square.map(|(x, y)| (x, y, inside(x, y))).filter(|t| t.2 > 0.0).collect();
        let total: f32 = taps.iter().map(|t| t.2).sum();
        self.filter(&taps.iter().map(|&(x, y, w)| (x, y, w / total)).collect::<Vec<_>>());
    }

    /// The mean over a straight path.
    pub(super) fn smear(&mut self, [dx, dy]: [f32; 2]) {
        let count = dx.hypot(dy).ceil() as i32;
        if count < 1 {
            return;
        }
        let place = |i: i32, d: f32| (d * (i as f32 / count as f32 - 0.5)).round() as i32;
        let taps: Vec<_> = (0..=count).map(|i| (place(i, dx), place(i, dy), 1.0 / (count + 1) as f32)).collect();
        self.filter(&taps);
    }

    /// Unsharp masking.
    pub(super) fn sharpen(&mut self, amount: f32, sigma_px: f32) {
        let sharp = self.data.clone();
        self.blur(sigma_px);
        self.data.iter_mut().zip(&sharp).for_each(|(soft, sharp)| *soft = sharp + amount * (sharp - *soft));
    }

    /// Weighted sum of shifted copies, row by row; borders repeated.
    fn filter(&mut self, taps: &[(i32, i32, f32)]) {
        let (width, height) = (self.width as i32, self.height as i32);
        let stride = 3 * self.width;
        let mut out = vec![0.0_f32; self.data.len()];
        for (y, row) in out.chunks_exact_mut(stride).enumerate() {
            for &(dx, dy, weight) in taps {
                let source = &self.data[(y as i32 + dy).clamp(0, height - 1) as usize * stride..][..stride];
                let (from, to) = ((-dx).clamp(0, width) as usize, (width - dx).clamp(0, width) as usize);
                let edge = |x: usize| 3 * (x as i32 + dx).clamp(0, width - 1) as usize;
                for x in (0..from.min(self.width)).chain(to.max(from)..self.width) {
                    add(&mut row[3 * x..3 * x + 3], &source[edge(x)..][..3], weight);
                }
                if from < to {
                    let shifted = &source[3 * (from as i32 + dx) as usize..3 * (to as i32 + dx) as usize];
                    add(&mut row[3 * from..3 * to], shifted, weight);
                }
            }
        }
        self.data = out;
    }
}

fn add(sums: &mut [f32], values: &[f32], weight: f32) {
    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filters_keep_a_constant_image() {
        let mut image = LinearImage::new(24, 17);
        image.data.fill(0.25);
        image.blur(2.3);
        image.defocus(2.7);
        image.smear([6.2, -3.0]);
        image.smear([200.0, 0.0]);
        image.sharpen(0.7, 1.0);
        assert!(image.data.iter().all(|c| (c - 0.25).abs() < 1e-5));
    }

    #[test]
    fn filters_have_no_net_shift() {
        let apply: [fn(&mut LinearImage); 3] = [|i| i.smear([6.0, 0.0]), |i| i.blur(1.1), |i| i.defocus(1.8)];
        for filter in apply {
            let mut image = LinearImage::new(24, 17);
            image.data[3 * (8 * 24 + 12)] = 1.0;
            filter(&mut image);
            let mean: f32 = (0..17 * 24).map(|i| (i % 24) as f32 * image.data[3 * i]).sum();
            assert!((mean - 12.0).abs() < 0.26, "{mean}");
        }
    }

    #[test]
    fn a_part_is_what_lies_there() {
        let mut image = LinearImage::new(10, 8);
        image.data.iter_mut().enumerate().for_each(|(i, v)| *v = i as f32);
        let part = image.part(3, 2, 4, 5);
        assert_eq!((part.width, part.height, part.data[0]), (4, 5, (3 * (2 * 10 + 3)) as f32));
        assert_eq!(part.data[3 * 4], (3 * (3 * 10 + 3)) as f32);
    }
}
