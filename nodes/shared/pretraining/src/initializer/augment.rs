//! A rendered scene seen by other cameras at the same place: turned, zoomed, shifted, with other colours. All of it is
//! exact, as a camera that only turns sees the same rays.

use nalgebra::{Point2, Point3, UnitQuaternion, Vector3};
use pseudoflow_geometry::{Intrinsics, standard_normal};
use pseudoflow_imaging::{BACKGROUND_GREY, Object, ObjectSet, RgbImage};
use pseudoflow_learning::{InstanceTruth, SceneTruth};
use pseudoflow_network::{CORNERS, Grid};
use pseudoflow_synthetic::SceneSample;
use rand::Rng;

/// One image of a batch, and what it shows.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Example {
    /// The network's input.
    pub(crate) image: RgbImage,
    pub(crate) truth: SceneTruth,
}

/// The other camera.
struct Turned {
    from: Intrinsics,
    to: Intrinsics,
    /// Rotation, in `to`'s frame, of what `from` sees.
    to_from: UnitQuaternion<f64>,
    /// Rows of the input that show the image; below is grey.
    rows: usize,
}

/// Linear factors and a gamma on each channel.
struct Colours {
    gain: [f32; 3],
    gamma: f32,
}

/// The example for input images of `grid`.
pub(crate) fn example(scene: &SceneSample, objects: &ObjectSet, grid: &Grid, rng: &mut impl Rng) -> Example {
    let turned = Turned::draw(scene, grid, rng);
    let colours = Colours::draw(rng);
    let image = turned.image(&scene.image, grid, &colours);
    let known = |id: u32| objects.iter().enumerate().find(|(_, object)| object.id == id);
    let mut truth = SceneTruth { intrinsics: turned.pinhole(), owner: vec![], surface: vec![], instances: vec![] };
    // For each instance its number (0 where it cannot be labelled), and how its surface is measured.
    let mut places = Vec::new();
    for instance in &scene.instances {
        let Some((class, object)) = known(instance.object_id) else { continue };
        let pose = object.symmetries.canonical(&instance.camera_from_object);
        let corners = object.box_corners_m().map(|corner| turned.to_from * (pose * corner));
        let hull = object.hull_m.iter().map(|point| turned.to_from * (pose * point));
        let label = turned.label(class, object, corners, hull);
        let labelled = label.is_some();
        truth.instances.extend(label);
        places.push((if labelled { truth.instances.len() as u8 } else { 0 }, pose.inverse(), object));
    }
    for cell in &grid.cells {
        let seen = turned.seen(scene, cell.centre_px).map(|(instance, point)| (places[instance], point));
        let seen = seen.filter(|((number, _, _), _)| *number > 0);
        truth.owner.push(seen.map_or(0, |((number, _, _), _)| number));
        truth.surface.push(seen.map_or([0.0; 3], |((_, object_from_camera, object), point)| {
            let away = (object_from_camera * point - object.box_centre_m()) / object.diameter_m;
            [away.x as f32, away.y as f32, away.z as f32]
        }));
    }
    Example { image, truth }
}

fn uniform(rng: &mut impl Rng, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

impl Turned {
    fn draw(scene: &SceneSample, grid: &Grid, rng: &mut impl Rng) -> Self {
        let from = scene.intrinsics;
        let [width, height] = grid.input_px.map(|v| v as f64);
        let shown = f64::from(scene.image.height()).min(height);
        // Most cameras have images of 4 : 3, many of 16 : 9.
        let rows = if rng.random::<f64>() < 0.2 { (0.75 * shown).round() } else { shown };
        let zoom = uniform(rng, 0.75_f64.ln(), 1.3_f64.ln()).exp();
        let shift = [(); 2].map(|()| uniform(rng, -0.05, 0.05) * width);
        let degrees = [2.0, 2.0, 12.0].map(|sigma: f64| sigma.to_radians() * standard_normal(rng));
        let to = Intrinsics {
            fx: zoom * from.fx,
            fy: zoom * from.fy,
            cx: (width - 1.0) / 2.0 + shift[0],
            cy: (rows - 1.0) / 2.0 + shift[1],
        };
        Self { from, to, to_from: UnitQuaternion::from_scaled_axis(Vector3::from(degrees)), rows: rows as usize }
    }

    /// Where the scene's image shows what an input pixel shows.
    fn source(&self, pixel: [f64; 2]) -> Option<Point2<f64>> {
        let ray = self.to.unproject(&Point2::from(pixel), 1.0);
        self.from.project(&Point3::from(self.to_from.inverse() * ray.coords))
    }

    /// The instance that is seen at an input pixel, and the point of it, metres, in the frame of the scene's camera.
    fn seen(&self, scene: &SceneSample, centre_px: [f32; 2]) -> Option<(usize, Point3<f64>)> {
        let (width, height) = scene.image.dimensions();
        let inside = centre_px[1] < self.rows as f32;
        let at = inside.then(|| self.source(centre_px.map(f64::from))).flatten()?;
        let at = Point2::new(at.x.round(), at.y.round());
        let within = at.x >= 0.0 && at.y >= 0.0 && at.x < f64::from(width) && at.y < f64::from(height);
        let index = if within { at.y as usize * width as usize + at.x as usize } else { return None };
        let instance = usize::from(scene.owner[index]).checked_sub(1)?;
        Some((instance, self.from.unproject(&at, f64::from(scene.depth_m[index]))))
    }

    fn pinhole(&self) -> [f32; 4] {
        [self.to.fx, self.to.fy, self.to.cx, self.to.cy].map(|v| v as f32)
    }

    /// The image, bilinear; what lies outside repeats the border.
    fn image(&self, image: &RgbImage, grid: &Grid, colours: &Colours) -> RgbImage {
        let table = colours.table();
        let [width, height] = grid.input_px;
        let mut pixels = vec![BACKGROUND_GREY; width * height * 3];
        for (i, pixel) in pixels.as_chunks_mut::<3>().0.iter_mut().enumerate().take(width * self.rows) {
            if let Some(at) = self.source([(i % width) as f64, (i / width) as f64]) {
                let mixed = bilinear(image, at);
                *pixel = std::array::from_fn(|k| table[k][usize::from(mixed[k])]);
            }
        }
        RgbImage::from_raw(width as u32, height as u32, pixels).unwrap_or_default()
    }

    /// `None` when a corner is not well before the camera.
    fn label(
        &self,
        class: usize,
        object: &Object,
        corners: [Point3<f64>; CORNERS],
        hull: impl Iterator<Item = Point3<f64>>,
    ) -> Option<InstanceTruth> {
        let near = 0.1 * object.diameter_m;
        let projected: Vec<Point2<f64>> =
            corners.iter().filter(|c| c.z > near).filter_map(|c| self.to.project(c)).collect();
        if projected.len() < CORNERS {
            return None;
        }
        let side = |k: usize| {
            let along = projected.iter().map(|p| p[k]);
            along.clone().fold(f64::MIN, f64::max) - along.fold(f64::MAX, f64::min)
        };
        let seen: Vec<Point2<f64>> = hull.filter_map(|p| self.to.project(&p)).collect();
        let edge = |k: usize, start: f64, pick: fn(f64, f64) -> f64| seen.iter().map(|p| p[k]).fold(start, pick) as f32;
        let (low, high) = (f64::min, f64::max);
        let rectangle_px =
            [edge(0, f64::MAX, low), edge(1, f64::MAX, low), edge(0, f64::MIN, high), edge(1, f64::MIN, high)];
        Some(InstanceTruth {
            rectangle_px,
            class,
            corners_m: corners.map(|c| [c.x as f32, c.y as f32, c.z as f32]),
            diameter_m: object.diameter_m as f32,
            side_px: side(0).max(side(1)) as f32,
        })
    }
}

fn bilinear(image: &RgbImage, at: Point2<f64>) -> [u8; 3] {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let clamp = |v: f64, size: usize| v.clamp(0.0, (size - 1) as f64) as f32;
    let (x, y) = (clamp(at.x, width), clamp(at.y, height));
    let (x0, y0) = (x as usize, y as usize);
    let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
    let (fx, fy) = (x - x0 as f32, y - y0 as f32);
    let raw = image.as_raw();
    let value = |x: usize, y: usize, k: usize| f32::from(raw[(y * width + x) * 3 + k]);
    std::array::from_fn(|k| {
        let upper = value(x0, y0, k) * (1.0 - fx) + value(x1, y0, k) * fx;
        let lower = value(x0, y1, k) * (1.0 - fx) + value(x1, y1, k) * fx;
        (upper * (1.0 - fy) + lower * fy + 0.5) as u8
    })
}

impl Colours {
    fn draw(rng: &mut impl Rng) -> Self {
        let bright = uniform(rng, -0.35, 0.35).exp();
        let gain = [(); 3].map(|()| (bright * uniform(rng, -0.12, 0.12).exp()) as f32);
        Self { gain, gamma: uniform(rng, -0.25, 0.25).exp() as f32 }
    }

    fn table(&self) -> [[u8; 256]; 3] {
        self.gain.map(|gain| {
            std::array::from_fn(|v| {
                let changed = gain * (v as f32 / 255.0).powf(self.gamma);
                (changed.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
            })
        })
    }
}
