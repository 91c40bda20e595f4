use super::keyframe::Keyframe;
use super::patch;
use super::pyramid::Pyramid;
use nalgebra::{Matrix6, Point3, Vector6};
use pseudoflow_contour::Term;
use pseudoflow_geometry::{Intrinsics, Pose};

/// A point of a keyframe in a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Match {
    /// Metres, the object's frame.
    pub(crate) position: Point3<f64>,
    /// Where it was found; `None` where nothing there looks like it.
    pub(crate) at: Option<[f64; 2]>,
}

/// Looks for the points of a keyframe that a pose should show; those that it turns away from the camera are left out.
pub(crate) fn matches(
    keyframe: &Keyframe,
    here: &Pyramid,
    pose: &Pose,
    camera: &Intrinsics,
    (levels, most_px): (usize, f32),
) -> Vec<Match> {
    let level = &here.levels[0];
    let of = |anchor: &super::keyframe::Anchor| {
        let expected = camera.project(&(pose * anchor.position))?;
        let within = |v: f64, size: usize| v > 6.0 && v < size as f64 - 7.0;
        if !(within(expected.x, level.width) && within(expected.y, level.height)) {
            return None;
        }
        let key_from_here = anchor.key_from_here(pose, camera)?;
        let expected = [expected.x as f32, expected.y as f32];
        let found = patch::find(&keyframe.pyramid, anchor.place, here, expected, &key_from_here, levels, most_px);
        let at = found.filter(|f| f.likeness >= keyframe.alike).map(|f| f.at.map(f64::from));
        Some(Match { position: anchor.position, at })
    };
    keyframe.anchors.iter().filter_map(of).collect()
}

/// Reprojection errors of matches under Tukey's loss, whose scale is that of the errors themselves.
#[derive(Debug)]
pub(crate) struct TextureTerm<'a> {
    pub(crate) matches: &'a [Match],
    pub(crate) camera: Intrinsics,
    /// Smallest and largest standard deviation of a coordinate, pixels.
    pub(crate) sigma_px: [f64; 2],
    /// Independent errors for each match.
    pub(crate) share: f64,
}

/// Width of Tukey's loss, standard deviations.
const TUKEY: f64 = 4.0;

impl TextureTerm<'_> {
    fn errors(&self, pose: &Pose) -> impl Iterator<Item = (Point3<f64>, [f64; 2], Option<[f64; 2]>)> + '_ {
        let pose = *pose;
        self.matches.iter().filter_map(move |m| {
            let p = pose * m.position;
            let at = self.camera.project(&p)?;
            Some((p, [at.x, at.y], m.at.map(|seen| [at.x - seen[0], at.y - seen[1]])))
        })
    }

    /// Robust standard deviation of a coordinate of the errors.
    fn scale_px(&self, pose: &Pose) -> f64 {
        let mut errors: Vec<f64> = self.errors(pose).filter_map(|(_, _, e)| e.map(|e| e[0].hypot(e[1]))).collect();
        if errors.is_empty() {
            return self.sigma_px[1];
        }
        let middle = errors.len() / 2;
        let (_, median, _) = errors.select_nth_unstable_by(middle, f64::total_cmp);
        (*median / 1.1774).clamp(self.sigma_px[0], self.sigma_px[1])
    }

    /// Matches that a pose agrees with to some pixels.
    pub(crate) fn within(&self, pose: &Pose, px: f64) -> usize {
        self.errors(pose).filter(|(_, _, e)| e.is_some_and(|e| e[0].hypot(e[1]) < px)).count()
    }

    /// Share of all matches that a pose agrees with.
    pub(crate) fn agreeing(&self, pose: &Pose) -> f64 {
        let limit = TUKEY * self.scale_px(pose).min(1.0);
        let right = self.errors(pose).filter(|(_, _, e)| e.is_some_and(|e| e[0].hypot(e[1]) < limit)).count();
        right as f64 / self.matches.len().max(1) as f64
    }
}

impl Term for TextureTerm<'_> {
    fn accumulate(&mut self, pose: &Pose, hessian: &mut Matrix6<f64>, gradient: &mut Vector6<f64>) {
        let sigma = self.scale_px(pose);
        let (width, weight) = (TUKEY * sigma, self.share / (sigma * sigma));
        let t = pose.translation.vector;
        for (p, _, error) in self.errors(pose) {
            let Some(e) = error else { continue };
            let s = (1.0 - (e[0] * e[0] + e[1] * e[1]) / (width * width)).max(0.0);
            let w = weight * s * s;
            if w == 0.0 {
                continue;
            }
            let (i, q) = (1.0 / p.z, p.coords - t);
            let axes = [
                [self.camera.fx * i, 0.0, -self.camera.fx * i * i * p.x],
                [0.0, self.camera.fy * i, -self.camera.fy * i * i * p.y],
            ];
            for (a, r) in axes.iter().zip(e) {
                let turn = q.cross(&nalgebra::Vector3::from(*a));
                let j = Vector6::new(a[0], a[1], a[2], turn.x, turn.y, turn.z);
                *hessian += w * j * j.transpose();
                *gradient += w * r * j;
            }
        }
    }

    fn cost(&mut self, pose: &Pose) -> f64 {
        let sigma = self.sigma_px[0];
        let width2 = (TUKEY * sigma).powi(2);
        let loss = |e: [f64; 2]| 1.0 - (1.0 - (e[0] * e[0] + e[1] * e[1]) / width2).max(0.0).powi(3);
        self.share * TUKEY * TUKEY / 6.0 * self.errors(pose).map(|(_, _, e)| e.map_or(1.0, loss)).sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use pseudoflow_contour::retract;

    #[test]
    fn steps_lead_to_the_pose_that_most_points_agree_with() {
        let camera = Intrinsics { fx: 600.0, fy: 610.0, cx: 320.0, cy: 240.0 };
        let truth = Pose::new(Vector3::new(0.05, -0.02, 0.7), Vector3::new(0.3, -0.2, 0.5));
        let points: Vec<Match> = (0..40)
            .map(|i| {
                let a = f64::from(i);
                let position = Point3::new(0.05 * (a * 0.7).sin(), 0.05 * (a * 1.3).cos(), 0.03 * (a * 2.1).sin());
                let at = camera.project(&(truth * position)).unwrap();
                let wrong = if i % 4 == 0 { 25.0 } else { 0.0 };
                Match { position, at: Some([at.x + wrong, at.y]) }
            })
            .collect();
        let mut term = TextureTerm { matches: &points, camera, sigma_px: [0.5, 4.0], share: 1.0 };
        let mut pose = retract(&truth, &Vector6::new(0.004, -0.003, 0.01, 0.03, -0.02, 0.02));
        for _ in 0..15 {
            let (mut hessian, mut gradient) = (Matrix6::identity() * 1e-6, Vector6::zeros());
            term.accumulate(&pose, &mut hessian, &mut gradient);
            pose = retract(&pose, &-hessian.cholesky().unwrap().solve(&gradient));
        }
        assert!((pose.to_homogeneous() - truth.to_homogeneous()).norm() < 1e-6);
        assert!((term.agreeing(&pose) - 0.75).abs() < 1e-9);
    }
}
