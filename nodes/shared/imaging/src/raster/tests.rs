use super::*;
use crate::{BACKGROUND_GREY, MeshParts, shapes};
use image::Rgb;
use nalgebra::Vector3;
use std::path::Path;

const K: Intrinsics = Intrinsics { fx: 400.0, fy: 410.0, cx: 63.3, cy: 61.8 };
const SIZE: u32 = 128;

fn render(mesh: Mesh, camera_from_object: Pose, intrinsics: Intrinsics) -> Rendering {
    let mut rasteriser = SoftwareRasteriser::new();
    rasteriser.add_object(1, &Arc::new(mesh)).unwrap();
    let view = View { object_id: 1, camera_from_object, intrinsics, width: SIZE, height: SIZE };
    rasteriser.render(&[view]).unwrap().remove(0)
}

/// The nearer intersection of a pixel's ray with a sphere: depth, and the cosine to the normal.
fn sphere_depth_m(x: u32, y: u32, centre: Vector3<f64>, radius_m: f64) -> Option<(f64, f64)> {
    let ray = K.unproject(&nalgebra::Point2::new(f64::from(x), f64::from(y)), 1.0).coords;
    let (a, b, c) = (ray.norm_squared(), ray.dot(&centre), centre.norm_squared() - radius_m * radius_m);
    let root = b * b - a * c;
    let depth = (root > 0.0).then(|| (b - root.sqrt()) / a)?;
    Some((depth, -ray.normalize().dot(&(ray * depth - centre).normalize())))
}

#[test]
fn a_sphere_has_the_depth_and_outline_of_a_sphere() {
    let centre = Vector3::new(0.01, -0.015, 0.45);
    let pose = Pose::translation(centre.x, centre.y, centre.z);
    let out = render(shapes::sphere(0.05, 200, [200; 3]).unwrap(), pose, K);
    let (mut compared, mut rim) = (0, 0);
    for i in 0..(SIZE * SIZE) {
        let hit = sphere_depth_m(i % SIZE, i / SIZE, centre, 0.05);
        match (hit, out.mask[i as usize]) {
            (Some((depth, facing)), 1) => {
                let error = (f64::from(out.depth_m[i as usize]) - depth).abs();
                assert!(error < if facing > 0.2 { 2e-5 } else { 2e-3 }, "{i}: {error} at {facing}");
                compared += 1;
            }
            (None, 0) => assert_eq!(out.depth_m[i as usize], 0.0),
            _ => rim += 1,
        }
    }
    assert!(compared > 5000 && rim < 8, "{compared} compared, {rim} differ at the rim");
}

#[test]
fn a_slanted_plane_has_the_depth_of_a_plane() {
    let texture = RgbImage::from_pixel(4, 4, Rgb([10, 200, 30]));
    let pose = Pose::translation(0.0, 0.0, 0.5) * Pose::rotation(Vector3::new(0.5, -0.7, 0.2));
    let out = render(shapes::textured_square(1.0, texture).unwrap(), pose, K);
    let normal = pose.rotation * Vector3::z();
    for (i, depth) in out.depth_m.iter().enumerate() {
        let pixel = nalgebra::Point2::new((i % 128) as f64, (i / 128) as f64);
        let ray = K.unproject(&pixel, 1.0).coords;
        let exact = normal.dot(&pose.translation.vector) / normal.dot(&ray);
        assert!((f64::from(*depth) - exact).abs() < 1e-6, "{i}: {depth} {exact}");
    }
}

#[test]
fn pixel_centres_lie_at_whole_numbers() {
    // At z = 1 with f = 100: a square of 11 pixels around (20, 30) covers the centres 15..=25, 25..=35.
    let k = Intrinsics { fx: 100.0, fy: 100.0, cx: 20.0, cy: 30.0 };
    let texture = RgbImage::from_pixel(1, 1, Rgb([0; 3]));
    let out = render(shapes::textured_square(0.11, texture.clone()).unwrap(), Pose::translation(0.0, 0.0, 1.0), k);
    for (i, mask) in out.mask.iter().enumerate() {
        let inside = (15..=25).contains(&(i % 128)) && (25..=35).contains(&(i / 128));
        assert_eq!(*mask == 1, inside, "{} {}", i % 128, i / 128);
    }
    // An edge right through a centre belongs to the left and top: 10 pixels.
    let out = render(shapes::textured_square(0.1, texture).unwrap(), Pose::translation(0.0, 0.0, 1.0), k);
    assert_eq!(out.foreground_px(), 100);
    assert_eq!((out.mask[25 * 128 + 15], out.mask[35 * 128 + 25]), (1, 0));
}

#[test]
fn a_texture_seen_one_to_one_is_read_exactly() {
    let texture = RgbImage::from_fn(32, 32, |x, y| Rgb([(x * 8) as u8, (y * 8) as u8, ((x * 7 + y * 3) % 256) as u8]));
    let mut rasteriser = SoftwareRasteriser::new();
    rasteriser.add_object(1, &Arc::new(shapes::textured_square(0.32, texture.clone()).unwrap())).unwrap();
    // The square covers [9.5, 41.5]: texel i is centred on pixel 10 + i.
    let intrinsics = Intrinsics { fx: 100.0, fy: 100.0, cx: 25.5, cy: 25.5 };
    let camera_from_object = Pose::translation(0.0, 0.0, 1.0);
    let view = View { object_id: 1, camera_from_object, intrinsics, width: 64, height: 64 };
    let out = rasteriser.render_with(0, &view, &Headlight { ambient: 1.0, headlight: 0.0 }).unwrap();
    for (x, y, texel) in texture.enumerate_pixels() {
        let seen = out.rgb.get_pixel(x + 10, y + 10);
        assert!((0..3).all(|k| seen[k].abs_diff(texel[k]) <= 1), "({x}, {y}): {seen:?} {texel:?}");
    }
}

#[test]
fn a_fine_texture_far_away_becomes_its_mean() {
    let texture = RgbImage::from_fn(512, 512, |x, y| Rgb([((x + y) % 2 * 255) as u8; 3]));
    let mut rasteriser = SoftwareRasteriser::new();
    rasteriser.add_object(1, &Arc::new(shapes::textured_square(0.3, texture).unwrap())).unwrap();
    let camera_from_object = Pose::translation(0.0, 0.0, 1.0) * Pose::rotation(Vector3::new(0.0, 1.2, 0.0));
    let view = View { object_id: 1, camera_from_object, intrinsics: K, width: SIZE, height: SIZE };
    let out = rasteriser.render_with(0, &view, &Headlight { ambient: 1.0, headlight: 0.0 }).unwrap();
    let seen = out.rgb.pixels().zip(&out.mask).filter(|(_, m)| **m == 1);
    assert!(seen.clone().count() > 1000);
    assert!(seen.clone().all(|(p, _)| p[0].abs_diff(128) < 12));
}

#[test]
fn triangles_that_share_edges_leave_no_gap() {
    // A fan-rich sphere larger than the image: every pixel must be covered, from the outside and from within.
    let sphere = shapes::sphere(0.5, 60, [200; 3]).unwrap();
    let mut open = sphere.clone();
    open.closed = false;
    let outside = render(sphere, Pose::translation(0.01, 0.02, 0.7), K);
    assert_eq!(outside.foreground_px(), (SIZE * SIZE) as usize);
    let within = render(open, Pose::translation(0.01, 0.02, 0.2), K);
    assert_eq!(within.foreground_px(), (SIZE * SIZE) as usize);
    assert!(within.depth_m.iter().all(|d| *d > 0.5));
}

#[test]
fn what_crosses_the_near_plane_is_cut_there() {
    let texture = RgbImage::from_pixel(1, 1, Rgb([255; 3]));
    // The floor under the camera, from behind it to far before it.
    let pose = Pose::translation(0.0, 0.05, 0.0) * Pose::rotation(Vector3::x() * std::f64::consts::FRAC_PI_2);
    let out = render(shapes::textured_square(4.0, texture).unwrap(), pose, K);
    for (i, (depth, mask)) in out.depth_m.iter().zip(&out.mask).enumerate() {
        let y = (i / 128) as f64;
        let exact = 0.05 * K.fy / (y - K.cy);
        let seen = y > K.cy && exact < 2.0;
        assert_eq!(*mask == 1, seen, "row {y}");
        assert!(!seen || (f64::from(*depth) - exact).abs() < 1e-5 * exact, "row {y}: {depth} {exact}");
    }
    let behind = render(shapes::sphere(0.05, 10, [9; 3]).unwrap(), Pose::translation(0.0, 0.0, -0.5), K);
    assert_eq!(behind.foreground_px(), 0);
    assert!(behind.rgb.as_raw().iter().all(|v| *v == BACKGROUND_GREY));
}

#[test]
fn nearer_items_hide_farther_ones_in_any_order() {
    let near = shapes::cuboid([0.04; 3], [250, 0, 0]).unwrap();
    let far = shapes::cuboid([0.08; 3], [0, 0, 250]).unwrap();
    let items = [
        Item { mesh: &near, camera_from_object: Pose::translation(0.0, 0.0, 0.4) },
        Item { mesh: &far, camera_from_object: Pose::translation(0.0, 0.0, 0.6) },
    ];
    let background = RgbImage::from_pixel(5, 5, Rgb([1, 2, 3]));
    let draw = |items: &[Item<'_>]| {
        let background = Background::Image(&background);
        let scene = Scene { items, intrinsics: K, width: SIZE, height: SIZE, background };
        let mut out = Rendering::new(SIZE, SIZE);
        render_scene(&scene, &Headlight::default(), &mut Scratch::default(), &mut out);
        out
    };
    let (one, other) = (draw(&items), draw(&[items[1], items[0]]));
    assert_eq!(one.rgb, other.rgb);
    assert_eq!(one.depth_m, other.depth_m);
    let swapped: Vec<u8> = other.mask.iter().map(|m| [0, 2, 1][usize::from(*m)]).collect();
    assert_eq!(one.mask, swapped);
    assert!(one.mask.contains(&1) && one.mask.contains(&2));
    assert_eq!(one.rgb.get_pixel(0, 0).0, [1, 2, 3]);
}

#[test]
fn the_same_views_give_the_same_bytes_alone_and_in_parallel() {
    let mut rasteriser = SoftwareRasteriser::new();
    rasteriser.add_object(7, &Arc::new(shapes::sphere(0.05, 40, [180, 90, 20]).unwrap())).unwrap();
    let view = |i: u32| View {
        object_id: 7,
        camera_from_object: Pose::translation(0.002 * f64::from(i), 0.0, 0.4),
        intrinsics: K,
        width: SIZE,
        height: 96,
    };
    let views: Vec<View> = (0..9).map(view).collect();
    let together = rasteriser.render(&views).unwrap();
    assert_eq!(together, rasteriser.render(&views).unwrap());
    for (view, rendering) in views.iter().zip(&together) {
        assert_eq!(&rasteriser.render(&[*view]).unwrap()[0], rendering);
    }
}

#[test]
fn light_falls_off_as_stated() {
    let out = render(shapes::sphere(0.05, 200, [200; 3]).unwrap(), Pose::translation(0.0, 0.0, 0.45), K);
    let centre = out.rgb.get_pixel(63, 62)[0];
    assert!(centre.abs_diff(200) <= 1, "seen frontally: the colour as it is, not {centre}");
    let darkest = out.rgb.pixels().zip(&out.mask).filter(|(_, m)| **m == 1).map(|(p, _)| p[0]).min().unwrap();
    assert!((120..136).contains(&darkest), "edge-on: 60 % of it, not {darkest}");
}

#[test]
fn bad_views_are_refused_by_name() {
    let mut rasteriser = SoftwareRasteriser::new();
    rasteriser.add_object(7, &Arc::new(shapes::cuboid([0.1; 3], [9; 3]).unwrap())).unwrap();
    let good = View { object_id: 7, camera_from_object: Pose::identity(), intrinsics: K, width: 8, height: 8 };
    let error = |view| rasteriser.render(&[good, view]).unwrap_err();
    assert_eq!(error(View { object_id: 3, ..good }), RasterError::UnknownObject { object_id: 3, known: vec![7] });
    assert_eq!(error(View { width: 0, ..good }), RasterError::Size { width: 0, height: 8 });
    let nan = Pose::translation(f64::NAN, 0.0, 1.0);
    assert!(matches!(error(View { camera_from_object: nan, ..good }), RasterError::NotFinite { view: 1, .. }));
    let intrinsics = Intrinsics { fx: 0.0, ..K };
    assert!(matches!(error(View { intrinsics, ..good }), RasterError::NotFinite { view: 1, .. }));
}

/// Wide triangles are filled by spans, narrow ones sample by sample: both cover what lies inside, and nothing else.
#[test]
fn samples_inside_a_triangle_are_covered_and_others_are_not() {
    let k = Intrinsics { fx: 100.0, fy: 100.0, cx: 60.0, cy: 50.0 };
    for number in 0..60 {
        let random =
            |i: u32| (f64::from((number * 7 + i).wrapping_mul(2_654_435_761) >> 8) / f64::from(1 << 24)) as f32;
        let spread = if number % 2 == 0 { 1.6 } else { 0.12 };
        let corner =
            |i: u32| [spread * (random(2 * i) - 0.5), spread * (random(2 * i + 1) - 0.5), 0.9 + 0.3 * random(6 + i)];
        let vertices_m = vec![corner(0), corner(1), corner(2)];
        let parts = MeshParts { vertices_m: vertices_m.clone(), triangles: vec![[0, 1, 2]], ..MeshParts::default() };
        let mesh = Mesh::new(parts, Path::new("(triangle)")).unwrap();
        let item = Item { mesh: &mesh, camera_from_object: Pose::identity() };
        let background = Background::Colour([0; 3]);
        let scene = Scene { items: &[item], intrinsics: k, width: 120, height: 100, background };
        let mut seen = Scratch::default();
        seen.cover(&scene);
        let points = [0, 1, 2].map(|i| k.project(&nalgebra::Point3::from(vertices_m[i].map(f64::from))).unwrap());
        let side = |a: usize, b: usize, x: f64, y: f64| {
            let (u, v) = (points[b] - points[a], nalgebra::Vector2::new(x - points[a].x, y - points[a].y));
            (u.x * v.y - u.y * v.x) / u.norm().max(1e-9)
        };
        for i in 0..120 * 100_u32 {
            let (x, y) = (f64::from(i % 120), f64::from(i / 120));
            let away = [side(0, 1, x, y), side(1, 2, x, y), side(2, 0, x, y)];
            // Within a hundredth of a pixel of an edge's line the fixed-point places decide.
            if away.iter().all(|d| d.abs() > 0.01) {
                let inside = away.iter().all(|d| *d > 0.0) || away.iter().all(|d| *d < 0.0);
                assert_eq!(seen.owners()[i as usize] == 1, inside, "triangle {number}, sample {x} {y}: {away:?}");
            }
        }
    }
}
