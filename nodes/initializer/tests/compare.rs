//! Render and compare on renderings whose pose is known: another light, another background, a rough place.

use nalgebra::{Point2, Translation3, UnitQuaternion, Vector2, Vector3};
use pseudoflow_geometry::{Intrinsics, Pose, rotation_angle_rad};
use pseudoflow_imaging::raster::{Rasteriser, SoftwareRasteriser, View};
use pseudoflow_imaging::{Object, ObjectSet, RgbImage};
use pseudoflow_inference::{Backend, EngineConfig};
use pseudoflow_initializer::detect::Rectangle;
use pseudoflow_initializer::{CompareConfig, Comparer};
use std::path::{Path, PathBuf};

const K: Intrinsics = Intrinsics { fx: 600.0, fy: 600.0, cx: 319.5, cy: 239.5 };

fn config(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config").join(path)
}

/// The object before stripes, darker and warmer than it is rendered.
fn photograph(rasteriser: &SoftwareRasteriser, object: &Object, pose: &Pose) -> RgbImage {
    let view = View { object_id: object.id, camera_from_object: *pose, intrinsics: K, width: 640, height: 480 };
    let rendering = rasteriser.render(&[view]).unwrap().remove(0);
    let mut image = rendering.rgb;
    for (i, pixel) in image.pixels_mut().enumerate() {
        let (x, y) = (i % 640, i / 640);
        pixel.0 = match rendering.mask[i] {
            0 => [[150, 140, 120], [90, 110, 100]][(x / 23 + y / 17) % 2],
            _ => [0, 1, 2].map(|k| (f32::from(pixel.0[k]) * [0.85, 0.75, 0.65][k]) as u8),
        };
    }
    image
}

/// The rectangle around the projection.
fn place(object: &Object, pose: &Pose) -> Rectangle {
    let seen: Vec<Point2<f64>> = object.hull_m.iter().map(|p| K.project(&(pose * p)).unwrap()).collect();
    let range = |k: usize| seen.iter().fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(p[k]), h.max(p[k])));
    let (x, y) = (range(0), range(1));
    let middle_px = Point2::new((x.0 + x.1) / 2.0, (y.0 + y.1) / 2.0);
    Rectangle { middle_px, size_px: Vector2::new(x.1 - x.0, y.1 - y.0) }
}

#[test]
fn the_most_similar_view_is_near_the_true_pose() {
    let objects = ObjectSet::load(&config("objects/tabletop")).unwrap();
    let engine = EngineConfig { backend: Backend::Rten, ..EngineConfig::default() };
    let model = CompareConfig::new(config("weights/nano_tabletop.safetensors"));
    let mut comparer = Comparer::open(&model, &objects, &engine).unwrap();
    let mut rasteriser = SoftwareRasteriser::new();
    let object = objects.get(1).unwrap();
    rasteriser.add_object(object.id, &object.mesh).unwrap();
    let (mut turns_deg, mut away_m) = (Vec::new(), Vec::new());
    for i in 0..9 {
        let i = f64::from(i);
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(1.1 * i, 0.7 * i - 2.0, 0.4 * i));
        let truth = Pose::from_parts(Translation3::new(0.03 * i - 0.1, 0.05, 0.9), rotation);
        let image = photograph(&rasteriser, object, &truth);
        // As a detector gives it: off by some pixels, and too large or too small.
        let seen = place(object, &truth);
        let rough = Rectangle {
            middle_px: seen.middle_px + Vector2::new(6.0, -5.0),
            size_px: seen.size_px * (0.92 + 0.02 * i),
        };
        let glance = comparer.glance(&image, object, &rough).unwrap();
        let beside = Rectangle { middle_px: rough.middle_px + 1.5 * Vector2::new(rough.side_px(), 0.0), ..rough };
        // The first look ranks the places of an image.
        let elsewhere = comparer.glance(&image, object, &beside).unwrap();
        assert!(glance.similarity() > elsewhere.similarity(), "{glance:?} {elsewhere:?}");
        let best = comparer.best(&image, &K, object, &glance).unwrap()[0];
        away_m.push((best.camera_from_object.translation.vector - truth.translation.vector).norm());
        turns_deg.push(rotation_angle_rad(&best.camera_from_object, &truth).to_degrees());
        assert_eq!(comparer.best(&image, &K, object, &glance).unwrap()[0], best, "the same twice");
    }
    turns_deg.sort_by(f64::total_cmp);
    away_m.sort_by(f64::total_cmp);
    // The rendered views are 20 to 30 degrees apart, the last steps between them 2.5. Of the nine, a median of 5 degrees and 1.2 cm
    // was seen, at a place that is up to 8 % too small or too large: at 0.9 m up to 7 cm of depth.
    assert!(turns_deg[4] < 8.0, "{turns_deg:?}");
    assert!(away_m[4] < 0.02, "{away_m:?}");
}

#[test]
fn settings_out_of_range_and_missing_weights_are_named() {
    let good = CompareConfig::new(config("weights/nano_tabletop.safetensors"));
    assert!(good.check().is_ok());
    let bad = CompareConfig { turns: 1, ..good.clone() };
    assert!(bad.check().unwrap_err().to_string().contains("compare.turns"));
    let bad = CompareConfig { steps_deg: vec![10.0, -1.0], ..good.clone() };
    assert!(bad.check().unwrap_err().to_string().contains("compare.steps_deg"));
    let missing = CompareConfig { model: config("weights/none.safetensors"), ..good };
    assert!(missing.check().unwrap_err().to_string().contains("no such file"));
}
