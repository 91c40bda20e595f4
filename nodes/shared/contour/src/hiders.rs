//! Other known objects that hide parts of a contour.

use crate::lines::{Line, project};
use crate::model::ContourModel;
use crate::picture::Picture;
use pseudoflow_geometry::Pose;

/// Another object at the best pose that is known of it.
#[derive(Debug, Clone, Copy)]
pub struct Hider<'a> {
    /// Its contour.
    pub model: &'a ContourModel,
    /// Its pose.
    pub camera_from_object: Pose,
}

/// The silhouettes of nearer objects in a picture.
#[derive(Debug, Clone, Default)]
pub(crate) struct Hiders {
    outlines: Vec<Outline>,
    lines: Vec<Line>,
}

/// A silhouette as points with normals.
#[derive(Debug, Clone, Default)]
struct Outline {
    places: Vec<[f32; 4]>,
    /// Length of the outline that a point stands for, pixels.
    spacing_px: f32,
    middle: [f32; 2],
    radius_px: f32,
}

/// A point is inside from this winding number on; it is 1 inside, 0 outside, one half on the outline.
const INSIDE: f32 = 0.4;

impl Hiders {
    /// Takes over those of `all` that are nearer than the object at `pose` and whose silhouettes can meet its own.
    pub(crate) fn fill(&mut self, all: &[Hider<'_>], model: &ContourModel, pose: &Pose, picture: &Picture) {
        self.outlines.clear();
        let depth_m = (pose * model.centre_m()).z;
        for hider in all {
            let centre = hider.camera_from_object * hider.model.centre_m();
            if centre.z <= hider.model.radius_m() || centre.z >= depth_m {
                continue;
            }
            let points = hider.model.view(&hider.camera_from_object);
            project(points, &hider.camera_from_object, picture, true, &mut self.lines);
            let outline = Outline::new(&self.lines);
            let half = 0.5 * picture.size_px as f32;
            let away = (outline.middle[0] - half).hypot(outline.middle[1] - half);
            if outline.places.len() > 8 && away < outline.radius_px + 1.5 * half {
                self.outlines.push(outline);
            }
        }
    }

    /// Takes the weight of lines that a nearer object hides.
    pub(crate) fn apply(&self, lines: &mut [Line]) {
        for line in lines {
            if self.outlines.iter().any(|o| o.holds(line.at)) {
                line.weight = 0.0;
            }
        }
    }
}

impl Outline {
    fn new(lines: &[Line]) -> Self {
        let n = lines.len().max(1) as f32;
        let mean = |axis: usize| lines.iter().map(|l| l.at[axis]).sum::<f32>() / n;
        let middle = [mean(0), mean(1)];
        let radius = |l: &Line| (l.at[0] - middle[0]).hypot(l.at[1] - middle[1]);
        // Points follow one another along the outline at equal distances; jumps from one curve to the next are few.
        let mut steps: Vec<f32> =
            lines.windows(2).map(|w| (w[1].at[0] - w[0].at[0]).hypot(w[1].at[1] - w[0].at[1])).collect();
        steps.sort_by(f32::total_cmp);
        Self {
            places: lines.iter().map(|l| [l.at[0], l.at[1], l.normal[0], l.normal[1]]).collect(),
            spacing_px: steps.get(steps.len() / 2).copied().unwrap_or(0.0),
            middle,
            radius_px: lines.iter().map(radius).fold(0.0, f32::max),
        }
    }

    /// Whether a place is inside: the generalised winding number of the points (Barill et al. 2018), in the plane.
    fn holds(&self, at: [f32; 2]) -> bool {
        if (at[0] - self.middle[0]).hypot(at[1] - self.middle[1]) > self.radius_px {
            return false;
        }
        let least2 = (0.5 * self.spacing_px).powi(2).max(1e-6);
        let sum: f32 = self
            .places
            .iter()
            .map(|[x, y, nx, ny]| {
                let (dx, dy) = (x - at[0], y - at[1]);
                (dx * nx + dy * ny) / (dx * dx + dy * dy).max(least2)
            })
            .sum();
        sum * self.spacing_px > INSIDE * std::f32::consts::TAU
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ModelSettings, lines};
    use nalgebra::Vector3;
    use pseudoflow_imaging::shapes::sphere;

    #[test]
    fn what_a_nearer_object_covers_is_not_read() {
        let settings = ModelSettings { divisions: 1, ..ModelSettings::default() };
        let model = ContourModel::new(&sphere(0.05, 24, [9; 3]).unwrap(), &settings).unwrap();
        let picture =
            Picture { size_px: 200, focal: [600.0; 2], centre: [100.0; 2], high: [199.0; 2], ..Picture::default() };
        let pose = Pose::translation(0.0, 0.0, 0.6);
        let hidden = |x: f64, z: f64| {
            let other = Hider { model: &model, camera_from_object: Pose::from(Vector3::new(x, 0.0, z)) };
            let mut hiders = Hiders::default();
            hiders.fill(&[other], &model, &pose, &picture);
            let mut all = Vec::new();
            lines::project(model.view(&pose), &pose, &picture, false, &mut all);
            hiders.apply(&mut all);
            let centre_x = 600.0 * x / z + 100.0;
            let radius = 600.0 * 0.05 / z;
            for line in &all {
                let away = (f64::from(line.at[0]) - centre_x).hypot(f64::from(line.at[1]) - 100.0);
                assert!(
                    (away - radius).abs() < 3.0 || (line.weight == 0.0) == (z < 0.6 && away < radius),
                    "{away} {radius}"
                );
            }
            all.iter().filter(|l| l.weight == 0.0).count()
        };
        assert!((20..100).contains(&hidden(0.04, 0.5)));
        assert_eq!(hidden(0.04, 0.7), 0, "what is behind hides nothing");
        assert_eq!(hidden(0.3, 0.5), 0, "what is beside hides nothing");
    }
}
