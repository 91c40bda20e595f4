use super::*;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use pseudoflow_geometry::standard_normal;
use rand::{Rng, SeedableRng, rngs::StdRng};

fn cloud(count: usize, rng: &mut StdRng) -> Vec<Point3<f64>> {
    // Rounded to single precision, so that the double-precision definitions below see the same points.
    let mut coordinate = || f64::from((0.05 * standard_normal(rng)) as f32);
    (0..count).map(|_| Point3::new(coordinate(), coordinate(), coordinate())).collect()
}

/// A pose whose matrix is a rotation, or as far off one as official ground truth is.
fn given(pose: &Pose, exact: bool) -> MatrixPose {
    let mut matrix = pseudoflow_geometry::rotation_row_major(pose);
    if !exact {
        matrix.iter_mut().enumerate().for_each(|(i, v)| *v += 1e-3 * (i as f64).sin());
    }
    MatrixPose::from_row_major(&matrix, &pose.translation.vector.into()).unwrap()
}

fn moved(pose: &MatrixPose, p: &Point3<f64>) -> Point3<f64> {
    Point3::from(pose.matrix() * p.coords + pose.translation_m())
}

fn pose(rng: &mut StdRng) -> Pose {
    let mut normal = || standard_normal(rng);
    Pose::from_parts(
        Translation3::new(0.1 * normal(), 0.1 * normal(), 0.8 + 0.05 * normal()),
        UnitQuaternion::from_scaled_axis(Vector3::new(normal(), normal(), normal())),
    )
}

fn near(pose: &Pose, size: f64, rng: &mut StdRng) -> Pose {
    let mut normal = || size * standard_normal(rng);
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(normal(), normal(), normal()));
    Pose::from_parts(Translation3::new(0.1 * normal(), 0.1 * normal(), 0.1 * normal()), turn) * pose
}

fn assert_close(fast: f64, definition: f64) {
    assert!((fast - definition).abs() <= 2e-5 * definition, "{fast} is not {definition}");
}

const K: Intrinsics = Intrinsics { fx: 590.0, fy: 580.0, cx: 320.0, cy: 240.0 };

/// The definitions, word for word, in double precision.
mod definition {
    use super::*;

    pub(super) fn add(points: &[Point3<f64>], est: &MatrixPose, gt: &MatrixPose) -> f64 {
        points.iter().map(|p| (moved(est, p) - moved(gt, p)).norm()).sum::<f64>() / points.len() as f64
    }

    pub(super) fn adi(points: &[Point3<f64>], est: &MatrixPose, gt: &MatrixPose) -> f64 {
        let nearest = |p: &Point3<f64>| {
            points.iter().map(|q| (moved(est, q) - moved(gt, p)).norm()).fold(f64::INFINITY, f64::min)
        };
        points.iter().map(nearest).sum::<f64>() / points.len() as f64
    }

    pub(super) fn mssd(points: &[Point3<f64>], est: &MatrixPose, gt: &MatrixPose, symmetries: &[Pose]) -> f64 {
        let one = |s: &Pose| points.iter().map(|p| (moved(est, p) - moved(&gt.after(s), p)).norm()).fold(0.0, f64::max);
        symmetries.iter().map(one).fold(f64::INFINITY, f64::min)
    }

    pub(super) fn pixels(points: &[Point3<f64>], est: &MatrixPose, gt: &MatrixPose) -> Vec<f64> {
        points.iter().map(|p| (K.project(&moved(est, p)).unwrap() - K.project(&moved(gt, p)).unwrap()).norm()).collect()
    }

    pub(super) fn mspd(points: &[Point3<f64>], est: &MatrixPose, gt: &MatrixPose, symmetries: &[Pose]) -> f64 {
        let one = |s: &Pose| pixels(points, est, &gt.after(s)).into_iter().fold(0.0, f64::max);
        symmetries.iter().map(one).fold(f64::INFINITY, f64::min)
    }
}

#[test]
fn fast_errors_equal_the_definitions() {
    let mut rng = StdRng::seed_from_u64(3);
    for count in [1, 2, 16, 17, 333, 1500] {
        let points = cloud(count, &mut rng);
        let model = ModelPoints::new(&points).unwrap();
        for (size, exact) in [0.001, 0.05, 0.5, 3.0].into_iter().flat_map(|size| [(size, true), (size, false)]) {
            let gt = pose(&mut rng);
            let est = given(&near(&gt, size, &mut rng), exact);
            let gt = given(&gt, exact);
            let symmetries = [Pose::identity(), near(&Pose::identity(), 1.0, &mut rng)];
            assert_close(add_m(&model, &est, &gt), definition::add(&points, &est, &gt));
            assert_close(mssd_m(&model, &est, &gt, &symmetries), definition::mssd(&points, &est, &gt, &symmetries));
            let in_front = |p: &Point3<f64>| symmetries.iter().all(|s| moved(&gt.after(s), p).z > 0.01);
            if points.iter().all(|p| moved(&est, p).z > 0.01 && in_front(p)) {
                let mspd = mspd_px(&model, &est, &gt, &K, &symmetries);
                assert_close(mspd, definition::mspd(&points, &est, &gt, &symmetries));
                let mean = definition::pixels(&points, &est, &gt).iter().sum::<f64>() / count as f64;
                assert_close(projection_px(&model, &est, &gt, &K), mean);
            }
            let (fast, slow) = (adi_m(&model, &est, &gt), definition::adi(&points, &est, &gt));
            assert!((fast - slow).abs() <= 1e-4 * slow + 1e-9, "{count} points: {fast} is not {slow}");
        }
    }
}

#[test]
fn adi_is_right_when_the_estimate_is_far_away() {
    let mut rng = StdRng::seed_from_u64(4);
    let points = cloud(700, &mut rng);
    let model = ModelPoints::new(&points).unwrap();
    let gt = pose(&mut rng);
    let (est, gt) = ((Pose::translation(3.0, -1.0, 0.5) * gt).into(), gt.into());
    assert_close(adi_m(&model, &est, &gt), definition::adi(&points, &est, &gt));
}

#[test]
fn equal_poses_have_no_error() {
    let mut rng = StdRng::seed_from_u64(5);
    let model = ModelPoints::new(&cloud(100, &mut rng)).unwrap();
    let gt = pose(&mut rng).into();
    assert_eq!(add_m(&model, &gt, &gt), 0.0);
    assert!(adi_m(&model, &gt, &gt) < 1e-8);
    assert_eq!(mssd_m(&model, &gt, &gt, &[Pose::identity()]), 0.0);
    assert_eq!(mspd_px(&model, &gt, &gt, &K, &[Pose::identity()]), 0.0);
}

#[test]
fn a_symmetric_turn_is_forgiven_by_the_symmetry_aware_errors_only() {
    let mut rng = StdRng::seed_from_u64(6);
    let turn = Pose::rotation(Vector3::z() * std::f64::consts::PI);
    let model = ModelPoints::new(&cloud(100, &mut rng)).unwrap();
    let gt = pose(&mut rng);
    let (est, gt) = ((gt * turn).into(), gt.into());
    let symmetries = [Pose::identity(), turn];
    assert!(mssd_m(&model, &est, &gt, &symmetries) < 1e-7 && mssd_m(&model, &est, &gt, &symmetries[..1]) > 0.05);
    assert!(within_5cm_5deg(&est, &gt, &symmetries) && !within_5cm_5deg(&est, &gt, &symmetries[..1]));
}

#[test]
fn a_point_in_the_camera_plane_makes_projections_infinite() {
    let model = ModelPoints::new(&[Point3::new(0.1, 0.0, 0.0), Point3::new(0.0, 0.0, 0.1)]).unwrap();
    let (est, gt) = (Pose::identity().into(), Pose::translation(0.0, 0.0, 1.0).into());
    assert_eq!(mspd_px(&model, &est, &gt, &K, &[Pose::identity()]), f64::INFINITY);
    assert_eq!(projection_px(&model, &est, &gt, &K), f64::INFINITY);
}

#[test]
fn the_same_input_gives_the_same_bits_in_any_thread() {
    use rayon::prelude::*;
    let mut rng = StdRng::seed_from_u64(7);
    let model = ModelPoints::new(&cloud(1000, &mut rng)).unwrap();
    let pairs: Vec<(MatrixPose, MatrixPose)> =
        (0..64).map(|_| (pose(&mut rng).into(), pose(&mut rng).into())).collect();
    let _: u64 = rng.random();
    let one_by_one: Vec<u64> = pairs.iter().map(|(e, g)| adi_m(&model, e, g).to_bits()).collect();
    let together: Vec<u64> = pairs.par_iter().map(|(e, g)| adi_m(&model, e, g).to_bits()).collect();
    assert_eq!(one_by_one, together);
}
