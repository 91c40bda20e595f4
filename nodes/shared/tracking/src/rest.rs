//! What is at rest moves as one before a moving camera.
//!
//! Nothing is taken to be at rest until it has moved as the others did for a while. The common motion is fitted to points of all
//! objects that agree (Kabsch 1976; Umeyama 1991), so that the distances between them, not the turn of each, fix its rotation.

use crate::history::History;
use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use pseudoflow_geometry::{Intrinsics, Pose};

/// An object as the fit sees it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Body {
    /// In the earlier frame and now, `camera_from_object`.
    pub(crate) before: Pose,
    pub(crate) now: Pose,
    /// Middle and radius, metres, the object's frame.
    pub(crate) middle: Point3<f64>,
    pub(crate) radius_m: f64,
}

/// The motion of the scene from an earlier frame to now.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Common {
    /// `camera_now_from_camera_before`, of points at rest.
    pub(crate) motion: Pose,
    /// Which bodies moved like that.
    pub(crate) members: Vec<bool>,
}

/// Bodies that the motion misses by less are at rest: pixels of the image, and as much of the body's radius.
const AGREE_PX: f64 = 2.5;
const AGREE_RADII: f64 = 0.04;
/// Along the ray a body is known less well by this factor.
const DEPTH_SLACK: f64 = 4.0;

impl Body {
    /// Middle and six points around it in either frame.
    fn points(&self) -> impl Iterator<Item = (Vector3<f64>, Vector3<f64>)> + '_ {
        let r = self.radius_m;
        let around = [[0., 0., 0.], [r, 0., 0.], [-r, 0., 0.], [0., r, 0.], [0., -r, 0.], [0., 0., r], [0., 0., -r]];
        around.into_iter().map(move |d| {
            let p = self.middle + Vector3::from(d);
            ((self.before * p).coords, (self.now * p).coords)
        })
    }

    fn agrees(&self, motion: &Pose, camera: &Intrinsics) -> bool {
        let radius_px = self.radius_m * camera.fx / (self.now * self.middle).z.max(1e-3);
        self.missed_px(motion, camera) < AGREE_PX + AGREE_RADII * radius_px
    }

    /// How far a motion misses the middle, pixels; depth counts less.
    pub(crate) fn missed_px(&self, motion: &Pose, camera: &Intrinsics) -> f64 {
        let (there, here) = (motion * (self.before * self.middle), self.now * self.middle);
        let focal = camera.fx.max(camera.fy);
        let d = (there - here) * (focal / here.z.max(1e-3));
        (d.x * d.x + d.y * d.y + (d.z / DEPTH_SLACK).powi(2)).sqrt()
    }
}

/// The motion that most bodies agree with; `None` unless two do.
pub(crate) fn common_motion(bodies: &[Body], camera: &Intrinsics) -> Option<Common> {
    let of_pair = |i: usize, j: usize| {
        let motion = fit(bodies.iter().enumerate().filter(|(k, _)| *k == i || *k == j).map(|(_, b)| b));
        let members: Vec<bool> = bodies.iter().map(|b| b.agrees(&motion, camera)).collect();
        (members[i] && members[j]).then_some(members)
    };
    let n = bodies.len();
    let pairs = (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j)));
    let members = pairs.filter_map(|(i, j)| of_pair(i, j)).max_by_key(|m| m.iter().filter(|v| **v).count())?;
    let motion = fit(bodies.iter().zip(&members).filter(|(_, m)| **m).map(|(b, _)| b));
    Some(Common { motion, members })
}

/// The motion of the scene as bodies that are taken to be at rest show it; one alone shows its own.
pub(crate) fn motion_of(bodies: &[Body], camera: &Intrinsics) -> Option<Pose> {
    match bodies {
        [] => None,
        [one] => Some(one.now * one.before.inverse()),
        _ => common_motion(bodies, camera).map(|c| c.motion),
    }
}

/// The rigid motion nearest to that of all points of some bodies.
fn fit<'a>(bodies: impl Iterator<Item = &'a Body>) -> Pose {
    type Pair = (Vector3<f64>, Vector3<f64>);
    let points: Vec<Pair> = bodies.flat_map(Body::points).collect();
    let n = points.len().max(1) as f64;
    let mean = |of: fn(&Pair) -> Vector3<f64>| points.iter().map(of).sum::<Vector3<f64>>() / n;
    let (from, to) = (mean(|p| p.0), mean(|p| p.1));
    let covariance: Matrix3<f64> = points.iter().map(|(a, b)| (b - to) * (a - from).transpose()).sum();
    let svd = covariance.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Pose::identity() };
    let sign = (u * v_t).determinant().signum();
    let rotation = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t;
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    Pose::from_parts((to - rotation * from).into(), rotation)
}

/// A body between an earlier frame and now, if it was seen there.
pub(crate) fn body(history: &History, frame: u64, now: &Pose, (middle, radius_m): (Point3<f64>, f64)) -> Option<Body> {
    let before = history.at(frame).filter(|m| m.measured)?.pose;
    Some(Body { before, now: *now, middle, radius_m })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;
    use pseudoflow_geometry::exp_se3;

    const K: Intrinsics = Intrinsics { fx: 600.0, fy: 600.0, cx: 320.0, cy: 240.0 };

    #[test]
    fn the_moved_one_is_told_from_those_at_rest() {
        let motion = exp_se3(&Vector6::new(0.02, -0.01, 0.01, 0.03, -0.02, 0.01));
        let at = |x: f64, y: f64, own: Pose| {
            let before = Pose::new(Vector3::new(x, y, 0.8), Vector3::new(x, 3.0 * y, 0.4));
            Body { before, now: motion * before * own, middle: Point3::new(0.0, 0.01, 0.0), radius_m: 0.06 }
        };
        let still = Pose::identity();
        let bodies = [
            at(0.1, 0.0, still),
            at(-0.2, 0.1, still),
            at(0.0, -0.1, Pose::translation(0.02, 0.0, 0.0)),
            at(0.2, 0.2, still),
        ];
        let common = common_motion(&bodies, &K).unwrap();
        assert_eq!(common.members, [true, true, false, true]);
        assert!((common.motion.to_homogeneous() - motion.to_homogeneous()).norm() < 1e-9);
        assert!(common_motion(&bodies[2..3], &K).is_none(), "one alone may have been moved");
        let alone = motion_of(&bodies[3..], &K).unwrap();
        assert!((alone.to_homogeneous() - motion.to_homogeneous()).norm() < 1e-9, "unless it is known to be at rest");
        assert!(motion_of(&[], &K).is_none());
    }
}
