//! How alike a rendering of the mesh and the picture are: what tells a wrong turn that contour and keyframes agree with.

use super::keyframe::{Maker, Window};
use super::pyramid::Pyramid;
use pseudoflow_geometry::Intrinsics;
use pseudoflow_imaging::raster::{Background, Headlight, Item, Scene, Shader};
use std::sync::Arc;

/// Rendering and picture of an object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Likeness {
    /// Correlation of their brightness, the mean of each block of 8 x 8 pixels (of half the image's size) taken off, -1 to 1.
    pub(crate) correlation: f64,
    /// Standard deviation of the rendering within blocks, grey levels: where it is small, correlation tells nothing.
    pub(crate) contrast: f64,
}

/// Renderings are compared at this level of the pyramid.
const LEVEL: usize = 1;
const BLOCK: usize = 8;
/// A block counts with so many pixels of the object, and there must be so many blocks.
const FILLED: usize = 40;
const BLOCKS: usize = 4;

/// Sums over a block.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    n: f64,
    a: f64,
    b: f64,
    aa: f64,
    ab: f64,
    bb: f64,
}

impl Maker {
    /// Compares the first of `items`, which the others may hide, with the picture; `None` when too little of it is seen.
    pub(crate) fn likeness(
        &mut self,
        pyramid: &Arc<Pyramid>,
        items: &[Item<'_>],
        camera: &Intrinsics,
    ) -> Option<Likeness> {
        let scale = f64::from(1_u32 << LEVEL);
        let half = |v: f64| (v + 0.5) / scale - 0.5;
        let camera =
            Intrinsics { fx: camera.fx / scale, fy: camera.fy / scale, cx: half(camera.cx), cy: half(camera.cy) };
        let level = &pyramid.levels[LEVEL];
        let window = Window::around(&items[0], &camera, level)?;
        let scene = Scene {
            items,
            intrinsics: Intrinsics { cx: camera.cx - window.x0 as f64, cy: camera.cy - window.y0 as f64, ..camera },
            width: window.width as u32,
            height: window.height as u32,
            background: Background::Colour([0; 3]),
        };
        self.scratch.cover(&scene);
        let across = window.width.div_ceil(BLOCK);
        let mut blocks = vec![Sums::default(); across * window.height.div_ceil(BLOCK)];
        for (i, _) in self.scratch.owners().iter().enumerate().filter(|(_, owner)| **owner == 1) {
            let (x, y) = (i % window.width, i / window.width);
            let surface = self.scratch.surface_at(&scene, i, [x as f64, y as f64], 1.0);
            let [r, g, b] = Headlight::default().shade(&surface);
            let rendered = 255.0 * f64::from(0.299 * r + 0.587 * g + 0.114 * b);
            let seen = f64::from(level.grey[(y + window.y0) * level.width + x + window.x0]);
            blocks[y / BLOCK * across + x / BLOCK].add(rendered, seen);
        }
        whole(&blocks)
    }
}

impl Sums {
    fn add(&mut self, a: f64, b: f64) {
        self.n += 1.0;
        (self.a, self.b) = (self.a + a, self.b + b);
        (self.aa, self.ab, self.bb) = (self.aa + a * a, self.ab + a * b, self.bb + b * b);
    }
}

fn whole(blocks: &[Sums]) -> Option<Likeness> {
    let (mut count, mut n, mut aa, mut ab, mut bb) = (0, 0.0, 0.0, 0.0, 0.0);
    for s in blocks.iter().filter(|s| s.n >= FILLED as f64) {
        count += 1;
        n += s.n;
        aa += s.aa - s.a * s.a / s.n;
        ab += s.ab - s.a * s.b / s.n;
        bb += s.bb - s.b * s.b / s.n;
    }
    let correlation = ab / (aa * bb).sqrt().max(1e-9);
    (count >= BLOCKS).then(|| Likeness { correlation, contrast: (aa / n).sqrt() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::texture::pyramid::Pyramid;
    use nalgebra::Vector3;
    use pseudoflow_geometry::Pose;
    use pseudoflow_imaging::raster::{Rendering, Scratch, render_scene};
    use pseudoflow_imaging::shapes::cuboid;

    #[test]
    fn only_the_right_pose_looks_like_the_picture() {
        let mut mesh = cuboid([0.12, 0.1, 0.08], [9; 3]).unwrap();
        mesh = crate::testing::spotted(&mesh);
        let camera = Intrinsics { fx: 500.0, fy: 500.0, cx: 159.5, cy: 119.5 };
        let at = |turn: f64| Pose::new(Vector3::new(0.0, 0.0, 0.45), Vector3::new(0.5, turn, 0.2));
        let scene = Scene {
            items: &[Item { mesh: &mesh, camera_from_object: at(0.6) }],
            intrinsics: camera,
            width: 320,
            height: 240,
            background: Background::Colour([90; 3]),
        };
        let mut out = Rendering::new(320, 240);
        render_scene(&scene, &Headlight::default(), &mut Scratch::default(), &mut out);
        let pyramid = Arc::new(Pyramid::new(&out.rgb));
        let mut maker = Maker::default();
        let mut like = |turn: f64| {
            maker.likeness(&pyramid, &[Item { mesh: &mesh, camera_from_object: at(turn) }], &camera).unwrap()
        };
        assert!(like(0.6).correlation > 0.95 && like(0.6).contrast > 5.0, "{:?}", like(0.6));
        assert!(like(0.8).correlation < 0.6, "{:?}", like(0.8));
    }
}
