//! Sixteen f32 that the compiler keeps in vector registers, and the choice of the instruction set.
//!
//! Only additions and multiplications, never fused: every instruction set gives the same bits.

use std::ops::{Add, Mul, Sub};

/// Lanes of a [`Pack`].
pub(super) const LANES: usize = 16;

/// Sixteen values that undergo the same arithmetic.
#[derive(Clone, Copy)]
pub(super) struct Pack(pub(super) [f32; LANES]);

impl Pack {
    pub(super) const ZERO: Self = Self([0.0; LANES]);

    /// The first values of a slice, zeros beyond its end.
    #[inline(always)]
    pub(super) fn load(values: &[f32]) -> Self {
        let mut lanes = [0.0; LANES];
        match values.first_chunk::<LANES>() {
            Some(chunk) => lanes = *chunk,
            None => lanes[..values.len()].copy_from_slice(values),
        }
        Self(lanes)
    }

    /// Fills a slice of at most sixteen values.
    #[inline(always)]
    pub(super) fn store(self, values: &mut [f32]) {
        match values.first_chunk_mut::<LANES>() {
            Some(chunk) => *chunk = self.0,
            None => values.copy_from_slice(&self.0[..values.len()]),
        }
    }
}

impl Add for Pack {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + other.0[i]))
    }
}

impl Sub for Pack {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] - other.0[i]))
    }
}

impl Mul<f32> for Pack {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: f32) -> Self {
        Self(std::array::from_fn(|i| self.0[i] * factor))
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
