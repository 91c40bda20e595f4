//! The viewpoint model: where the contour of an object is, seen from each of many sides.
//!
//! Made once from the mesh by rendering its depth from directions spread over the sphere (ICG, arXiv 2203.05334, section 3.2),
//! at one distance in diameters. Nothing is rendered when a pose is refined.

use crate::ContourError;
use crate::icosphere::directions;
use crate::outline::{Curve, Mask, smooth};
use bytemuck::{Pod, Zeroable};
use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use pseudoflow_geometry::{Intrinsics, Pose};
use pseudoflow_imaging::Mesh;
use pseudoflow_imaging::raster::{Background, Item, Scene, Scratch};
use rayon::prelude::*;

/// How a model is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelSettings {
    /// How often the faces of an icosahedron are divided: 3 gives 642 views, 4 gives 2562.
    pub divisions: u32,
    /// Contour points of a view.
    pub points: usize,
    /// Distance of the camera from the object's middle, diameters.
    pub distance: f64,
    /// Side of the renderings, pixels.
    pub size_px: u32,
}

impl Default for ModelSettings {
    fn default() -> Self {
        Self { divisions: 3, points: 200, distance: 5.0, size_px: 160 }
    }
}

/// A point of the contour.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct ContourPoint {
    /// In the object's frame, metres.
    pub position_m: [f32; 3],
    /// Unit vector away from the object, in the image plane of the view, in the object's frame.
    pub normal: [f32; 3],
    /// How far the object reaches inwards without a gap, metres at the point's distance.
    pub inside_m: f32,
    /// How far the background reaches outwards without the object, metres at the point's distance.
    pub outside_m: f32,
}

/// Contour points of an object from all sides.
#[derive(Debug, Clone, PartialEq)]
pub struct ContourModel {
    /// Unit vectors from the object's middle to the camera, in the object's frame; one for each view.
    pub(crate) directions: Vec<[f32; 3]>,
    /// Where the points of each view begin, and where the last ones end.
    pub(crate) starts: Vec<u32>,
    pub(crate) points: Vec<ContourPoint>,
    /// The middle of the object, metres in its frame.
    pub(crate) centre_m: [f32; 3],
    /// Radius of a sphere around the middle that holds the object, metres.
    pub(crate) radius_m: f32,
}

/// What lies further away than this counts as that far, in radii.
const FARTHEST: f32 = 1.0;
/// Shorter outlines are specks or pinholes, as a share of the rendering's side.
const SHORTEST: f32 = 0.08;

impl ContourModel {
    /// Renders the mesh from all sides, in parallel.
    ///
    /// # Errors
    /// [`ContourError::Mesh`] when the mesh has no extent or nothing of it is seen from a side.
    pub fn new(mesh: &Mesh, settings: &ModelSettings) -> Result<Self, ContourError> {
        let (low, high) = mesh.bounds_m();
        let centre = nalgebra::center(&low, &high);
        let radius_m = mesh.points().iter().map(|p| (p - centre).norm()).fold(0.0, f64::max);
        if !(radius_m.is_finite() && radius_m > 1e-4) {
            return Err(ContourError::Mesh { what: format!("it measures {} m", 2.0 * radius_m) });
        }
        let directions = directions(settings.divisions);
        let camera = ViewCamera::new(radius_m, settings);
        let views: Vec<Vec<ContourPoint>> = directions
            .par_iter()
            .map_init(Buffers::default, |buffers, d| camera.view(mesh, &centre, d, settings.points, buffers))
            .collect();
        if let Some(i) = views.iter().position(Vec::is_empty) {
            let what = format!("nothing of it is seen from {:?}", directions[i]);
            return Err(ContourError::Mesh { what });
        }
        let mut starts = vec![0];
        starts.extend(views.iter().scan(0, |sum, v| {
            *sum += v.len() as u32;
            Some(*sum)
        }));
        Ok(Self {
            directions,
            starts,
            points: views.concat(),
            centre_m: [centre.x, centre.y, centre.z].map(|v| v as f32),
            radius_m: radius_m as f32,
        })
    }

    /// The contour points of the view nearest to that of a pose.
    #[must_use]
    pub fn view(&self, camera_from_object: &Pose) -> &[ContourPoint] {
        let centre = Point3::from(self.centre_m.map(f64::from));
        let towards = (camera_from_object.inverse_transform_point(&Point3::origin()) - centre).normalize();
        let towards = [towards.x as f32, towards.y as f32, towards.z as f32];
        let along = |d: &[f32; 3]| d[0] * towards[0] + d[1] * towards[1] + d[2] * towards[2];
        let (mut best, mut best_along) = (0, f32::MIN);
        for (i, direction) in self.directions.iter().enumerate() {
            let value = along(direction);
            if value > best_along {
                (best, best_along) = (i, value);
            }
        }
        &self.points[self.starts[best] as usize..self.starts[best + 1] as usize]
    }

    /// The middle of the object, metres in its frame.
    #[must_use]
    pub fn centre_m(&self) -> Point3<f64> {
        Point3::from(self.centre_m.map(f64::from))
    }

    /// Radius of a sphere around the middle that holds the object, metres.
    #[must_use]
    pub fn radius_m(&self) -> f64 {
        f64::from(self.radius_m)
    }

    /// How many views there are.
    #[must_use]
    pub fn views(&self) -> usize {
        self.directions.len()
    }
}

/// The camera of all views.
struct ViewCamera {
    intrinsics: Intrinsics,
    size_px: u32,
    distance_m: f64,
    radius_m: f64,
}

#[derive(Default)]
struct Buffers {
    scratch: Scratch,
    depth_m: Vec<f32>,
}

impl ViewCamera {
    fn new(radius_m: f64, settings: &ModelSettings) -> Self {
        let distance_m = 2.0 * radius_m * settings.distance;
        let half = f64::from(settings.size_px) / 2.0;
        // The sphere is seen under this tangent; four pixels stay free.
        let focal = (half - 4.0) * (distance_m.powi(2) - radius_m.powi(2)).sqrt() / radius_m;
        let intrinsics = Intrinsics { fx: focal, fy: focal, cx: half - 0.5, cy: half - 0.5 };
        Self { intrinsics, size_px: settings.size_px, distance_m, radius_m }
    }

    fn view(
        &self,
        mesh: &Mesh,
        centre: &Point3<f64>,
        towards: &[f32; 3],
        count: usize,
        buffers: &mut Buffers,
    ) -> Vec<ContourPoint> {
        let pose = looking_along(&-Vector3::from(towards.map(f64::from)), centre, self.distance_m);
        let scene = Scene {
            items: &[Item { mesh, camera_from_object: pose }],
            intrinsics: self.intrinsics,
            width: self.size_px,
            height: self.size_px,
            background: Background::Colour([0; 3]),
        };
        buffers.scratch.cover(&scene);
        buffers.depth_m.clear();
        buffers.depth_m.extend(buffers.scratch.inverse_depths().iter().map(|i| if *i > 0.0 { 1.0 / i } else { 0.0 }));
        let mask = Mask { inside: buffers.scratch.owners(), size_px: self.size_px as i32 };
        let shortest = SHORTEST * self.size_px as f32;
        let curves: Vec<Curve> =
            mask.outlines().iter().filter(|o| o.len() as f32 > shortest).map(|o| smooth(o)).collect();
        let seen = Seen { camera: self, mask, depth_m: &buffers.depth_m, object_from_camera: pose.inverse() };
        spread(&curves, count).map(|(curve, i)| seen.point(curve, i)).collect()
    }
}

/// A rendering that contour points are read from.
struct Seen<'a> {
    camera: &'a ViewCamera,
    mask: Mask<'a>,
    depth_m: &'a [f32],
    object_from_camera: Pose,
}

impl Seen<'_> {
    fn point(&self, curve: &Curve, i: usize) -> ContourPoint {
        let (at, normal) = (curve.points[i], curve.normals[i]);
        let depth_m = self.rim_depth_m(at, normal);
        let k = &self.camera.intrinsics;
        let point = k.unproject(&nalgebra::Point2::new(f64::from(at[0]), f64::from(at[1])), depth_m);
        let metres_per_px = (depth_m / k.fx) as f32;
        let farthest = FARTHEST * self.camera.radius_m as f32;
        let run = |sign: f32, inside: bool| {
            let steps = (farthest / metres_per_px) as usize;
            let place = |s: usize| [0, 1].map(|a| (at[a] + sign * (s as f32 + 0.5) * normal[a]).round() as i32);
            let found = (0..steps).find(|&s| self.mask.is_inside(place(s)[0], place(s)[1]) != inside);
            found.map_or(farthest, |s| s as f32 * metres_per_px)
        };
        let in_object =
            self.object_from_camera.rotation * Vector3::new(f64::from(normal[0]), f64::from(normal[1]), 0.0);
        let position = self.object_from_camera * point;
        ContourPoint {
            position_m: [position.x as f32, position.y as f32, position.z as f32],
            normal: [in_object.x as f32, in_object.y as f32, in_object.z as f32],
            inside_m: run(-1.0, true),
            outside_m: run(1.0, false),
        }
    }

    /// Depth at the contour itself. Towards the rim of a rounded surface it falls off with the root of the distance, so it is
    /// continued from the first pixels inside; at the edge of a flat one that changes next to nothing.
    fn rim_depth_m(&self, at: [f32; 2], normal: [f32; 2]) -> f64 {
        let within = |s: f32| {
            let (x, y) = ((at[0] - s * normal[0]).round() as i32, (at[1] - s * normal[1]).round() as i32);
            let depth = self.mask.is_inside(x, y).then(|| self.depth_m[(y * self.mask.size_px + x) as usize])?;
            let inwards = (at[0] - x as f32) * normal[0] + (at[1] - y as f32) * normal[1];
            Some((f64::from(depth), f64::from(inwards.max(0.1))))
        };
        let first = [0.5, 1.0, 1.5, 2.5, 4.0, 8.0].into_iter().find_map(|s| within(s).map(|w| (w, s)));
        let Some(((near, s1), taken)) = first else { return self.camera.distance_m };
        let Some((far, s2)) = within(taken + 1.7) else { return near };
        let step = near - far;
        if s2 <= s1 + 0.5 || step <= 0.0 || step > 0.15 * self.camera.radius_m {
            return near;
        }
        near + (step * s1.sqrt() / (s2.sqrt() - s1.sqrt())).min(0.15 * self.camera.radius_m)
    }
}

/// `count` places spread evenly over curves: curve and index.
fn spread(curves: &[Curve], count: usize) -> impl Iterator<Item = (&Curve, usize)> {
    let length = |c: &Curve, i: usize| {
        let (a, b) = (c.points[i], c.points[(i + 1) % c.points.len()]);
        (b[0] - a[0]).hypot(b[1] - a[1])
    };
    let total: f32 = curves.iter().map(|c| (0..c.points.len()).map(|i| length(c, i)).sum::<f32>()).sum();
    let step = total / count as f32;
    let (mut passed, mut next) = (0.0, 0.5 * step);
    curves.iter().flat_map(|c| (0..c.points.len()).map(move |i| (c, i))).filter(move |(c, i)| {
        passed += length(c, *i);
        let taken = passed >= next;
        if taken {
            next += step;
        }
        taken
    })
}

/// The pose of an object whose middle lies `distance_m` before a camera that looks along `forward` (object's frame).
fn looking_along(forward: &Vector3<f64>, centre: &Point3<f64>, distance_m: f64) -> Pose {
    let other = if forward.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
    let right = forward.cross(&other).normalize();
    let down = forward.cross(&right);
    let rows = Matrix3::from_rows(&[right.transpose(), down.transpose(), forward.transpose()]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rows));
    let translation = Vector3::new(0.0, 0.0, distance_m) - rotation * centre.coords;
    Pose::from_parts(translation.into(), rotation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_imaging::shapes::{cuboid, sphere};

    const FEW: ModelSettings = ModelSettings { divisions: 1, points: 100, distance: 5.0, size_px: 160 };

    #[test]
    fn the_contour_of_a_sphere_is_its_rim() {
        let model = ContourModel::new(&sphere(0.05, 64, [9; 3]).unwrap(), &FEW).unwrap();
        assert_eq!(model.views(), 42);
        for (i, d) in model.directions.iter().enumerate() {
            let points = &model.points[model.starts[i] as usize..model.starts[i + 1] as usize];
            assert!((95..=100).contains(&points.len()));
            for p in points {
                let radius = p.position_m.iter().map(|v| v * v).sum::<f32>().sqrt();
                assert!((radius - 0.05).abs() < 0.001, "{radius}");
                let along: f32 = (0..3).map(|k| p.position_m[k] * d[k]).sum();
                assert!((along / 0.05 - 0.1).abs() < 0.12, "the rim lies at r / D = 0.1 towards the camera: {along}");
                assert!(p.inside_m > 0.045 && p.outside_m > 0.045);
            }
        }
    }

    #[test]
    fn a_pose_finds_the_view_it_looks_from() {
        let model = ContourModel::new(&cuboid([0.1, 0.06, 0.03], [9; 3]).unwrap(), &FEW).unwrap();
        for (i, d) in model.directions.iter().enumerate() {
            let pose = looking_along(&-Vector3::from(d.map(f64::from)), &model.centre_m(), 0.7);
            assert_eq!(model.view(&pose).as_ptr(), model.points[model.starts[i] as usize..].as_ptr());
        }
    }

    #[test]
    fn a_mesh_without_extent_is_refused() {
        let dot = cuboid([0.0; 3], [9; 3]).unwrap();
        assert!(matches!(ContourModel::new(&dot, &FEW), Err(ContourError::Mesh { .. })));
    }
}
