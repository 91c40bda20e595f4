use crate::points::{Block, LANES};
use pseudoflow_geometry::Pose;

/// `A p + b` in single precision, A row-major.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Affine {
    a: [f32; 9],
    b: [f32; 3],
}

impl Affine {
    /// The map itself.
    pub(crate) fn of(pose: &Pose) -> Self {
        let (r, t) = (pose.rotation.to_rotation_matrix(), pose.translation.vector);
        Self { a: std::array::from_fn(|i| r[(i / 3, i % 3)] as f32), b: std::array::from_fn(|i| t[i] as f32) }
    }

    /// How far apart two poses put a point: `est p - gt p`. The difference is taken in double precision, so that
    /// small errors keep their digits in single.
    pub(crate) fn difference(est: &Pose, gt: &Pose) -> Self {
        let r = est.rotation.to_rotation_matrix().matrix() - gt.rotation.to_rotation_matrix().matrix();
        let t = est.translation.vector - gt.translation.vector;
        Self { a: std::array::from_fn(|i| r[(i / 3, i % 3)] as f32), b: std::array::from_fn(|i| t[i] as f32) }
    }

    #[inline(always)]
    pub(crate) fn apply(&self, p: &Block) -> Block {
        let Self { a, b } = self;
        let mut out = Block { x: [0.0; LANES], y: [0.0; LANES], z: [0.0; LANES] };
        for l in 0..LANES {
            out.x[l] = a[0] * p.x[l] + a[1] * p.y[l] + a[2] * p.z[l] + b[0];
            out.y[l] = a[3] * p.x[l] + a[4] * p.y[l] + a[5] * p.z[l] + b[1];
            out.z[l] = a[6] * p.x[l] + a[7] * p.y[l] + a[8] * p.z[l] + b[2];
        }
        out
    }
}
