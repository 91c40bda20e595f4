use super::*;
use crate::votes::group;
use nalgebra::Vector3;
use pseudoflow_geometry::rotation_angle_rad;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::path::Path;

const K: Intrinsics = Intrinsics { fx: 300.0, fy: 300.0, cx: 159.5, cy: 119.5 };

fn objects() -> ObjectSet {
    ObjectSet::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/objects/tabletop")).unwrap()
}

fn pose(x: f64, y: f64, z: f64, turn: f64) -> Pose {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.4, -1.0, 0.3) * turn);
    Pose::from_parts(Translation3::new(x, y, z), rotation)
}

/// Votes for an object at a pose: corners with noise, and some of them anywhere.
fn votes_for(object: &Object, class: usize, at: &Pose, count: usize, wrong: usize, rng: &mut ChaCha8Rng) -> Vec<Vote> {
    let mut noise = |sigma: f32| sigma * (rng.random::<f32>() + rng.random::<f32>() - 1.0);
    let vote = |i: usize| {
        let corners_px = object.box_corners_m().map(|c| {
            let p = K.project(&(at * c)).unwrap();
            let wild = if i < wrong { 25.0 } else { 1.5 };
            [p.x as f32 + noise(wild), p.y as f32 + noise(wild)]
        });
        // A point of the surface, and its pixel.
        let point = object.hull_m[7 * i % object.hull_m.len()];
        let seen = K.project(&(at * point)).unwrap();
        let surface = ((point - object.box_centre_m()) / object.diameter_m).map(|v| v as f32 + noise(0.02));
        let centre_px = if i < wrong { [0.0; 2] } else { [seen.x as f32, seen.y as f32] };
        Vote {
            class,
            score: 0.9 - 0.01 * i as f32,
            corners_px,
            centre_px,
            surface: surface.into(),
            rectangle_px: rectangle(&corners_px),
        }
    };
    (0..count).map(vote).collect()
}

fn rectangle(corners_px: &[[f32; 2]; 8]) -> [f32; 4] {
    let edge = |k: usize, start: f32, pick: fn(f32, f32) -> f32| corners_px.iter().map(|c| c[k]).fold(start, pick);
    [edge(0, f32::MAX, f32::min), edge(1, f32::MAX, f32::min), edge(0, f32::MIN, f32::max), edge(1, f32::MIN, f32::max)]
}

#[test]
fn noisy_votes_give_the_pose_and_wild_ones_do_not_disturb() {
    let objects = objects();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for (i, object) in objects.iter().enumerate() {
        let truth = pose(0.05, -0.02, 0.8, 0.5 + 0.4 * i as f64);
        let mut votes = votes_for(object, i, &truth, 12, 0, &mut rng);
        votes.extend(votes_for(object, i, &truth, 5, 5, &mut rng));
        let found = solve(&votes, object, &K, &DetectConfig::default(), &mut rng).unwrap().expect("a pose");
        let angle = rotation_angle_rad(&found.camera_from_object, &truth).to_degrees();
        let away_m = (found.camera_from_object.translation.vector - truth.translation.vector).norm();
        assert!(angle < 8.0 && away_m < 0.1 * object.diameter_m.max(0.15), "{}: {angle} deg, {away_m} m", object.name);
        assert!(found.score > 0.4 && found.covariance[0] > 0.0);
    }
}

#[test]
fn instances_of_one_object_are_told_apart() {
    let objects = objects();
    let ids = objects.ids();
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let object = objects.get(ids[1]).unwrap();
    let places = [pose(-0.15, 0.0, 0.8, 0.4), pose(0.15, 0.05, 0.9, 1.4)];
    let mut votes: Vec<Vote> = places.iter().flat_map(|p| votes_for(object, 1, p, 8, 0, &mut rng)).collect();
    votes.sort_by(|a, b| b.score.total_cmp(&a.score));
    let groups = group(&votes);
    assert_eq!(groups.len(), 2);
    let config = DetectConfig { max_instances: 5, ..DetectConfig::default() };
    let found = detect(&groups, &ids, &objects, &K, &config, &mut rng).unwrap();
    assert_eq!(found.len(), 2);
    for truth in &places {
        let nearest = found.iter().map(|d| (d.camera_from_object.translation.vector - truth.translation.vector).norm());
        assert!(nearest.fold(f64::MAX, f64::min) < 0.03);
    }
    assert_eq!(detect(&groups, &ids, &objects, &K, &DetectConfig::default(), &mut rng).unwrap().len(), 1);
}

#[test]
fn one_of_two_names_for_one_thing_is_kept_but_not_of_two_things() {
    let at = |object_id, score, x, side_px| Detection {
        object_id,
        camera_from_object: Pose::identity(),
        score,
        centre_px: Point2::new(x, 100.0),
        side_px,
        covariance: [0.0; 36],
        others: Vec::new(),
    };
    let same = suppress(vec![at(1, 0.5, 100.0, 60.0), at(2, 0.8, 105.0, 50.0)], 3);
    assert_eq!(same.iter().map(|d| d.object_id).collect::<Vec<_>>(), [2]);
    let before_a_box = suppress(vec![at(1, 0.5, 100.0, 120.0), at(2, 0.8, 105.0, 40.0)], 3);
    assert_eq!(before_a_box.len(), 2);
}

#[test]
fn votes_for_nothing_make_no_pose() {
    let objects = objects();
    let object = objects.iter().next().unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut wild = || [320.0 * rng.random::<f32>(), 240.0 * rng.random::<f32>()];
    let votes: Vec<Vote> = (0..6)
        .map(|_| Vote {
            class: 0,
            score: 0.5,
            corners_px: std::array::from_fn(|_| wild()),
            centre_px: wild(),
            surface: [0.1; 3],
            rectangle_px: [100.0, 60.0, 200.0, 160.0],
        })
        .collect();
    let found = solve(&votes, object, &K, &DetectConfig::default(), &mut ChaCha8Rng::seed_from_u64(6)).unwrap();
    assert!(found.as_ref().is_none_or(|d| d.score < DetectConfig::default().min_score), "{found:?}");
    let bad = DetectConfig { threshold_sides: 0.0, ..DetectConfig::default() };
    assert!(bad.check().unwrap_err().to_string().contains("threshold_sides"));
}
