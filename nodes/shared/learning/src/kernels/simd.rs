//! Vectors of f32 and the choice of the instruction set.
//!
//! Only additions and multiplications, never fused: every instruction set gives the same bits.

use pulp::Simd;
use std::ops::{Add, Mul, Sub};

/// Values of the widest vector.
pub(super) const LANES: usize = 16;

/// As much memory as the widest vector.
pub(super) type Lanes = [f32; LANES];

/// A vector of `S::F32_LANES` values, which divides [`LANES`].
#[derive(Clone, Copy)]
pub(super) struct Pack<S: Simd> {
    simd: S,
    pub(super) lanes: S::f32s,
}

impl<S: Simd> Pack<S> {
    #[inline(always)]
    pub(super) fn new(simd: S, lanes: S::f32s) -> Self {
        Self { simd, lanes }
    }

    /// The same value in all lanes.
    #[inline(always)]
    pub(super) fn splat(simd: S, value: f32) -> Self {
        Self { simd, lanes: simd.splat_f32s(value) }
    }

    /// The values, those below `floor` replaced by it; NaN stays, which `f32::max` would hide.
    #[inline(always)]
    pub(super) fn at_least(self, floor: Self) -> Self {
        let below = self.simd.less_than_f32s(self.lanes, floor.lanes);
        Self { lanes: self.simd.select_f32s(below, floor.lanes, self.lanes), ..self }
    }
}

impl<S: Simd> Add for Pack<S> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self { lanes: self.simd.add_f32s(self.lanes, other.lanes), ..self }
    }
}

impl<S: Simd> Sub for Pack<S> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self { lanes: self.simd.sub_f32s(self.lanes, other.lanes), ..self }
    }
}

impl<S: Simd> Mul<f32> for Pack<S> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: f32) -> Self {
        Self { lanes: self.simd.mul_f32s(self.lanes, self.simd.splat_f32s(factor)), ..self }
    }
}

/// Runs `f` compiled for the widest vectors of this processor; `f` must be `#[inline(always)]`.
#[inline]
pub(crate) fn vectorize<R>(f: impl FnOnce() -> R) -> R {
    struct Call<F>(F);
    impl<R, F: FnOnce() -> R> pulp::WithSimd for Call<F> {
        type Output = R;
        #[inline(always)]
        fn with_simd<S: pulp::Simd>(self, _simd: S) -> R {
            (self.0)()
        }
    }
    pulp::Arch::new().dispatch(Call(f))
}
