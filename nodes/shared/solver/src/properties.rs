//! Properties of the whole solver on synthetic correspondences.

use crate::testing::{CAMERA, Scene};
use crate::{Correspondences, MinimalSolver, PnpConfig, PnpResult, PnpStatus, Solver, UNKNOWN_VARIANCE};
use nalgebra::{Matrix6, Vector6};
use proptest::prelude::*;
use pseudoflow_geometry::{Intrinsics, Pose};

fn solve_with(config: PnpConfig, scene: &Scene) -> PnpResult {
    Solver::new(config).unwrap().solve(&scene.correspondences(), &CAMERA, &scene.initial(), 7)
}

fn solve(scene: &Scene) -> PnpResult {
    solve_with(PnpConfig::default(), scene)
}

/// A pose that explains nothing: 180 degrees off.
fn hopeless(scene: &Scene) -> Pose {
    scene.pose * Pose::rotation(nalgebra::Vector3::new(3.0, 0.5, 0.0))
}

fn assert_kept(result: &PnpResult, initial: &Pose) {
    assert_eq!(result.camera_from_object, *initial);
    assert_eq!(Matrix6::from_row_slice(&result.covariance), Matrix6::identity() * UNKNOWN_VARIANCE);
    assert!(!result.status.is_ok() && !result.status.to_string().is_empty());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn noise_and_outliers_up_to_70_percent(
        seed in 0_u64..100_000, noise_px in 0.0_f64..1.2, outliers in 0.0_f64..0.7
    ) {
        let scene = Scene::solid(1500, seed).noisy(noise_px).with_outliers(outliers);
        let result = solve(&scene);
        prop_assert_eq!(result.status, PnpStatus::Ok);
        prop_assert!(scene.add_m(&result.camera_from_object) < 1e-4 + 3e-3 * noise_px);
        prop_assert!((result.inlier_ratio - (1.0 - outliers)).abs() < 0.1);
        // A few lost pixels land within the threshold by chance: they add at most sqrt(9 k / inliers).
        prop_assert!(result.rms_px < 0.3 + 1.6 * noise_px);
    }

    #[test]
    fn the_initial_pose_need_not_help(seed in 0_u64..100_000, minimal in prop::bool::ANY) {
        let scene = Scene::solid(1500, seed).noisy(0.7).with_outliers(if minimal { 0.65 } else { 0.4 });
        let minimal = if minimal { MinimalSolver::P3p } else { MinimalSolver::Epnp };
        let mut solver = Solver::new(PnpConfig { minimal, ..PnpConfig::default() }).unwrap();
        let result = solver.solve(&scene.correspondences(), &CAMERA, &hopeless(&scene), 3);
        prop_assert_eq!(result.status, PnpStatus::Ok);
        prop_assert!(scene.add_m(&result.camera_from_object) < 3e-3);
    }

    #[test]
    fn planes_and_nearly_planes(seed in 0_u64..100_000, thickness in 0.0_f64..2e-3, outliers in 0.0_f64..0.6) {
        let scene = Scene::in_box(1500, seed, [0.07, 0.06, thickness]).noisy(0.5).with_outliers(outliers);
        let result = solve(&scene);
        prop_assert_eq!(result.status, PnpStatus::Ok);
        prop_assert!((result.inlier_ratio - (1.0 - outliers)).abs() < 0.1);
        prop_assert!(result.rms_px < 0.9);
    }

    #[test]
    fn a_line_leaves_the_pose_alone(seed in 0_u64..100_000, noise_px in 0.0_f64..1.0) {
        let scene = Scene::in_box(500, seed, [0.07, 0.0, 0.0]).noisy(noise_px);
        let result = solve(&scene);
        prop_assert!(matches!(result.status, PnpStatus::Degenerate { .. }), "{}", result.status);
        assert_kept(&result, &scene.initial());
    }

    #[test]
    fn a_thin_rod_is_solved_or_refused_with_its_uncertainty(seed in 0_u64..100_000, thickness in 1e-4_f64..4e-3) {
        let scene = Scene::in_box(500, seed, [0.07, thickness, thickness]).noisy(1.0);
        let result = solve(&scene);
        match result.status {
            PnpStatus::Ok => prop_assert!(result.covariance[21].max(result.covariance[28]) < 0.35_f64.powi(2)),
            PnpStatus::Degenerate { .. } => assert_kept(&result, &scene.initial()),
            other => prop_assert!(false, "{}", other),
        }
    }

    #[test]
    fn few_points_never_panic(seed in 0_u64..100_000, n in 0_usize..40, outliers in 0.0_f64..1.0) {
        let scene = Scene::solid(n, seed).noisy(0.5).with_outliers(outliers);
        let result = solve(&scene);
        if n < 12 {
            prop_assert_eq!(result.status, PnpStatus::TooFewPoints { got: n, need: 12 });
        }
        if !result.status.is_ok() {
            assert_kept(&result, &scene.initial());
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_bits(seed in 0_u64..100_000) {
        let scene = Scene::solid(3000, seed).noisy(1.0).with_outliers(0.5);
        let first = solve(&scene);
        // Also from a solver that has worked on something else before.
        let mut used = Solver::new(PnpConfig::default()).unwrap();
        used.solve(&Scene::solid(900, seed + 1).correspondences(), &CAMERA, &scene.initial(), 1);
        let second = used.solve(&scene.correspondences(), &CAMERA, &scene.initial(), 7);
        prop_assert_eq!(first, second);
    }

    #[test]
    fn flows_that_are_not_finite_are_skipped(seed in 0_u64..100_000) {
        let scene = Scene::solid(800, seed).noisy(0.5);
        let mut poisoned = scene.clone();
        for (i, bad) in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX].into_iter().enumerate() {
            let at = i * 200;
            poisoned.points.insert(at, [0.01; 3]);
            poisoned.pixels.insert(at, [100.0, bad]);
            poisoned.points.insert(at, [bad, 0.0, 0.0]);
            poisoned.pixels.insert(at, [100.0, 100.0]);
        }
        prop_assert_eq!(solve(&scene), solve(&poisoned));
    }
}

#[test]
fn only_bad_flows_are_too_few_points() {
    let mut scene = Scene::solid(300, 1);
    scene.pixels.fill([f32::NAN; 2]);
    let result = solve(&scene);
    assert_eq!(result.status, PnpStatus::TooFewPoints { got: 0, need: 12 });
    assert_kept(&result, &scene.initial());
}

#[test]
fn pure_outliers_are_too_few_inliers() {
    for seed in 0..20 {
        let scene = Scene::solid(1500, seed).with_outliers(1.0);
        let result = solve(&scene);
        assert!(matches!(result.status, PnpStatus::TooFewInliers { .. }), "{}", result.status);
        assert_kept(&result, &scene.initial());
    }
}

#[test]
fn bad_poses_and_cameras_are_not_finite() {
    let scene = Scene::solid(300, 1);
    let mut solver = Solver::new(PnpConfig::default()).unwrap();
    let nan = Pose::translation(f64::NAN, 0.0, 1.0);
    assert_eq!(solver.solve(&scene.correspondences(), &CAMERA, &nan, 0).status, PnpStatus::NotFinite);
    for camera in [Intrinsics { fx: 0.0, ..CAMERA }, Intrinsics { cy: f64::INFINITY, ..CAMERA }] {
        let result = solver.solve(&scene.correspondences(), &camera, &scene.initial(), 0);
        assert_eq!(result.status, PnpStatus::NotFinite);
        assert_kept(&result, &scene.initial());
    }
}

#[test]
fn points_behind_the_camera_are_reported() {
    // A fifth of the points lies behind the camera at the pose that explains all the others.
    let mut scene = Scene::solid(1000, 4);
    let object_from_camera = scene.pose.inverse();
    for i in (0..1000).step_by(5) {
        let behind = object_from_camera * nalgebra::Point3::new(0.01, 0.02, -0.3 - 1e-4 * i as f64);
        scene.points[i] = [behind.x as f32, behind.y as f32, behind.z as f32];
    }
    let result = solve(&scene);
    assert!(
        matches!(result.status, PnpStatus::BehindCamera { share } if (share - 0.2).abs() < 0.01),
        "{}",
        result.status
    );
    assert_kept(&result, &scene.initial());
}

/// The error of a pose in the order of the covariance.
fn error(found: &Pose, truth: &Pose) -> Vector6<f64> {
    let shift = found.translation.vector - truth.translation.vector;
    let turn = (found.rotation * truth.rotation.inverse()).scaled_axis();
    Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}

#[test]
fn the_covariance_is_the_monte_carlo_spread() {
    for (n, noise_px, outliers) in [(400, 1.0, 0.0), (400, 0.5, 0.5), (60, 1.0, 0.2)] {
        let (clean, runs) = (Scene::solid(n, 11), 400);
        let (mut spread, mut predicted, mut distance) = (Matrix6::zeros(), Matrix6::zeros(), 0.0);
        let mut solver = Solver::new(PnpConfig::default()).unwrap();
        for run in 0..runs {
            let mut scene = clean.clone();
            scene.reseed(run);
            let scene = scene.noisy(noise_px).with_outliers(outliers);
            let result = solver.solve(&scene.correspondences(), &CAMERA, &scene.initial(), run);
            assert_eq!(result.status, PnpStatus::Ok);
            let off = error(&result.camera_from_object, &scene.pose);
            let covariance = Matrix6::from_row_slice(&result.covariance);
            spread += off * off.transpose() / runs as f64;
            predicted += covariance / runs as f64;
            distance += off.dot(&(covariance.try_inverse().unwrap() * off)) / (6.0 * runs as f64);
        }
        for i in 0..6 {
            let ratio = (predicted[(i, i)] / spread[(i, i)]).sqrt();
            assert!((0.8..1.25).contains(&ratio), "n {n}, axis {i}: predicted / found = {ratio}");
        }
        // Mean squared Mahalanobis distance by degree of freedom: holds the off-diagonal entries too.
        assert!((0.7..1.5).contains(&distance), "n {n}: {distance}");
    }
}

#[test]
fn shared_errors_widen_the_covariance() {
    let scene = Scene::solid(500, 3).noisy(0.5);
    let alone = solve(&scene);
    let shared = solve_with(PnpConfig { points_per_independent_error: 16.0, ..PnpConfig::default() }, &scene);
    assert!((shared.covariance[0] / alone.covariance[0] - 16.0).abs() < 1e-6);
}

#[test]
fn an_empty_input_is_too_few_points() {
    let none = Correspondences::new(&[], &[]).unwrap();
    let initial = Pose::translation(0.0, 0.0, 1.0);
    let result = Solver::new(PnpConfig::default()).unwrap().solve(&none, &CAMERA, &initial, 0);
    assert_eq!(result.status, PnpStatus::TooFewPoints { got: 0, need: 12 });
}
