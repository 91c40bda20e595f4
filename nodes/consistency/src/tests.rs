//! A box seen from known poses: perfect flows, wrong ones, shifted ones.

use crate::{ConsistencyError, Label, Labels, Rule, View, label};
use nalgebra::{Point2, Point3, Vector3};
use proptest::prelude::*;
use pseudoflow_geometry::{Intrinsics, Pose};

const SIZE: usize = 96;
const K: Intrinsics = Intrinsics { fx: 420.0, fy: 420.0, cx: 47.5, cy: 48.0 };
const HALF_M: [f64; 3] = [0.05, 0.035, 0.04];
const DIAMETER_M: f64 = 0.147;
const RULE: Rule = Rule { tau_px: 0.375, min_views: 3, label: Label::TeacherFlow, accept_all: false };

struct Planes {
    pose: Pose,
    depth_m: Vec<f32>,
    mask: Vec<u8>,
    flow_px: Vec<f32>,
}

impl Planes {
    fn view(&self) -> View<'_> {
        View {
            size_px: SIZE,
            camera_from_object: self.pose,
            intrinsics: K,
            depth_m: &self.depth_m,
            mask: &self.mask,
            flow_px: &self.flow_px,
        }
    }
}

/// Where a ray meets a box around the object's origin: depth along z.
fn hit(pose: &Pose, x: usize, y: usize) -> Option<f64> {
    let object_from_camera = pose.inverse();
    let ray = K.unproject(&Point2::new(x as f64, y as f64), 1.0).coords;
    let (from, along) = (object_from_camera * Point3::origin(), object_from_camera.rotation * ray);
    let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..3 {
        let [a, b] = [-1.0, 1.0].map(|side| (side * HALF_M[axis] - from[axis]) / along[axis]);
        (near, far) = (near.max(a.min(b)), far.min(a.max(b)));
    }
    (near < far && near > 0.0).then_some(near)
}

/// The view at a pose, with the perfect flow to the object at `real`.
fn planes(pose: Pose, real: &Pose) -> Planes {
    let mut out = Planes { pose, depth_m: vec![], mask: vec![], flow_px: vec![] };
    for (y, x) in (0..SIZE).flat_map(|y| (0..SIZE).map(move |x| (y, x))) {
        let depth = hit(&pose, x, y);
        out.depth_m.push(depth.unwrap_or(0.0) as f32);
        out.mask.push(if depth.is_some() { 255 } else { 0 });
        let flow = depth.map_or([0.0; 2], |z| {
            let point = pose.inverse() * K.unproject(&Point2::new(x as f64, y as f64), z);
            let seen = K.project(&(real * point)).unwrap();
            [seen.x - x as f64, seen.y - y as f64]
        });
        out.flow_px.extend(flow.map(|v| v as f32));
    }
    out
}

fn real() -> Pose {
    Pose::new(Vector3::new(0.003, -0.002, 0.51), Vector3::new(0.5, -0.6, 0.2))
}

fn scene() -> Vec<Planes> {
    let at = |t: [f64; 3], r: [f64; 3]| planes(Pose::new(t.into(), r.into()), &real());
    vec![
        at([0.0, 0.0, 0.5], [0.45, -0.5, 0.25]),
        at([0.004, 0.002, 0.49], [0.55, -0.65, 0.1]),
        at([-0.003, 0.003, 0.52], [0.35, -0.55, 0.3]),
        at([0.002, -0.004, 0.5], [0.5, -0.4, 0.2]),
    ]
}

fn label_all(scene: &[Planes], rule: &Rule) -> Vec<Labels> {
    let views: Vec<View<'_>> = scene.iter().map(Planes::view).collect();
    label(&views, DIAMETER_M, rule).unwrap()
}

fn count(mask: &[u8]) -> usize {
    mask.iter().filter(|m| **m != 0).count()
}

fn shift(planes: &mut Planes, by: [f32; 2]) {
    planes.flow_px.chunks_exact_mut(2).for_each(|flow| (flow[0], flow[1]) = (flow[0] + by[0], flow[1] + by[1]));
}

fn sigmas(labels: &Labels) -> Vec<f32> {
    let mut sigmas: Vec<f32> = labels.sigma_px.iter().copied().filter(|s| s.is_finite()).collect();
    sigmas.sort_by(f32::total_cmp);
    sigmas
}

/// Whether a pixel's flow ends inside the crop.
fn stays(planes: &Planes, pixel: usize) -> bool {
    let target =
        [(pixel % SIZE) as f32 + planes.flow_px[2 * pixel], (pixel / SIZE) as f32 + planes.flow_px[2 * pixel + 1]];
    target.iter().all(|v| (-0.5..SIZE as f32 - 0.5).contains(v))
}

/// Whether a pixel and all around it lie on one face that all views see: away from the box's edges, where a sample
/// between texels mixes two faces.
fn is_inside_face(scene: &[Planes], view: usize, pixel: usize) -> bool {
    let z = scene[view].depth_m[pixel];
    if z == 0.0 {
        return false;
    }
    let p = Point2::new((pixel % SIZE) as f64, (pixel / SIZE) as f64);
    let point = scene[view].pose.inverse() * K.unproject(&p, f64::from(z));
    let near_edge = (0..3).filter(|axis| HALF_M[*axis] - point[*axis].abs() < 0.006).count() > 1;
    !near_edge && scene.iter().all(|other| behind_m(other, &point).is_some_and(|by| by.abs() < 0.002))
}

/// How far a point of the object lies behind what a view sees there; `None` outside of it.
fn behind_m(view: &Planes, point_in_object: &Point3<f64>) -> Option<f64> {
    let at = view.pose * point_in_object;
    let p = K.project(&at)?;
    let inside = (1.0..SIZE as f64 - 2.0).contains(&p.x) && (1.0..SIZE as f64 - 2.0).contains(&p.y);
    inside.then(|| hit(&view.pose, p.x.round() as usize, p.y.round() as usize))?.map(|depth| at.z - depth)
}

#[test]
fn perfect_flows_agree_and_every_visible_pixel_gets_its_label() {
    let scene = scene();
    for (view, labels) in label_all(&scene, &RULE).iter().enumerate() {
        let inside: Vec<usize> = (0..SIZE * SIZE).filter(|pixel| is_inside_face(&scene, view, *pixel)).collect();
        assert!(inside.len() > 1500, "view {view}: {}", inside.len());
        for pixel in &inside {
            assert!(labels.sigma_px[*pixel] <= 1e-3, "view {view}, pixel {pixel}: {}", labels.sigma_px[*pixel]);
            assert_eq!(labels.valid[*pixel], 255, "view {view}, pixel {pixel}");
        }
        // The whole mask but for edges, borders and what few views see.
        let (valid, mask) = (count(&labels.valid), count(&scene[view].mask));
        assert!(valid as f64 > 0.9 * mask as f64, "view {view}: {valid} of {mask}");
        for pixel in 0..SIZE * SIZE {
            let on = labels.valid[pixel] != 0;
            assert!(!on || scene[view].mask[pixel] != 0, "a label off the object");
            assert_eq!(on, labels.label_px[2 * pixel].is_finite());
            if on {
                assert_eq!(
                    labels.label_px[2 * pixel],
                    scene[view].flow_px[2 * pixel],
                    "the label is the teacher's flow"
                );
            }
        }
    }
}

#[test]
fn one_wrong_view_of_four_is_no_label() {
    let mut scene = scene();
    shift(&mut scene[2], [6.0, -4.0]);
    for (view, labels) in label_all(&scene, &RULE).iter().enumerate() {
        // Three right views and one 7.2 px off spread by 7.2 sqrt(3)/4 px wherever all four see the point.
        let four = labels.sigma_px.iter().filter(|s| (**s - 3.12).abs() < 0.2).count();
        assert!(four > 1000, "{four}");
        // Labels are left only where the wrong view sees nothing.
        let valid = (0..SIZE * SIZE).filter(|pixel| labels.valid[*pixel] != 0);
        // At the box's edges a sample mixes two faces; there right votes differ a little.
        let apart = valid.clone().filter(|pixel| labels.sigma_px[*pixel] > 0.05).count();
        assert!(apart as f64 <= 0.03 * valid.clone().count() as f64, "view {view}: {apart}");
        assert_eq!(valid.count() == 0, view == 2, "view {view}");
    }
}

#[test]
fn the_mean_vote_outvotes_one_of_four() {
    let mut scene = scene();
    shift(&mut scene[2], [0.4, 0.0]);
    let rule = Rule { label: Label::MeanVote, ..RULE };
    let labels = label_all(&scene, &rule);
    // The label of the wrong view moves three quarters of the way back.
    let right = planes(scene[2].pose, &real());
    let errors: Vec<f32> = (0..SIZE * SIZE)
        .filter(|pixel| labels[2].valid[*pixel] != 0 && is_inside_face(&scene, 2, *pixel))
        .map(|pixel| labels[2].label_px[2 * pixel] - right.flow_px[2 * pixel])
        .collect();
    assert!(errors.len() > 1000);
    assert!(errors.iter().all(|error| (error - 0.1).abs() < 5e-3), "{:?}", &errors[..8]);
}

/// Largest distance, px, of a view's labels from the perfect flow, and how many there are.
fn worst(labels: &Labels, right: &Planes) -> (f32, usize) {
    let off = |pixel: usize| {
        let [dx, dy] = [0, 1].map(|axis| labels.label_px[2 * pixel + axis] - right.flow_px[2 * pixel + axis]);
        dx.hypot(dy)
    };
    let valid = (0..SIZE * SIZE).filter(|pixel| labels.valid[*pixel] != 0);
    (valid.clone().map(off).fold(0.0, f32::max), valid.count())
}

#[test]
fn a_rigid_label_is_right_though_a_part_of_every_flow_is_wrong() {
    let mut scene = scene();
    // The left of the image: every view is misled in the same way, so the votes agree there and the mean would be wrong.
    for planes in &mut scene {
        let misled = |pixel: usize| (pixel % SIZE) as f32 + planes.flow_px[2 * pixel] < 38.0;
        let misled: Vec<usize> = (0..SIZE * SIZE).filter(|pixel| misled(*pixel)).collect();
        misled.iter().for_each(|pixel| planes.flow_px[2 * pixel] -= 5.0);
    }
    let mean = label_all(&scene, &Rule { label: Label::MeanVote, ..RULE });
    let rigid = label_all(&scene, &Rule { label: Label::Rigid, ..RULE });
    for (view, planes) in scene.iter().enumerate() {
        let right = self::planes(planes.pose, &real());
        let (mean, (off_px, count)) = (worst(&mean[view], &right), worst(&rigid[view], &right));
        assert!(mean.0 > 4.9, "view {view}: the mean is off by {mean:?}");
        assert!(off_px < RULE.tau_px as f32 && count > 1000, "view {view}: {count} labels, {off_px} px off");
        assert!(count < mean.1, "view {view}: the misled part has no label");
    }
}

#[test]
fn the_rigid_label_takes_noise_out_and_counts_it_as_sigma() {
    let mut scene = scene();
    // All views are off in the same way, in a pattern that is no motion.
    for planes in &mut scene {
        for pixel in 0..SIZE * SIZE {
            let y = (pixel / SIZE) as f32 + planes.flow_px[2 * pixel + 1];
            planes.flow_px[2 * pixel] += 0.3 * (y * 0.9).sin();
        }
    }
    let labels = label_all(&scene, &Rule { label: Label::Rigid, ..RULE });
    let right = planes(scene[0].pose, &real());
    let inside: Vec<usize> = (0..SIZE * SIZE).filter(|pixel| is_inside_face(&scene, 0, *pixel)).collect();
    let off = |pixel: &usize| labels[0].label_px[2 * pixel] - right.flow_px[2 * pixel];
    assert!(inside.iter().all(|pixel| labels[0].valid[*pixel] == 0 || off(pixel).abs() < 0.1));
    let sigmas = sigmas(&labels[0]);
    let root_mean_square = (sigmas.iter().map(|s| s * s).sum::<f32>() / sigmas.len() as f32).sqrt();
    assert!((root_mean_square - 0.3 / 2f32.sqrt()).abs() < 0.03, "{root_mean_square}");
}

#[test]
fn flows_that_are_no_motion_have_no_rigid_label() {
    let mut scene = scene();
    for (pixel, flow) in scene.iter_mut().flat_map(|planes| planes.flow_px.chunks_exact_mut(2).enumerate()) {
        let scattered = |seed: usize| ((pixel * 2_654_435_761 + seed) % 61) as f32 - 30.0;
        (flow[0], flow[1]) = (flow[0] + scattered(0), flow[1] + scattered(17));
    }
    let all = Rule { label: Label::Rigid, accept_all: true, ..RULE };
    assert!(label_all(&scene, &all).iter().all(|labels| count(&labels.valid) == 0));
}

#[test]
fn half_a_pixel_is_seen() {
    let mut scene = scene();
    shift(&mut scene[1], [0.5, 0.0]);
    let labels = label_all(&scene, &RULE);
    let sigmas = sigmas(&labels[0]);
    // sqrt(3)/4 of the shift with four views.
    assert!((sigmas[sigmas.len() / 2] - 0.2165).abs() < 5e-3, "{}", sigmas[sigmas.len() / 2]);
    let strict = Rule { tau_px: 0.2, ..RULE };
    assert!(count(&label_all(&scene, &strict)[0].valid) < 300);
}

#[test]
fn what_a_view_does_not_see_it_does_not_vote_on() {
    // One view from the other side: its flow is nonsense for the points that the others see.
    let mut scene = scene();
    let behind = Pose::new(Vector3::new(0.0, 0.0, 0.5), Vector3::new(0.45, 2.4, 0.25));
    scene[3] = planes(behind, &real());
    shift(&mut scene[3], [20.0, 20.0]);
    let labels = label_all(&scene, &RULE);
    let hidden = |pixel: &usize| {
        let p = Point2::new((pixel % SIZE) as f64, (pixel / SIZE) as f64);
        let point = scene[0].pose.inverse() * K.unproject(&p, f64::from(scene[0].depth_m[*pixel]));
        behind_m(&scene[3], &point).is_some_and(|by| by > 0.01)
    };
    let seen: Vec<usize> =
        (0..SIZE * SIZE).filter(|pixel| is_inside_face(&scene[..3], 0, *pixel)).filter(hidden).collect();
    assert!(seen.len() > 1000, "{}", seen.len());
    assert!(seen.iter().all(|pixel| labels[0].sigma_px[*pixel] < 1e-3));
    // And its own points, which nobody else sees, have no label.
    assert!(count(&labels[3].valid) < 200, "{}", count(&labels[3].valid));
}

#[test]
fn an_occluder_in_a_view_hides_its_points() {
    // In view 1 something stands before the object, in its depth and mask as in a scene with two surfaces.
    let mut scene = scene();
    for pixel in (0..SIZE * SIZE).filter(|pixel| pixel % SIZE < SIZE / 2) {
        scene[1].depth_m[pixel] = 0.3;
        scene[1].mask[pixel] = 255;
        scene[1].flow_px[2 * pixel] = 30.0;
    }
    let rule = Rule { min_views: 4, ..RULE };
    let labels = label_all(&scene, &rule);
    let left = (0..SIZE * SIZE).filter(|p| p % SIZE < SIZE / 2 - 20 && labels[0].valid[*p] != 0).count();
    assert_eq!(left, 0, "points behind the occluder need all four views");
    let three = label_all(&scene, &RULE);
    assert!((0..SIZE * SIZE).filter(|p| p % SIZE < SIZE / 2 - 20 && three[0].valid[*p] != 0).count() > 500);
}

#[test]
fn too_few_views_give_no_label_and_accept_all_gives_all() {
    let mut scene = scene();
    scene.iter_mut().skip(2).for_each(|planes| planes.mask.fill(0));
    assert_eq!(count(&label_all(&scene, &RULE)[0].valid), 0);
    let all = Rule { accept_all: true, ..RULE };
    let labels = label_all(&scene, &all);
    let inside = (0..SIZE * SIZE).filter(|pixel| scene[0].mask[*pixel] != 0 && stays(&scene[0], *pixel)).count();
    assert_eq!(count(&labels[0].valid), inside);
    // A flow out of the crop is no label even then.
    shift(&mut scene[0], [500.0, 0.0]);
    assert_eq!(count(&label_all(&scene, &all)[0].valid), 0);
}

#[test]
fn threads_do_not_change_a_bit() {
    let mut scene = scene();
    shift(&mut scene[1], [0.3, 0.1]);
    let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(|| label_all(&scene, &RULE));
    let many = rayon::ThreadPoolBuilder::new().num_threads(5).build().unwrap().install(|| label_all(&scene, &RULE));
    let bits = |labels: &[Labels]| -> Vec<u32> {
        labels.iter().flat_map(|l| l.sigma_px.iter().chain(&l.label_px)).map(|v| v.to_bits()).collect()
    };
    assert_eq!(bits(&alone), bits(&many));
}

#[test]
fn a_short_plane_is_named() {
    let scene = scene();
    let view = View { mask: &scene[0].mask[1..], ..scene[0].view() };
    let error = label(&[view], DIAMETER_M, &RULE).unwrap_err();
    assert!(matches!(error, ConsistencyError::Plane { plane: "mask", .. }), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// A common shift of all views moves the votes together: sigma stays, whatever the shift.
    #[test]
    fn a_common_shift_is_no_disagreement(dx in -6.0_f32..6.0, dy in -6.0_f32..6.0) {
        let mut scene = scene();
        let before = sigmas(&label_all(&scene, &RULE)[0]);
        scene.iter_mut().for_each(|planes| shift(planes, [dx, dy]));
        let after = sigmas(&label_all(&scene, &RULE)[0]);
        prop_assert_eq!(before.len(), after.len());
        prop_assert!(before.iter().zip(&after).all(|(a, b)| (a - b).abs() < 1e-3));
    }

    /// Labels grow with tau.
    #[test]
    fn a_larger_tau_never_takes_a_label_away(shifted in 0.1_f32..3.0, tau in 0.05_f64..1.0) {
        let mut scene = scene();
        shift(&mut scene[1], [shifted, 0.0]);
        let narrow = label_all(&scene, &Rule { tau_px: tau, ..RULE });
        let wide = label_all(&scene, &Rule { tau_px: 2.0 * tau, ..RULE });
        for (narrow, wide) in narrow.iter().zip(&wide) {
            prop_assert!(narrow.valid.iter().zip(&wide.valid).all(|(n, w)| *n == 0 || *w != 0));
        }
    }
}
