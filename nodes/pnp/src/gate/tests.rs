//! A textured ball, rendered at one pose as the reference and at another as the "real" crop.

use super::{
    CovarianceScale, Decision, Evidence, Feature, Features, Gate, GateConfig, GateModel, GateReason, GateView, Scale,
    Stage, Verdict,
};
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

const SCALE: Scale =
    Scale { size_px: SIZE, crop_side_px: 64.0, threshold_px: 1.5, diameter_m: 2.0 * RADIUS_M, initial_depth_m: 0.7 };

/// As the node decides, by the model of the binary.
fn decide(config: &GateConfig, result: &PnpResult, evidence: &Evidence) -> Decision {
    let model = config.stage_model(Stage::Flow).unwrap();
    let verdict = model.verdict(&Features::of(result, evidence, &SCALE));
    config.decide(result, evidence, &verdict, SIZE)
}

#[test]
fn the_true_pose_agrees_with_the_pictures_and_is_accepted() {
    let found = evidence(40.0, &truth());
    assert!(found.blocks > 30, "{found:?}");
    // Not 1: blocks with faint texture count for less than their correlation, as sensor noise would drown them.
    assert!(found.photometric_refined > 0.85 && found.photometric_initial < 0.5, "{found:?}");
    assert!(found.silhouette_refined > found.silhouette_initial, "{found:?}");
    let decision = decide(&GateConfig::default(), &result(0.9), &found);
    assert!(decision.accept && decision.reason == GateReason::Passed);
}

#[test]
fn a_worse_pose_is_refused_by_the_pictures() {
    // As far on the other side of the initial pose as the truth is on this side.
    let wrong = initial() * truth().inverse() * initial();
    let found = evidence(40.0, &wrong);
    let decision = decide(&GateConfig::default(), &result(0.9), &found);
    assert!(!decision.accept && matches!(decision.reason, GateReason::Better(..)), "{decision:?} {found:?}");
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
    let features = Features::of(&result(0.9), &found, &SCALE);
    for feature in
        [Feature::PhotometricInitial, Feature::PhotometricRefined, Feature::PhotometricGain, Feature::Textured]
    {
        assert_eq!(features.get(feature), 0.0);
    }
    let better = |pose: &Pose| {
        let features = Features::of(&result(0.7), &evidence(0.0, pose), &SCALE);
        GateConfig::default().stage_model(Stage::Flow).unwrap().verdict(&features).better
    };
    let aside = Pose::new(Vector3::new(-0.015, 0.012, 0.7), Vector3::new(0.2, -0.4, 0.1));
    assert!(better(&truth()) > better(&aside) + 0.1, "{} {}", better(&truth()), better(&aside));
}

#[test]
fn features_are_finite_and_in_their_units() {
    let found = evidence(40.0, &truth());
    let covariance = std::array::from_fn(|i| if i % 7 == 0 { if i < 21 { 1.44e-6 } else { 1e-4 } } else { 0.0 });
    let solved = PnpResult { covariance, ..result(0.9) };
    let features = Features::of(&solved, &found, &SCALE);
    for feature in &Feature::ALL[..19] {
        assert!(features.get(*feature).is_finite(), "{feature:?}");
    }
    assert!((features.get(Feature::LnTranslationSigma) - 0.01_f64.ln()).abs() < 1e-9);
    assert!((features.get(Feature::LnRotationSigma) - 0.01_f64.ln()).abs() < 1e-9);
    assert!((features.get(Feature::LnMagnification) - 2_f64.ln()).abs() < 1e-9);
    assert!((features.get(Feature::DepthChange) - 0.01 / 0.12).abs() < 1e-9);
    assert!(features.get(Feature::ContourAgreement).is_nan(), "the contour stage's own");
}

#[test]
fn each_limit_can_refuse() {
    let found = evidence(40.0, &truth());
    let config = GateConfig::default();
    let refusal = |config: &GateConfig, result: &PnpResult| decide(config, result, &found).reason;
    let failed = PnpResult { status: PnpStatus::NotFinite, ..result(0.9) };
    assert_eq!(refusal(&config, &failed), GateReason::PnpFailed);
    let near = GateConfig { max_displacement: 1e-3, ..config.clone() };
    assert!(matches!(refusal(&near, &result(0.9)), GateReason::Displacement(..)));
    let stiff = GateConfig { max_rotation_rad: 1e-3, ..config.clone() };
    assert!(matches!(refusal(&stiff, &result(0.9)), GateReason::Rotation(..)));
    let sure = GateConfig { min_better: 1.0, ..config.clone() };
    assert!(matches!(refusal(&sure, &result(0.9)), GateReason::Better(..)));
    let unknown = Verdict { better: f64::NAN, refined_right: 0.9, initial_right: 0.1 };
    assert!(!config.decide(&result(0.9), &found, &unknown, SIZE).accept);
}

#[test]
fn a_tight_solution_that_stays_near_is_surer_than_a_loose_one_that_goes_far() {
    let model = GateConfig::default().stage_model(Stage::Flow).unwrap();
    let right = |sigma: f64, refined: &Pose| {
        let covariance = std::array::from_fn(|i| if i % 7 == 0 { sigma * sigma } else { 0.0 });
        let solved = PnpResult { covariance, camera_from_object: *refined, ..result(0.8) };
        model.verdict(&Features::of(&solved, &evidence(40.0, refined), &SCALE)).refined_right
    };
    let far = Pose::new(Vector3::new(0.0, 0.0, 0.78), Vector3::new(0.5, -0.8, 0.1));
    assert!(right(1e-4, &truth()) > 0.5 && right(1e-2, &far) < 0.3, "{} {}", right(1e-4, &truth()), right(1e-2, &far));
}

#[test]
fn a_covariance_is_scaled_by_blocks() {
    let scale = CovarianceScale {
        translation: 2_f64.ln(),
        translation_slope: 3_f64.ln(),
        rotation: 5_f64.ln(),
        rotation_slope: 0.0,
        decorrelation: 0.5,
    };
    let scaled = scale.apply(&[1.0; 36], 0.0);
    let close = |a: f64, b: f64| (a - b).abs() < 1e-9;
    assert!(close(scaled[0], 36.0) && close(scaled[2 * 6 + 4], 15.0) && close(scaled[35], 25.0), "{scaled:?}");
    assert!(close(scale.apply(&[1.0; 36], 1.0)[7], 4.0));
}

#[test]
fn a_model_is_read_strictly() {
    let text = include_str!("../../../../config/gate.yaml");
    assert!(GateModel::parse(text, "here").is_ok());
    let parse = |text: &str| GateModel::parse(text, "here").unwrap_err().to_string();
    assert!(parse(&text.replacen("scale: ", "scale: -", 1)).contains("scale not positive"));
    assert!(parse(&text.replacen("samples", "sample", 1)).contains("sample"));
    assert!(parse(&text.replacen("inlier_ratio", "inlier_share", 1)).contains("inlier_share"));
    let model = GateModel { stages: Default::default(), made_by: "nobody".into() };
    assert!(model.stage(Stage::Region).unwrap_err().to_string().contains("pseudoflow calibrate"));
    let missing = GateConfig { model: Some("/nowhere.yaml".into()), ..GateConfig::default() };
    assert!(missing.stage_model(Stage::Flow).unwrap_err().to_string().contains("/nowhere.yaml"));
}

#[test]
fn hypotheses_are_ranked_by_the_pose_that_goes_out() {
    let features = Features::default()
        .with(Feature::InlierRatio, 0.5)
        .with(Feature::PhotometricRefined, 0.7)
        .with(Feature::SilhouetteRefined, 0.4)
        .with(Feature::PhotometricInitial, 0.1);
    assert!((features.merit(true) - 1.6).abs() < 1e-12, "what is not known counts nothing");
    assert!((features.merit(false) - 0.6).abs() < 1e-12, "a refused pose does not go out");
    assert!((features.with(Feature::Certainty, 0.25).merit(true) - 2.1).abs() < 1e-12);
}

#[test]
fn a_stage_is_learnt_beside_the_others() {
    let mut model = GateModel::load(None).unwrap();
    let (flow, region) = (model.stages[&Stage::Flow].clone(), model.stages[&Stage::Region].clone());
    model.learn(Stage::Region, flow.clone(), "a command");
    assert_eq!((&model.stages[&Stage::Flow], &model.stages[&Stage::Region]), (&flow, &flow));
    assert_ne!(flow, region);
    let lines = |m: &GateModel| m.made_by.lines().filter(|l| l.starts_with("region: ")).count();
    assert!(lines(&model) == 1 && model.made_by.contains("region: a command") && model.made_by.contains("flow: "));
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
