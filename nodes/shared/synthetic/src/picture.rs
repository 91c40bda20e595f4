//! The picture of a scene in linear light, and what is where in it.

use super::sensor::LinearImage;
use super::window::{SAMPLES, Window};
use pseudoflow_imaging::raster::{Background, Item, Scene, Scratch, Surface};

/// What the scene looks like, and what is where.
pub(super) struct Picture {
    /// One value per pixel of the window.
    pub(super) light: LinearImage,
    /// [`SAMPLES`] squared samples per pixel.
    pub(super) visible: Samples,
}

/// What is nearest at each sample.
pub(super) struct Samples {
    pub(super) width: usize,
    pub(super) height: usize,
    /// 0 where nothing is, else n for the n-th item, counted from 1.
    pub(super) owner: Vec<u8>,
    /// 1 / z, 1/m; 0 where nothing is.
    pub(super) inverse_depth: Vec<f32>,
}

/// Light from where nothing is.
const EMPTY: [f32; 3] = [0.1; 3];
/// Samples of one item whose depths differ by less than this part are taken as one surface.
const ONE_SURFACE: f32 = 0.02;

impl Picture {
    /// Covers the window with samples and shades each pixel where one surface fills it once, at its centre (textures are
    /// filtered to the pixel), and else once for each surface that its samples see.
    pub(super) fn render(items: &[Item<'_>], window: &Window, shade: impl Fn(&Surface) -> [f32; 3]) -> Self {
        let (width, height) = window.sampled_px();
        let background = Background::Colour([0; 3]);
        let scene = Scene { items, intrinsics: window.sampled_intrinsics(), width, height, background };
        let mut seen = Scratch::default();
        seen.cover(&scene);
        let mut light = LinearImage::new(window.width as usize, window.height as usize);
        let stride = width as usize;
        for (i, pixel) in light.data.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let (x, y) = (i % window.width as usize * 2, i / window.width as usize * 2);
            let samples = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)].map(|(x, y)| y * stride + x);
            *pixel = if is_one_surface(&seen, &samples) {
                let centre = [x as f64 + 0.5, y as f64 + 0.5];
                match seen.owners()[samples[0]] {
                    0 => EMPTY,
                    _ => shade(&seen.surface_at(&scene, samples[0], centre, f64::from(SAMPLES))),
                }
            } else {
                mixed(&seen, &scene, &samples, stride, &shade)
            };
        }
        let visible = Samples {
            width: stride,
            height: height as usize,
            owner: seen.owners().to_vec(),
            inverse_depth: seen.inverse_depths().to_vec(),
        };
        Self { light, visible }
    }
}

fn is_one_surface(seen: &Scratch, samples: &[usize; 4]) -> bool {
    let owners = samples.map(|i| seen.owners()[i]);
    if owners.iter().any(|o| *o != owners[0]) {
        return false;
    }
    let triangles = samples.map(|i| seen.triangles()[i]);
    if triangles.iter().all(|t| *t == triangles[0]) {
        return true;
    }
    let depths = samples.map(|i| seen.inverse_depths()[i]);
    let (low, high) = depths.iter().fold((f32::MAX, 0.0_f32), |(low, high), d| (low.min(*d), high.max(*d)));
    high - low < ONE_SURFACE * high
}

/// The mean of the samples; those of one triangle are shaded once.
fn mixed(
    seen: &Scratch,
    scene: &Scene<'_>,
    samples: &[usize; 4],
    stride: usize,
    shade: &impl Fn(&Surface) -> [f32; 3],
) -> [f32; 3] {
    let key = |i: usize| (seen.owners()[i], seen.triangles()[i]);
    let mut sum = [0.0_f32; 3];
    let mut colours = [[0.0_f32; 3]; 4];
    for (n, &i) in samples.iter().enumerate() {
        colours[n] = match samples[..n].iter().position(|&j| key(j) == key(i)) {
            Some(same) => colours[same],
            None if seen.owners()[i] == 0 => EMPTY,
            None => {
                let at = [(i % stride) as f64, (i / stride) as f64];
                shade(&seen.surface_at(scene, i, at, f64::from(SAMPLES)))
            }
        };
        (0..3).for_each(|k| sum[k] += 0.25 * colours[n][k]);
    }
    sum
}

impl Samples {
    /// Metres; 0 where nothing is.
    pub(super) fn depth_m(&self, sample: usize) -> f32 {
        let inverse = self.inverse_depth[sample];
        if inverse > 0.0 { 1.0 / inverse } else { 0.0 }
    }

    /// How many samples show the first item.
    pub(super) fn of_object(&self) -> usize {
        self.owner.iter().filter(|o| **o == 1).count()
    }
}

/// How many samples of a window an item covers when nothing else is there.
pub(super) fn samples_alone(item: Item<'_>, window: &Window) -> usize {
    let (width, height) = window.sampled_px();
    let intrinsics = window.sampled_intrinsics();
    let mut seen = Scratch::default();
    seen.cover(&Scene { items: &[item], intrinsics, width, height, background: Background::Colour([0; 3]) });
    seen.owners().iter().filter(|o| **o == 1).count()
}
