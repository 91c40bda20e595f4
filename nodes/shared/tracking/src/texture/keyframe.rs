use super::pyramid::{Level, Pyramid};
use nalgebra::{Matrix2, Matrix2x3, Point3, Vector3};
use pseudoflow_geometry::{Intrinsics, Pose};
use pseudoflow_imaging::raster::{Background, Headlight, Item, Scene, Scratch, Shader};
use std::sync::Arc;

/// A point of the object's surface with a patch of the keyframe around it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Anchor {
    /// Metres, the object's frame.
    pub(crate) position: Point3<f64>,
    /// Two directions in its surface, the object's frame.
    along: [Vector3<f64>; 2],
    /// Where it is in the keyframe.
    pub(crate) place: [f32; 2],
    /// Pixels of the keyframe for metres along the surface, inverted.
    surface_from_key: Matrix2<f64>,
}

/// A frame in which the object was surely seen.
#[derive(Debug, Clone)]
pub(crate) struct Keyframe {
    pub(crate) pyramid: Arc<Pyramid>,
    pub(crate) pose: Pose,
    pub(crate) anchors: Vec<Anchor>,
    /// Patches less alike than this are something else, -1 to 1.
    pub(crate) alike: f32,
}

/// How alike patches of two pictures of one camera are, and of a rendering and a picture.
const ALIKE: f32 = 0.8;
const ALIKE_RENDERED: f32 = 0.6;

/// Makes keyframes. Holds its working memory.
#[derive(Debug, Default)]
pub(crate) struct Maker {
    pub(super) scratch: Scratch,
}

/// Brightness behind what is rendered, grey levels.
const BEHIND: f32 = 110.0;
/// Points of a keyframe, at least.
const FEWEST: usize = 6;
/// Points of a keyframe, at most.
const MOST: usize = 60;
/// Corners weaker than this are noise: root of the smaller eigenvalue of the mean gradient product, grey levels a pixel.
const WEAKEST: f32 = 2.5;
/// Distance that patches keep from the rim of what is seen, pixels.
const RIM: i32 = 6;

impl Anchor {
    /// `key_from_here`: offsets in the keyframe for offsets around the point as a pose shows it; `None` when its surface is seen
    /// edge on.
    pub(crate) fn key_from_here(&self, pose: &Pose, camera: &Intrinsics) -> Option<Matrix2<f32>> {
        let here = slope(&(pose * self.position), &self.along.map(|a| pose.rotation * a), camera);
        // px of the keyframe <- metres along the surface <- px here
        let key_from_surface = self.surface_from_key.try_inverse()?;
        let m = key_from_surface * here.try_inverse()?;
        let stretch = m.determinant().abs();
        (stretch > 0.2 && stretch < 5.0).then(|| m.map(|v| v as f32))
    }
}

/// Pixels for metres along two directions at a point.
fn slope(point: &Point3<f64>, along: &[Vector3<f64>; 2], camera: &Intrinsics) -> Matrix2<f64> {
    let (x, y, i) = (point.x / point.z, point.y / point.z, 1.0 / point.z);
    let j = Matrix2x3::new(camera.fx * i, 0.0, -camera.fx * i * x, 0.0, camera.fy * i, -camera.fy * i * y);
    Matrix2::from_columns(&[j * along[0], j * along[1]])
}

impl Maker {
    /// The part of the picture around the first of `items`, and which of them covers each pixel of it. `None` outside the picture.
    fn cover<'a>(
        &mut self,
        pyramid: &Pyramid,
        items: &'a [Item<'a>],
        camera: &Intrinsics,
    ) -> Option<(Window, Scene<'a>)> {
        let window = Window::around(&items[0], camera, &pyramid.levels[0])?;
        let scene = Scene {
            items,
            intrinsics: Intrinsics { cx: camera.cx - window.x0 as f64, cy: camera.cy - window.y0 as f64, ..*camera },
            width: window.width as u32,
            height: window.height as u32,
            background: Background::Colour([0; 3]),
        };
        self.scratch.cover(&scene);
        Some((window, scene))
    }

    /// A keyframe of the first of `items`, which the others may hide. `None` when too little texture is seen.
    pub(crate) fn make(&mut self, pyramid: &Arc<Pyramid>, items: &[Item<'_>], camera: &Intrinsics) -> Option<Keyframe> {
        let (window, scene) = self.cover(pyramid, items, camera)?;
        let anchors = self.anchors(&scene, &window, pyramid);
        let (pose, pyramid) = (items[0].camera_from_object, Arc::clone(pyramid));
        (anchors.len() >= FEWEST).then_some(Keyframe { pyramid, pose, anchors, alike: ALIKE })
    }

    /// The mesh itself as a keyframe: the first of `items` rendered at its pose. It binds the object to what is known of it, where
    /// keyframes bind it to what was believed.
    pub(crate) fn rendered(&mut self, pyramid: &Pyramid, items: &[Item<'_>], camera: &Intrinsics) -> Option<Keyframe> {
        let (window, scene) = self.cover(pyramid, items, camera)?;
        let (width, height) = (window.width, window.height);
        let mut grey = vec![BEHIND; width * height];
        for (i, _) in self.scratch.owners().iter().enumerate().filter(|(_, owner)| **owner == 1) {
            let surface = self.scratch.surface_at(&scene, i, [(i % width) as f64, (i / width) as f64], 1.0);
            let [r, g, b] = Headlight::default().shade(&surface);
            grey[i] = 255.0 * (0.299 * r + 0.587 * g + 0.114 * b);
        }
        let pyramid = Arc::new(Pyramid::of_level(Level { width, height, grey }));
        let own = Window { x0: 0, y0: 0, width, height };
        let anchors = self.anchors(&scene, &own, &pyramid);
        let pose = items[0].camera_from_object;
        (anchors.len() >= FEWEST).then_some(Keyframe { pyramid, pose, anchors, alike: ALIKE_RENDERED })
    }

    /// Corners of a window's picture on the scene that was covered last.
    fn anchors(&self, scene: &Scene<'_>, window: &Window, pyramid: &Pyramid) -> Vec<Anchor> {
        let pose = scene.items[0].camera_from_object;
        let object_from_camera = pose.inverse();
        let anchor = |(x, y): (usize, usize)| {
            let surface = self.scratch.surface_at(scene, y * window.width + x, [x as f64, y as f64], 1.0);
            let position = Point3::from(surface.point_in_object.map(f64::from));
            let normal = object_from_camera.rotation * Vector3::from(surface.normal_in_camera.map(f64::from));
            let place = [(x + window.x0) as f32, (y + window.y0) as f32];
            Self::anchor(position, &normal, place, &pose, &scene.intrinsics)
        };
        window.corners(pyramid, self.scratch.owners()).into_iter().filter_map(anchor).collect()
    }

    fn anchor(
        position: Point3<f64>,
        normal: &Vector3<f64>,
        place: [f32; 2],
        pose: &Pose,
        camera: &Intrinsics,
    ) -> Option<Anchor> {
        let other = if normal.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
        let first = normal.cross(&other).try_normalize(1e-6)?;
        let along = [first, normal.cross(&first)];
        let surface_from_key = slope(&(pose * position), &along.map(|a| pose.rotation * a), camera).try_inverse()?;
        let towards = -(pose * position).coords.normalize();
        let facing = (pose.rotation * normal).dot(&towards);
        (facing > 0.3).then_some(Anchor { position, along, place, surface_from_key })
    }
}

/// The part of the image that shows an object.
pub(super) struct Window {
    pub(super) x0: usize,
    pub(super) y0: usize,
    pub(super) width: usize,
    pub(super) height: usize,
}

impl Window {
    pub(super) fn around(item: &Item<'_>, camera: &Intrinsics, level: &Level) -> Option<Self> {
        let (mut least, mut most) = ([f64::MAX; 2], [f64::MIN; 2]);
        for corner in item.mesh.box_corners_m() {
            let at = camera.project(&(item.camera_from_object * corner))?;
            for k in 0..2 {
                (least[k], most[k]) = (least[k].min(at[k]), most[k].max(at[k]));
            }
        }
        let within = |v: f64, size: usize| v.clamp(0.0, size as f64) as usize;
        let (x0, y0) = (within(least[0], level.width), within(least[1], level.height));
        let (x1, y1) = (within(most[0] + 1.0, level.width), within(most[1] + 1.0, level.height));
        (x1 > x0 + 16 && y1 > y0 + 16).then(|| Self { x0, y0, width: x1 - x0, height: y1 - y0 })
    }

    /// The best corners of a grid on what is seen of item 1, places in the window.
    fn corners(&self, pyramid: &Pyramid, owners: &[u8]) -> Vec<(usize, usize)> {
        let seen = owners.iter().filter(|o| **o == 1).count();
        let cell = ((seen as f64 / MOST as f64).sqrt() as usize).max(6);
        let inside = |x: usize, y: usize| {
            [(-RIM, 0), (RIM, 0), (0, -RIM), (0, RIM), (0, 0)].iter().all(|(dx, dy)| {
                let (x, y) = (x as i32 + dx, y as i32 + dy);
                let within = x >= 0 && y >= 0 && x < self.width as i32 && y < self.height as i32;
                within && owners[y as usize * self.width + x as usize] == 1
            })
        };
        let mut found = Vec::new();
        for cy in (0..self.height).step_by(cell) {
            for cx in (0..self.width).step_by(cell) {
                let places = (cy..(cy + cell).min(self.height)).step_by(2);
                let places = places.flat_map(|y| (cx..(cx + cell).min(self.width)).step_by(2).map(move |x| (x, y)));
                let scored =
                    places.filter(|(x, y)| inside(*x, *y)).map(|(x, y)| (self.cornerness(pyramid, x, y), x, y));
                let best = scored.max_by(|a, b| a.0.total_cmp(&b.0));
                found.extend(best.filter(|(c, ..)| *c > WEAKEST));
            }
        }
        found.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.2, a.1).cmp(&(b.2, b.1))));
        found.into_iter().take(MOST).map(|(_, x, y)| (x, y)).collect()
    }

    /// Root of the smaller eigenvalue of the mean gradient product around a place.
    fn cornerness(&self, pyramid: &Pyramid, x: usize, y: usize) -> f32 {
        let level = &pyramid.levels[0];
        let (x, y) = (x + self.x0, y + self.y0);
        if x < 6 || y < 6 || x + 6 >= level.width || y + 6 >= level.height {
            return 0.0;
        }
        let (mut a, mut b, mut c) = (0.0, 0.0, 0.0);
        for j in (y - 3..=y + 3).step_by(2) {
            for i in (x - 3..=x + 3).step_by(2) {
                let at = j * level.width + i;
                let gx = 0.5 * (level.grey[at + 1] - level.grey[at - 1]);
                let gy = 0.5 * (level.grey[at + level.width] - level.grey[at - level.width]);
                (a, b, c) = (a + gx * gx, b + gx * gy, c + gy * gy);
            }
        }
        let (middle, apart) = (0.5 * (a + c), (0.25 * (a - c).powi(2) + b * b).sqrt());
        ((middle - apart).max(0.0) / 16.0).sqrt()
    }
}
