use crate::affine::Affine;
use nalgebra::{Matrix3, Point3};

/// Points handled together, one per vector lane.
pub(crate) const LANES: usize = 16;

/// Why a list of points cannot be measured with.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PointsError {
    /// No points.
    #[error("the mesh has no vertices: pose errors are means and maxima over vertices")]
    Empty,
    /// A coordinate is NaN or infinite.
    #[error("vertex {index} of the mesh has a coordinate that is not finite: repair the mesh")]
    NotFinite {
        /// Index of the vertex.
        index: usize,
    },
}

/// Sixteen points that lie near one another, coordinate by coordinate.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(64))]
pub(crate) struct Block {
    pub(crate) x: [f32; LANES],
    pub(crate) y: [f32; LANES],
    pub(crate) z: [f32; LANES],
}

/// An axis-aligned box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Bounds {
    pub(crate) low: [f32; 3],
    pub(crate) high: [f32; 3],
}

/// The vertices of a model (metres, object frame), laid out for the error functions of this crate: sorted into a
/// balanced k-d tree whose leaves are blocks of 16 neighbours.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelPoints {
    pub(crate) blocks: Vec<Block>,
    /// Node `i` has the children `2 i` and `2 i + 1`; node `leaves + k` is the box of block `k`. Node 0 is unused.
    pub(crate) nodes: Vec<Bounds>,
    /// A power of two; `leaves - blocks.len()` leaves at the end are empty.
    pub(crate) leaves: usize,
    /// The order in which maxima visit the blocks: coarse to fine over the model.
    pub(crate) coarse_order: Vec<u32>,
    count: usize,
}

impl ModelPoints {
    /// From points in metres in the object's frame. Their order does not matter.
    ///
    /// # Errors
    /// When there are no points or a coordinate is not finite.
    pub fn new<'a>(points_in_object: impl IntoIterator<Item = &'a Point3<f64>>) -> Result<Self, PointsError> {
        let mut points: Vec<[f32; 3]> =
            points_in_object.into_iter().map(|p| [p.x as f32, p.y as f32, p.z as f32]).collect();
        if points.is_empty() {
            return Err(PointsError::Empty);
        }
        if let Some(index) = points.iter().position(|p| p.iter().any(|v| !v.is_finite())) {
            return Err(PointsError::NotFinite { index });
        }
        sort_into_leaves(&mut points);
        let blocks: Vec<Block> = points.chunks(LANES).map(block_of).collect();
        let leaves = blocks.len().next_power_of_two();
        let nodes = bounds_of(&blocks, leaves);
        let coarse_order = coarse_to_fine(blocks.len(), leaves);
        Ok(Self { blocks, nodes, leaves, coarse_order, count: points.len() })
    }

    /// How many points there are (at least 1).
    #[must_use]
    pub fn count(&self) -> usize {
        self.count
    }

    /// The points under a matrix near the identity, in the same blocks.
    pub(crate) fn stretched(&self, by: &Matrix3<f64>) -> Self {
        let map = Affine::linear(by);
        let blocks: Vec<Block> = self.blocks.iter().map(|block| map.apply(block)).collect();
        let nodes = bounds_of(&blocks, self.leaves);
        Self { blocks, nodes, ..self.clone() }
    }

    /// How many lanes of a block hold points of their own; the rest of the last block repeats its last point.
    pub(crate) fn lanes_of(&self, block: usize) -> usize {
        (self.count - block * LANES).min(LANES)
    }
}

fn block_of(points: &[[f32; 3]]) -> Block {
    let at = |lane: usize| points[lane.min(points.len() - 1)];
    Block {
        x: std::array::from_fn(|l| at(l)[0]),
        y: std::array::from_fn(|l| at(l)[1]),
        z: std::array::from_fn(|l| at(l)[2]),
    }
}

/// Halves along the widest axis, each left half a power of two of blocks, down to single blocks.
fn sort_into_leaves(points: &mut [[f32; 3]]) {
    if points.len() <= LANES {
        return;
    }
    let left = points.len().div_ceil(LANES).next_power_of_two() / 2 * LANES;
    let axis = widest_axis(points);
    points.select_nth_unstable_by(left, |a, b| {
        a[axis].total_cmp(&b[axis]).then_with(|| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal))
    });
    let (low, high) = points.split_at_mut(left);
    sort_into_leaves(low);
    sort_into_leaves(high);
}

fn widest_axis(points: &[[f32; 3]]) -> usize {
    let bounds = points.iter().fold(Bounds::EMPTY, |b, p| b.with(*p));
    let extent = |axis: usize| bounds.high[axis] - bounds.low[axis];
    (0..3).max_by(|a, b| extent(*a).total_cmp(&extent(*b))).unwrap_or(0)
}

fn bounds_of(blocks: &[Block], leaves: usize) -> Vec<Bounds> {
    let mut nodes = vec![Bounds::EMPTY; 2 * leaves];
    for (k, b) in blocks.iter().enumerate() {
        nodes[leaves + k] = (0..LANES).fold(Bounds::EMPTY, |bounds, l| bounds.with([b.x[l], b.y[l], b.z[l]]));
    }
    for i in (1..leaves).rev() {
        nodes[i] = nodes[2 * i].union(&nodes[2 * i + 1]);
    }
    nodes
}

/// Block numbers in the order of their reversed bits, which spreads every prefix over the whole model.
fn coarse_to_fine(blocks: usize, leaves: usize) -> Vec<u32> {
    let bits = leaves.trailing_zeros();
    let reversed = |i: usize| if bits == 0 { 0 } else { i.reverse_bits() >> (usize::BITS - bits) };
    (0..leaves).map(reversed).filter(|k| *k < blocks).map(|k| k as u32).collect()
}

impl Bounds {
    pub(crate) const EMPTY: Self = Self { low: [f32::INFINITY; 3], high: [f32::NEG_INFINITY; 3] };

    pub(crate) fn with(self, p: [f32; 3]) -> Self {
        self.union(&Self { low: p, high: p })
    }

    fn union(&self, other: &Self) -> Self {
        Self {
            low: std::array::from_fn(|i| self.low[i].min(other.low[i])),
            high: std::array::from_fn(|i| self.high[i].max(other.high[i])),
        }
    }

    /// Squared distance from a point: 0 inside, infinite when the box is empty.
    #[inline(always)]
    pub(crate) fn distance_squared(&self, p: [f32; 3]) -> f32 {
        let mut sum = 0.0;
        for i in 0..3 {
            let gap = (self.low[i] - p[i]).max(p[i] - self.high[i]).max(0.0);
            sum += gap * gap;
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_is_in_exactly_one_lane() {
        for count in [1, 15, 16, 17, 100, 1000] {
            let points: Vec<Point3<f64>> =
                (0..count).map(|i| Point3::new(f64::from(i * 7 % 31), f64::from(i), f64::from(i * i % 13))).collect();
            let model = ModelPoints::new(&points).unwrap();
            let mut seen: Vec<i32> = (0..model.blocks.len())
                .flat_map(|k| (0..model.lanes_of(k)).map(move |l| (k, l)))
                .map(|(k, l)| model.blocks[k].y[l] as i32)
                .collect();
            seen.sort_unstable();
            assert_eq!(seen, (0..count).collect::<Vec<_>>());
            let mut order = model.coarse_order.clone();
            order.sort_unstable();
            assert_eq!(order, (0..model.blocks.len() as u32).collect::<Vec<_>>());
        }
    }

    #[test]
    fn empty_and_nan_meshes_are_refused() {
        assert_eq!(ModelPoints::new(&[]), Err(PointsError::Empty));
        let points = [Point3::origin(), Point3::new(0.0, f64::NAN, 0.0)];
        assert_eq!(ModelPoints::new(&points), Err(PointsError::NotFinite { index: 1 }));
    }
}
