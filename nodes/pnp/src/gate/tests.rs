//! A textured ball, rendered at one pose as the reference and at another as the "real" crop.

use super::{Evidence, Gate, GateConfig, GateReason, GateView};
use nalgebra::{Point2, Vector3};
use pseudoflow_geometry::{Intrinsics, Pose};
use pseudoflow_solver::{PnpError, PnpResult, PnpStatus};

const SIZE: usize = 128;
const K: Intrinsics = Intrinsics { fx: 600.0, fy: 600.0, cx: 63.0, cy: 64.5 };
const RADIUS_M: f64 = 0.06;

struct Picture {
    rgb: Vec<u8>,
    depth_m: Vec<f32>,
}

/// Depth of the ball along a pixel's ray.
fn hit(pose: &Pose, x: usize, y: usize) -> Option<f64> {
    let ray = K.unproject(&Point2::new(x as f64, y as f64), 1.0).coords;
    let c = pose.translation.vector;
    let (a, b) = (ray.norm_squared(), ray.dot(&c));
    let discriminant = b * b - a * (c.norm_squared() - RADIUS_M * RADIUS_M);
    (discriminant > 0.0).then(|| (b - discriminant.sqrt()) / a)
}

fn render(pose: &Pose, texture: f64, background: [u8; 3]) -> Picture {
    let mut out = Picture { rgb: vec![], depth_m: vec![] };
    for (y, x) in (0..SIZE).flat_map(|y| (0..SIZE).map(move |x| (y, x))) {
        let depth = hit(pose, x, y);
        out.depth_m.push(depth.unwrap_or(0.0) as f32);
        let colour = depth.map(|z| {
            let p = pose.inverse() * K.unproject(&Point2::new(x as f64, y as f64), z);
            let wave = (170.0 * p.x).sin() + (190.0 * p.y + 1.0).sin() + (150.0 * p.z - 2.0).cos();
            [wave, wave, -0.5 * wave].map(|w| (128.0 + texture * w) as u8)
        });
        out.rgb.extend(colour.unwrap_or(background));
    }
    out
}

fn initial() -> Pose {
    Pose::new(Vector3::new(0.0, 0.0, 0.7), Vector3::new(0.2, -0.4, 0.1))
}

fn truth() -> Pose {
    Pose::new(Vector3::new(0.004, -0.003, 0.71), Vector3::new(0.15, -0.3, 0.18))
}

fn evidence(texture: f64, refined: &Pose) -> Evidence {
    let reference = render(&initial(), texture, [128; 3]);
    let crop = render(&truth(), 0.6 * texture, [40, 60, 20]);
    let view = GateView {
        size_px: SIZE,
        reference_rgb: &reference.rgb,
        reference_depth_m: &reference.depth_m,
        crop_rgb: &crop.rgb,
        intrinsics: K,
        initial: initial(),
    };
    Gate::new().evidence(&view, refined, 16).unwrap()
}

fn result(inlier_ratio: f64) -> PnpResult {
    PnpResult {
        camera_from_object: truth(),
        covariance: [0.0; 36],
        inlier_ratio,
        inliers: 1000,
        rms_px: 1.0,
        status: PnpStatus::Ok,
    }
}

#[test]
fn the_true_pose_agrees_with_the_pictures_and_is_accepted() {
    let found = evidence(40.0, &truth());
    assert!(found.blocks > 30, "{found:?}");
    // Not 1: blocks with faint texture count for less than their correlation, as sensor noise would drown them.
    assert!(found.photometric_refined > 0.85 && found.photometric_initial < 0.5, "{found:?}");
    assert!(found.silhouette_refined > found.silhouette_initial, "{found:?}");
    let decision = GateConfig::default().decide(&result(0.9), &found, SIZE);
    assert!(decision.accept && decision.reason == GateReason::Passed);
}

#[test]
fn a_worse_pose_is_refused_by_the_pictures() {
    // As far on the other side of the initial pose as the truth is on this side.
    let wrong = initial() * truth().inverse() * initial();
    let found = evidence(40.0, &wrong);
    let decision = GateConfig::default().decide(&result(0.9), &found, SIZE);
    assert!(!decision.accept && matches!(decision.reason, GateReason::Photometric(..)), "{found:?}");
}

#[test]
fn staying_changes_nothing() {
    let found = evidence(40.0, &initial());
    assert!(found.displacement_px < 1e-4 && found.rotation_rad < 1e-9);
    assert!((found.photometric_refined - found.photometric_initial).abs() < 1e-4);
    assert!((found.silhouette_refined - found.silhouette_initial).abs() < 1e-4);
    assert_eq!(found.share_in_view, 1.0);
}

#[test]
fn without_texture_only_the_contour_speaks() {
    let found = evidence(0.0, &truth());
    assert_eq!(found.blocks, 0);
    assert!(GateConfig::default().decide(&result(0.9), &found, SIZE).accept);
    let aside = Pose::new(Vector3::new(-0.015, 0.012, 0.7), Vector3::new(0.2, -0.4, 0.1));
    let decision = GateConfig::default().decide(&result(0.9), &evidence(0.0, &aside), SIZE);
    assert!(matches!(decision.reason, GateReason::Silhouette(..)), "{decision:?}");
}

#[test]
fn few_inliers_without_a_gain_in_the_picture_are_refused() {
    let found = evidence(40.0, &initial());
    let decision = GateConfig::default().decide(&result(0.45), &found, SIZE);
    assert!(matches!(decision.reason, GateReason::Agreement(..)), "{decision:?}");
    assert!(GateConfig::default().decide(&result(0.9), &found, SIZE).accept);
}

#[test]
fn a_texture_that_the_camera_does_not_see_leaves_it_to_the_contour() {
    let found = Evidence { photometric_initial: -0.1, photometric_refined: -0.3, ..evidence(40.0, &truth()) };
    assert!(GateConfig::default().decide(&result(0.9), &found, SIZE).accept);
}

#[test]
fn the_contour_can_carry_a_pose_of_few_inliers() {
    let plain = Evidence { photometric_initial: 0.0, photometric_refined: 0.0, ..evidence(40.0, &initial()) };
    let decide = |silhouette_refined: f64| {
        let found = Evidence { silhouette_initial: 0.4, silhouette_refined, ..plain };
        GateConfig::default().decide(&result(0.45), &found, SIZE)
    };
    assert!(matches!(decide(0.5).reason, GateReason::Agreement(..)));
    assert!(decide(0.9).accept);
}

#[test]
fn each_limit_can_refuse() {
    let found = evidence(40.0, &truth());
    let config = GateConfig::default();
    let refusal = |config: &GateConfig, result: &PnpResult| config.decide(result, &found, SIZE).reason;
    assert!(matches!(refusal(&config, &result(0.1)), GateReason::InlierRatio(..)));
    assert!(matches!(refusal(&config, &result(f64::NAN)), GateReason::InlierRatio(..)));
    let failed = PnpResult { status: PnpStatus::NotFinite, ..result(0.9) };
    assert_eq!(refusal(&config, &failed), GateReason::PnpFailed);
    let needy = GateConfig { min_agreement: 2.0, ..config.clone() };
    assert!(matches!(refusal(&needy, &result(0.9)), GateReason::Agreement(..)));
    // What few inliers carry passes by its gain in the picture.
    assert_eq!(refusal(&config, &result(0.45)), GateReason::Passed);
    let near = GateConfig { max_displacement: 1e-3, ..config.clone() };
    assert!(matches!(refusal(&near, &result(0.9)), GateReason::Displacement(..)));
    let stiff = GateConfig { max_rotation_rad: 1e-3, ..config };
    assert!(matches!(refusal(&stiff, &result(0.9)), GateReason::Rotation(..)));
}

#[test]
fn bad_arguments_are_named() {
    let (rgb, depth) = (vec![0; SIZE * SIZE * 3], vec![0.0; SIZE * SIZE]);
    let view = GateView {
        size_px: SIZE,
        reference_rgb: &rgb,
        reference_depth_m: &depth,
        crop_rgb: &rgb[3..],
        intrinsics: K,
        initial: initial(),
    };
    let mut gate = Gate::new();
    assert!(matches!(gate.evidence(&view, &truth(), 16), Err(PnpError::Plane { plane: "crop_rgb", .. })));
    let view = GateView { crop_rgb: &rgb, ..view };
    assert!(matches!(gate.evidence(&view, &truth(), 0), Err(PnpError::Setting { .. })));
    let empty = gate.evidence(&view, &truth(), 16).unwrap();
    assert_eq!((empty.blocks, empty.contour_points), (0, 0));
    assert!(GateConfig { max_displacement: f64::NAN, ..GateConfig::default() }.validate().is_err());
    assert_eq!(GateConfig::default().validate(), Ok(()));
}
