use crate::{EvalDataset, EvalError, EvalImage, EvalModel};
use nalgebra::{Matrix3, Point2, Point3, Vector3};
use pseudoflow_geometry::Intrinsics;
use pseudoflow_imaging::raster::{Background, Item, Rendering, Scene, Scratch, Shader, Surface, render_scene};
use pseudoflow_imaging::{Mesh, Object};
use pseudoflow_metrics::{MatrixPose, VSD_DELTA_M, VsdDepths, vsd, vsd_taus};

/// The depth of a whole image that VSD compares with, metres, row-major; 0 where there is none.
pub(crate) struct TestDepth {
    depth_m: Vec<f32>,
}

impl TestDepth {
    /// The depth image of the dataset, or else the nearest surface of all true instances.
    pub(crate) fn of(dataset: &EvalDataset, image: &EvalImage) -> Result<Self, EvalError> {
        let Some(depth) = image.frame.load_depth()? else {
            return Ok(Self { depth_m: render_truth(dataset, image) });
        };
        let found = (depth.width, depth.height);
        match (found == image.size_px, &image.frame.depth_path) {
            (false, Some(path)) => Err(EvalError::DepthSize { path: path.clone(), found, expected: image.size_px }),
            _ => Ok(Self { depth_m: depth.data_m }),
        }
    }
}

fn render_truth(dataset: &EvalDataset, image: &EvalImage) -> Vec<f32> {
    let whole = Window { x0: 0, y0: 0, width: image.size_px.0 as usize, height: image.size_px.1 as usize };
    let mut nearest = vec![0.0_f32; whole.width * whole.height];
    for instance in &image.truth {
        let Ok(object) = dataset.objects.get(instance.object_id) else { continue };
        let Some(model) = dataset.models.get(&instance.object_id) else { continue };
        let pose = &instance.camera_from_object;
        let window = Window::around(object, std::slice::from_ref(pose), image);
        let depth = window.render(model, pose, &image.frame.intrinsics);
        for (row, y) in depth.chunks_exact(window.width.max(1)).zip(window.y0..) {
            for (depth, x) in row.iter().zip(window.x0..) {
                let out = &mut nearest[y * whole.width + x];
                *out = if *depth > 0.0 && (*out == 0.0 || depth < out) { *depth } else { *out };
            }
        }
    }
    nearest
}

/// Only the depth is wanted.
struct NoColour;

impl Shader for NoColour {
    fn shade(&self, _: &Surface) -> [f32; 3] {
        [0.0; 3]
    }
}

/// A part of the image.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Window {
    x0: usize,
    y0: usize,
    width: usize,
    height: usize,
}

impl Window {
    /// What an object may cover in any of some poses; the whole image when it reaches behind the camera.
    fn around(object: &Object, poses: &[MatrixPose], image: &EvalImage) -> Self {
        const MARGIN_PX: f64 = 3.0;
        let (width, height) = (f64::from(image.size_px.0), f64::from(image.size_px.1));
        let (mut low, mut high) = (Point2::new(width, height), Point2::new(0.0, 0.0));
        for point in poses.iter().flat_map(|pose| object.hull_m.iter().map(move |p| moved(pose, p))) {
            match image.frame.intrinsics.project(&point) {
                Some(pixel) => (low, high) = (low.inf(&pixel), high.sup(&pixel)),
                None => (low, high) = (Point2::origin(), Point2::new(width, height)),
            }
        }
        let clamp = |v: f64, max: f64| v.clamp(0.0, max) as usize;
        let (x0, y0) = (clamp(low.x - MARGIN_PX, width), clamp(low.y - MARGIN_PX, height));
        let (x1, y1) = (clamp((high.x + MARGIN_PX).ceil(), width), clamp((high.y + MARGIN_PX).ceil(), height));
        Self { x0, y0, width: x1.saturating_sub(x0), height: y1.saturating_sub(y0) }
    }

    /// The camera whose first pixel is the window's.
    fn camera(&self, k: &Intrinsics) -> Intrinsics {
        Intrinsics { cx: k.cx - self.x0 as f64, cy: k.cy - self.y0 as f64, ..*k }
    }

    /// The object's depth as bop_toolkit's OpenGL renderers give it: sampled half a pixel right of and below the
    /// pixel (see [`vsd`]).
    fn render(&self, model: &EvalModel, pose: &MatrixPose, k: &Intrinsics) -> Vec<f32> {
        let k = self.camera(k);
        let k = Intrinsics { cx: k.cx - 0.5, cy: k.cy - 0.5, ..k };
        render(model, pose, &k, self.width as u32, self.height as u32).depth_m
    }

    fn cut(&self, image: &[f32], image_width: usize) -> Vec<f32> {
        let row = |y: usize| &image[y * image_width + self.x0..][..self.width];
        (self.y0..self.y0 + self.height).flat_map(row).copied().collect()
    }
}

/// The silhouette in a square image: not 0 inside.
pub(crate) fn mask(model: &EvalModel, pose: &MatrixPose, k: &Intrinsics, size_px: u32) -> Vec<u8> {
    render(model, pose, k, size_px, size_px).mask
}

fn render(model: &EvalModel, pose: &MatrixPose, k: &Intrinsics, width: u32, height: u32) -> Rendering {
    let mut out = Rendering::new(width, height);
    if width * height == 0 {
        return out;
    }
    let stretched = pose.stretch().map(|by| stretched(&model.depth_mesh, &by));
    let mesh = stretched.as_ref().unwrap_or(&model.depth_mesh);
    let items = [Item { mesh, camera_from_object: pose.pose() }];
    let scene = Scene { items: &items, intrinsics: *k, width, height, background: Background::Colour([0; 3]) };
    render_scene(&scene, &NoColour, &mut Scratch::default(), &mut out);
    out
}

fn moved(pose: &MatrixPose, p: &Point3<f64>) -> Point3<f64> {
    Point3::from(pose.matrix() * p.coords + pose.translation_m())
}

fn stretched(mesh: &Mesh, by: &Matrix3<f64>) -> Mesh {
    let stretch = |v: &[f32; 3]| (by * Vector3::from(v.map(f64::from))).map(|c| c as f32).into();
    Mesh { vertices_m: mesh.vertices_m.iter().map(stretch).collect(), ..mesh.clone() }
}

/// The depths of one object in one image, in each estimated and true pose.
pub(crate) struct Depths {
    window: Window,
    camera: Intrinsics,
    test_m: Vec<f32>,
    est_m: Vec<Vec<f32>>,
    gt_m: Vec<Vec<f32>>,
}

impl Depths {
    pub(crate) fn render(
        image: &EvalImage,
        test: &TestDepth,
        (object, model): (&Object, &EvalModel),
        est: &[MatrixPose],
        gt: &[MatrixPose],
    ) -> Self {
        let all: Vec<MatrixPose> = est.iter().chain(gt).copied().collect();
        let window = Window::around(object, &all, image);
        let k = &image.frame.intrinsics;
        let render = |poses: &[MatrixPose]| poses.iter().map(|pose| window.render(model, pose, k)).collect();
        let test_m = window.cut(&test.depth_m, image.size_px.0 as usize);
        Self { window, camera: window.camera(k), test_m, est_m: render(est), gt_m: render(gt) }
    }

    pub(crate) fn vsd(&self, est: usize, gt: usize, diameter_m: f64) -> [f64; 10] {
        let (est_m, gt_m) = (&self.est_m[est], &self.gt_m[gt]);
        let depths = VsdDepths { width: self.window.width, test_m: &self.test_m, gt_m, est_m };
        vsd(&depths, &self.camera, diameter_m, VSD_DELTA_M, &vsd_taus())
    }
}
