//! Small vectors of numbers that the compiler turns into vector instructions.
//!
//! The count of lanes is part of the algorithm, so sums have one order on every machine: the same input gives the same
//! bits with and without AVX2 (Rust never fuses a product and a sum by itself). Loops in place of closures throughout:
//! a closure is compiled for the plain machine, also inside a function that is compiled for AVX2.

use std::ops::{Add, AddAssign, Mul, Sub};

/// A whole number of every vector below.
pub(crate) const PADDING: usize = 16;

macro_rules! lanes {
    ($name:ident, $number:ty, $count:literal) => {
        #[doc = concat!(stringify!($count), " numbers, each computed apart.")]
        #[derive(Clone, Copy)]
        #[repr(align(64))]
        pub(crate) struct $name(pub(crate) [$number; $count]);

        impl $name {
            pub(crate) const ZERO: Self = Self([0.0; $count]);

            #[inline(always)]
            pub(crate) fn splat(value: f64) -> Self {
                Self([value as $number; $count])
            }

            #[inline(always)]
            pub(crate) fn load(from: &[f32; $count]) -> Self {
                let mut out = Self::ZERO;
                for i in 0..$count {
                    out.0[i] = from[i] as $number;
                }
                out
            }

            /// The larger of each; a NaN in `self` loses.
            #[inline(always)]
            pub(crate) fn max(self, other: Self) -> Self {
                let mut out = other;
                for i in 0..$count {
                    out.0[i] = if self.0[i] > other.0[i] { self.0[i] } else { other.0[i] };
                }
                out
            }

            #[inline(always)]
            pub(crate) fn recip(self) -> Self {
                let mut out = self;
                for i in 0..$count {
                    out.0[i] = 1.0 / self.0[i];
                }
                out
            }

            /// `self` where `tested > limit`, zero elsewhere.
            #[inline(always)]
            pub(crate) fn where_above(self, tested: Self, limit: Self) -> Self {
                let mut out = Self::ZERO;
                for i in 0..$count {
                    out.0[i] = if tested.0[i] > limit.0[i] { self.0[i] } else { 0.0 };
                }
                out
            }

            /// The sum over the lanes, in their order.
            #[inline(always)]
            pub(crate) fn sum(self) -> f64 {
                self.0.iter().fold(0.0, |sum, &v| sum + f64::from(v))
            }
        }

        lanes!(operator $name, Add, add, $count, +);
        lanes!(operator $name, Sub, sub, $count, -);
        lanes!(operator $name, Mul, mul, $count, *);

        impl AddAssign for $name {
            #[inline(always)]
            fn add_assign(&mut self, other: Self) {
                *self = *self + other;
            }
        }
    };
    (operator $name:ident, $trait:ident, $method:ident, $count:literal, $sign:tt) => {
        impl $trait for $name {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                let mut out = self;
                for i in 0..$count {
                    out.0[i] = self.0[i] $sign other.0[i];
                }
                out
            }
        }
    };
}

lanes!(Singles, f32, 16);
lanes!(Doubles, f64, 8);

/// Calls `$body`, compiled once more for AVX2 where the machine has it. The results are the same to the bit.
macro_rules! with_avx2 {
    ($body:ident ( $($name:ident : $type:ty),* ) -> $output:ty) => {{
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2")]
            fn fast($($name: $type),*) -> $output {
                $body($($name),*)
            }
            if std::arch::is_x86_feature_detected!("avx2") {
                // SAFETY: the line above found AVX2 on this machine.
                return unsafe { fast($($name),*) };
            }
        }
        $body($($name),*)
    }};
}
pub(crate) use with_avx2;
