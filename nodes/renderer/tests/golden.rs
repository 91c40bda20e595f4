//! The GPU rasteriser against the software rasteriser and against a shape whose depth is known.
//!
//! Without a Vulkan or Metal driver these tests print SKIPPED. Debian's `mesa-vulkan-drivers` (lavapipe) is enough.
//! `PSEUDOFLOW_REQUIRE_ADAPTER=1` makes a missing driver a failure.

use image::Rgb;
use nalgebra::Vector3;
use pseudoflow_geometry::{Crop, Intrinsics, Pose};
use pseudoflow_imaging::raster::{RasterError, Rasteriser, Rendering, SoftwareRasteriser, View};
use pseudoflow_imaging::{Mesh, ObjectSet, RgbImage, shapes};
use pseudoflow_renderer::{AdapterChoice, GpuRasteriser};
use std::path::{Path, PathBuf};
use std::sync::Arc;

const K: Intrinsics = Intrinsics { fx: 400.0, fy: 410.0, cx: 63.3, cy: 61.8 };
const SIZE: u32 = 128;

/// The two rasterisers with the same meshes, which have the ids 0, 1 and so on; `None` without a driver.
fn both(meshes: &[Arc<Mesh>]) -> Option<(SoftwareRasteriser, GpuRasteriser)> {
    let mut gpu = match GpuRasteriser::open(AdapterChoice::Any) {
        Ok(gpu) => gpu,
        Err(reason) => {
            assert!(std::env::var_os("PSEUDOFLOW_REQUIRE_ADAPTER").is_none(), "{reason}");
            eprintln!("SKIPPED: {reason}");
            return None;
        }
    };
    eprintln!("adapter: {}", gpu.name());
    let mut software = SoftwareRasteriser::new();
    for (id, mesh) in meshes.iter().enumerate() {
        software.add_object(id as u32, mesh).unwrap();
        gpu.add_object(id as u32, mesh).unwrap();
    }
    Some((software, gpu))
}

fn view(object_id: u32, camera_from_object: Pose) -> View {
    View { object_id, camera_from_object, intrinsics: K, width: SIZE, height: SIZE }
}

fn patterned() -> RgbImage {
    RgbImage::from_fn(200, 170, |x, y| {
        let wave = |a: u32, period: f64| (127.0 + 100.0 * (f64::from(a) / period).sin()) as u8;
        Rgb([wave(x, 5.0), wave(y, 9.0), wave(x + 2 * y, 31.0)])
    })
}

/// Whether all pixels around a pixel (itself included) have the given mask.
fn surrounded(rendering: &Rendering, x: u32, y: u32, by: u8) -> bool {
    let near = |v: u32, size: u32| v.saturating_sub(1)..=(v + 1).min(size - 1);
    let (width, height) = (rendering.width(), rendering.height());
    near(y, height).all(|y| near(x, width).all(|x| rendering.mask[(y * width + x) as usize] == by))
}

/// Whether the depth around a pixel bends: an edge or a crease, where neighbouring pixels see other triangles.
fn bends(rendering: &Rendering, x: u32, y: u32) -> bool {
    let at = |x: u32, y: u32| rendering.depth_m[(y * rendering.width() + x) as usize];
    let bend = |a: f32, b: f32, c: f32| (a + c - 2.0 * b).abs() > 5e-4;
    bend(at(x - 1, y), at(x, y), at(x + 1, y)) || bend(at(x, y - 1), at(x, y), at(x, y + 1))
}

/// Depth within 0.1 mm away from edges, silhouettes within a pixel, colours alike.
fn assert_alike(software: &Rendering, gpu: &Rendering, name: &str) {
    let (width, height) = (software.width(), software.height());
    let (mut compared, mut colour_sum, mut deepest) = (0_u32, 0_u64, 0.0_f32);
    for (x, y) in (1..height - 1).flat_map(|y| (1..width - 1).map(move |x| (x, y))) {
        let i = (y * width + x) as usize;
        if software.mask[i] != gpu.mask[i] {
            assert!(!surrounded(software, x, y, 0) && !surrounded(software, x, y, 1), "{name}: silhouette at {x}, {y}");
        }
        if !surrounded(software, x, y, 1) || !surrounded(gpu, x, y, 1) {
            continue;
        }
        compared += 1;
        let (a, b) = (software.rgb.get_pixel(x, y), gpu.rgb.get_pixel(x, y));
        colour_sum += (0..3).map(|k| u64::from(a[k].abs_diff(b[k]))).sum::<u64>();
        if !bends(software, x, y) {
            deepest = deepest.max((software.depth_m[i] - gpu.depth_m[i]).abs());
        }
    }
    let mean_colour = colour_sum as f64 / f64::from(3 * compared.max(1));
    eprintln!("{name}: {compared} px, depth within {:.4} mm, mean colour difference {mean_colour:.3}", deepest * 1e3);
    assert!(compared > 500, "{name}: only {compared} pixels to compare");
    assert!(deepest < 1e-4, "{name}: depths differ by {deepest} m");
    assert!(mean_colour < 1.0, "{name}: colours differ by {mean_colour} of 255");
}

fn poses() -> Vec<Pose> {
    let turned = |i: f64| Pose::rotation(Vector3::new(0.9 * i, 0.4 - 0.7 * i, 0.3 * i));
    (0..5).map(|i| Pose::translation(0.004 * f64::from(i), -0.01, 0.4) * turned(f64::from(i))).collect()
}

fn compare(meshes: &[Arc<Mesh>], views: &[View], name: &str) {
    let Some((software, gpu)) = both(meshes) else { return };
    let pairs = software.render(views).unwrap().into_iter().zip(gpu.render(views).unwrap());
    pairs.enumerate().for_each(|(i, (a, b))| assert_alike(&a, &b, &format!("{name} {i}")));
}

#[test]
fn boxes_and_spheres_look_alike() {
    let cuboid = Arc::new(shapes::cuboid([0.05, 0.07, 0.09], [200, 60, 20]).unwrap());
    let sphere = Arc::new(shapes::sphere(0.05, 100, [20, 90, 220]).unwrap());
    let views: Vec<View> = poses().into_iter().flat_map(|p| [view(0, p), view(1, p)]).collect();
    compare(&[cuboid, sphere], &views, "shapes");
}

#[test]
fn textures_near_and_far_look_alike() {
    let square = Arc::new(shapes::textured_square(0.1, patterned()).unwrap());
    let tilts = [(0.0, 0.0, 0.4), (0.5, 0.2, 0.5), (1.1, 0.0, 0.35), (0.3, -1.0, 0.4), (0.2, 0.1, 0.9)];
    let pose = |&(a, b, z): &(f64, f64, f64)| Pose::translation(0.0, 0.0, z) * Pose::rotation(Vector3::new(a, b, 0.3));
    let views: Vec<View> = tilts.iter().map(|t| view(0, pose(t))).collect();
    compare(&[square], &views, "texture");
}

#[test]
fn a_sphere_on_the_gpu_has_the_depth_of_a_sphere() {
    let Some((_, gpu)) = both(&[Arc::new(shapes::sphere(0.05, 200, [200; 3]).unwrap())]) else { return };
    let centre = Vector3::new(0.01, -0.015, 0.45);
    let out = gpu.render(&[view(0, Pose::translation(centre.x, centre.y, centre.z))]).unwrap().remove(0);
    let (mut compared, mut rim) = (0, 0);
    for i in 0..SIZE * SIZE {
        let pixel = nalgebra::Point2::new(f64::from(i % SIZE), f64::from(i / SIZE));
        let ray = K.unproject(&pixel, 1.0).coords;
        let (a, b) = (ray.norm_squared(), ray.dot(&centre));
        let root = b * b - a * (centre.norm_squared() - 0.0025);
        if (root > 0.0) != (out.mask[i as usize] == 1) {
            rim += 1;
        } else if root > 0.0 {
            let depth = (b - root.sqrt()) / a;
            let facing = -ray.normalize().dot(&(ray * depth - centre).normalize());
            let error = (f64::from(out.depth_m[i as usize]) - depth).abs();
            assert!(facing < 0.2 || error < 1e-4, "{i}: {error}");
            compared += 1;
        }
    }
    assert!(compared > 5000 && rim < 16, "{compared} compared, {rim} differ at the rim");
}

#[test]
fn pixel_centres_lie_at_whole_numbers_on_the_gpu() {
    let texture = RgbImage::from_pixel(1, 1, Rgb([0; 3]));
    let Some((_, gpu)) = both(&[Arc::new(shapes::textured_square(0.11, texture).unwrap())]) else { return };
    let intrinsics = Intrinsics { fx: 100.0, fy: 100.0, cx: 20.0, cy: 30.0 };
    let out = gpu.render(&[View { intrinsics, ..view(0, Pose::translation(0.0, 0.0, 1.0)) }]).unwrap().remove(0);
    for (i, mask) in out.mask.iter().enumerate() {
        let inside = (15..=25).contains(&(i % 128)) && (25..=35).contains(&(i / 128));
        assert_eq!(*mask == 1, inside, "{} {}", i % 128, i / 128);
    }
}

#[test]
fn the_floor_is_cut_at_the_near_plane_alike() {
    let square = Arc::new(shapes::textured_square(4.0, RgbImage::from_pixel(1, 1, Rgb([255; 3]))).unwrap());
    let pose = Pose::translation(0.0, 0.05, 0.0) * Pose::rotation(Vector3::x() * std::f64::consts::FRAC_PI_2);
    let Some((software, gpu)) = both(&[square]) else { return };
    let (a, b) =
        (software.render(&[view(0, pose)]).unwrap().remove(0), gpu.render(&[view(0, pose)]).unwrap().remove(0));
    assert_eq!(a.mask, b.mask);
    let relative = a.depth_m.iter().zip(&b.depth_m).map(|(a, b)| (a - b).abs() / a.max(0.01)).fold(0.0, f32::max);
    assert!(relative < 2e-4, "{relative}");
}

#[test]
fn the_same_views_give_the_same_bytes_in_any_size_and_batch() {
    let sphere = Arc::new(shapes::sphere(0.05, 40, [180, 90, 20]).unwrap());
    let Some((_, gpu)) = both(&[sphere]) else { return };
    let sized = |(i, pose): (usize, Pose)| View { width: 64 + 32 * (i as u32 % 2), height: 65, ..view(0, pose) };
    let views: Vec<View> = poses().into_iter().cycle().take(40).enumerate().map(sized).collect();
    let together = gpu.render(&views).unwrap();
    assert_eq!(together, gpu.render(&views).unwrap());
    for (view, rendering) in views.iter().zip(&together).take(7) {
        assert_eq!((rendering.width(), rendering.height()), (view.width, view.height));
        assert_eq!(&gpu.render(&[*view]).unwrap()[0], rendering);
    }
}

#[test]
fn bad_views_are_refused_on_the_gpu_as_well() {
    let Some((_, gpu)) = both(&[Arc::new(shapes::cuboid([0.1; 3], [9; 3]).unwrap())]) else { return };
    let good = view(0, Pose::translation(0.0, 0.0, 0.5));
    assert!(matches!(gpu.render(&[View { object_id: 4, ..good }]), Err(RasterError::UnknownObject { .. })));
    assert!(matches!(gpu.render(&[View { height: 0, ..good }]), Err(RasterError::Size { .. })));
    let pose = Pose::translation(0.0, f64::INFINITY, 0.5);
    assert!(matches!(gpu.render(&[good, view(0, pose)]), Err(RasterError::NotFinite { view: 1, .. })));
    assert_eq!(gpu.render(&[good]).unwrap().len(), 1, "it still works");
}

#[test]
fn scanned_objects_look_alike() {
    let shared = std::env::var_os("PSEUDOFLOW_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"), PathBuf::from);
    for name in ["tabletop", "lmo_frame"] {
        let folder = shared.join("data").join(name).join("models");
        if !folder.is_dir() {
            eprintln!("SKIPPED: {} is not there (set PSEUDOFLOW_SHARED)", folder.display());
            continue;
        }
        let set = ObjectSet::load(&folder).unwrap();
        let meshes: Vec<Arc<Mesh>> = set.iter().map(|o| Arc::clone(&o.mesh)).collect();
        let of = |(i, pose): (usize, Pose)| {
            let pose = Pose::translation(0.0, 0.0, 0.5) * pose;
            let object = set.iter().nth(i % set.len()).unwrap();
            let crop = Crop::around(&object.hull_m, &pose, &K, 1.1, SIZE).unwrap();
            View { intrinsics: crop.intrinsics(&K), ..view((i % set.len()) as u32, pose) }
        };
        let views: Vec<View> = poses().into_iter().cycle().take(set.len()).enumerate().map(of).collect();
        compare(&meshes, &views, name);
    }
}
