use crate::MatrixPose;
use crate::points::{Block, LANES};
use nalgebra::{Matrix3, Vector3};

/// `A p + b` in single precision, A row-major.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Affine {
    a: [f32; 9],
    b: [f32; 3],
}

impl Affine {
    fn new(a: &Matrix3<f64>, b: &Vector3<f64>) -> Self {
        Self { a: std::array::from_fn(|i| a[(i / 3, i % 3)] as f32), b: std::array::from_fn(|i| b[i] as f32) }
    }

    /// A matrix alone.
    pub(crate) fn linear(matrix: &Matrix3<f64>) -> Self {
        Self::new(matrix, &Vector3::zeros())
    }

    /// A pose itself.
    pub(crate) fn of(pose: &MatrixPose) -> Self {
        Self::new(pose.matrix(), pose.translation_m())
    }

    /// How far apart two poses put a point: `est p - gt p`. The difference is taken in double precision, so that
    /// small errors keep their digits in single.
    pub(crate) fn difference(est: &MatrixPose, gt: &MatrixPose) -> Self {
        Self::new(&(est.matrix() - gt.matrix()), &(est.translation_m() - gt.translation_m()))
    }

    /// Points in pose `gt`, seen from the nearest rotation of pose `est`.
    pub(crate) fn relative(est: &MatrixPose, gt: &MatrixPose) -> Self {
        let turn_back = est.pose().rotation.to_rotation_matrix().matrix().transpose();
        Self::new(&(turn_back * gt.matrix()), &(turn_back * (gt.translation_m() - est.translation_m())))
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
