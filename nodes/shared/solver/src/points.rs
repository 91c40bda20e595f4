use crate::Correspondences;
use crate::lanes::PADDING;
use nalgebra::{Matrix3, Vector3};
use rand::Rng;

/// Where padding is "seen": so far away that no pose makes it an inlier, yet its square is finite in f32.
const NOWHERE_PX: f32 = 1e15;

/// Correspondences, one array for each coordinate, padded to whole lanes with points that are never inliers.
#[derive(Debug, Clone, Default)]
pub(crate) struct PointSet {
    pub(crate) x: Vec<f32>,
    pub(crate) y: Vec<f32>,
    pub(crate) z: Vec<f32>,
    pub(crate) u: Vec<f32>,
    pub(crate) v: Vec<f32>,
    len: usize,
}

impl PointSet {
    /// Count of correspondences, without the padding.
    pub(crate) fn len(&self) -> usize {
        self.len
    }

    fn clear(&mut self) {
        for plane in self.planes() {
            plane.clear();
        }
        self.len = 0;
    }

    fn planes(&mut self) -> [&mut Vec<f32>; 5] {
        [&mut self.x, &mut self.y, &mut self.z, &mut self.u, &mut self.v]
    }

    fn push(&mut self, point: [f32; 5]) {
        for (plane, value) in self.planes().into_iter().zip(point) {
            plane.push(value);
        }
        self.len += 1;
    }

    /// Fills up the last lanes.
    fn pad(&mut self) {
        let Some(last) = self.len.checked_sub(1) else { return };
        let padded = self.len.next_multiple_of(PADDING);
        for plane in [&mut self.x, &mut self.y, &mut self.z] {
            let value = plane[last];
            plane.resize(padded, value);
        }
        self.u.resize(padded, NOWHERE_PX);
        self.v.resize(padded, NOWHERE_PX);
    }

    /// At most `limit` finite correspondences, taken evenly in their order. Returns how many are finite.
    pub(crate) fn fill(&mut self, from: &Correspondences<'_>, limit: usize) -> usize {
        self.clear();
        let all = || from.points_in_object.iter().zip(from.pixels).filter(|(p, q)| is_usable(p, q));
        let finite = all().count();
        let kept = finite.min(limit);
        for (i, (p, q)) in all().enumerate() {
            if is_kept(i, finite, kept) {
                self.push([p[0], p[1], p[2], q[0], q[1]]);
            }
        }
        self.pad();
        finite
    }

    /// At most `limit` points of `from`: one drawn from each of `limit` equal runs, then shuffled, so that every
    /// beginning of the set is a fair sample too. `order` is scratch space.
    pub(crate) fn draw(&mut self, from: &Self, limit: usize, order: &mut Vec<usize>, rng: &mut impl Rng) {
        self.clear();
        let (all, kept) = (from.len, from.len.min(limit));
        order.clear();
        order.extend((0..kept).map(|i| rng.random_range(i * all / kept..(i + 1) * all / kept)));
        for i in (1..kept).rev() {
            order.swap(i, rng.random_range(0..=i));
        }
        for &i in order.iter() {
            self.push([from.x[i], from.y[i], from.z[i], from.u[i], from.v[i]]);
        }
        self.pad();
    }

    /// The first `limit` points of `from`.
    pub(crate) fn take_first(&mut self, from: &Self, limit: usize) {
        self.clear();
        for i in 0..from.len.min(limit) {
            self.push([from.x[i], from.y[i], from.z[i], from.u[i], from.v[i]]);
        }
        self.pad();
    }

    /// Object point i, metres.
    pub(crate) fn point(&self, i: usize) -> Vector3<f64> {
        Vector3::new(f64::from(self.x[i]), f64::from(self.y[i]), f64::from(self.z[i]))
    }

    /// Pixel i.
    pub(crate) fn pixel(&self, i: usize) -> [f64; 2] {
        [f64::from(self.u[i]), f64::from(self.v[i])]
    }

    /// Standard deviations of the points along their principal axes, largest first, metres.
    pub(crate) fn extents_m(&self) -> [f64; 3] {
        let n = self.len.max(1) as f64;
        let mean = (0..self.len).fold(Vector3::zeros(), |sum, i| sum + self.point(i)) / n;
        let scatter = (0..self.len).fold(Matrix3::zeros(), |sum, i| {
            let d = self.point(i) - mean;
            sum + d * d.transpose()
        });
        let mut eigenvalues: [f64; 3] = (scatter / n).symmetric_eigenvalues().into();
        eigenvalues.sort_by(|a, b| b.total_cmp(a));
        eigenvalues.map(|v| v.max(0.0).sqrt())
    }
}

/// Whether all five numbers are finite and within what f32 squares can hold.
fn is_usable(point: &[f32; 3], pixel: &[f32; 2]) -> bool {
    point.iter().chain(pixel).all(|v| v.abs() < 1e9)
}

/// Whether item `i` of `all` is one of `kept` spread evenly.
pub(crate) fn is_kept(i: usize, all: usize, kept: usize) -> bool {
    (i + 1) * kept / all != i * kept / all
}
