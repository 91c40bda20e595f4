//! Exponentials that the compiler can vectorise, with the same bits on every machine.

/// e^x with a relative error below 3e-7 for |x| <= 80; clamped outside; NaN stays NaN.
///
/// Range reduction x = n ln 2 + r, |r| <= ln 2 / 2, Taylor polynomial of degree 7, exponent by bits.
#[inline(always)]
pub(crate) fn exp(x: f32) -> f32 {
    const LN2_HIGH: f32 = 0.693_359_4;
    const LN2_LOW: f32 = -2.121_944_4e-4;
    /// Adding and subtracting 1.5 * 2^23 rounds to an integer.
    const ROUND: f32 = 12_582_912.0;
    let clamped = if x > 80.0 { 80.0 } else { x };
    let clamped = if clamped < -80.0 { -80.0 } else { clamped };
    let shifted = clamped * std::f32::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = clamped - n * LN2_HIGH - n * LN2_LOW;
    let mut p = 1.0 / 5040.0;
    for c in [1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
        p = p * r + c;
    }
    // The low bits of `shifted` are n; moved up they add n to the exponent of p, which lies in [0.7, 1.5].
    f32::from_bits(p.to_bits().wrapping_add(shifted.to_bits() << 23))
}

/// 1 / (1 + e^-x).
#[inline(always)]
pub(crate) fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

/// Hyperbolic tangent with an absolute error below 3e-7.
#[inline(always)]
pub(crate) fn tanh(x: f32) -> f32 {
    1.0 - 2.0 / (1.0 + exp(2.0 * x))
}

/// ln x with an error below 2e-7 (1 + |ln x|), for normal positive x.
///
/// x = 2^n m with m in [sqrt(1/2), sqrt(2)), then the series of 2 artanh((m - 1) / (m + 1)).
#[inline(always)]
pub(crate) fn ln(x: f32) -> f32 {
    // The bits of sqrt(1/2): subtracting them leaves n in the exponent's place.
    const HALF_ROOT: u32 = 0x3f35_04f3;
    let shifted = x.to_bits().wrapping_sub(HALF_ROOT);
    let n = (shifted as i32) >> 23;
    let m = f32::from_bits((shifted & 0x007f_ffff).wrapping_add(HALF_ROOT));
    let z = (m - 1.0) / (m + 1.0);
    let square = z * z;
    let mut p = 2.0 / 9.0;
    for c in [2.0 / 7.0, 2.0 / 5.0, 2.0 / 3.0, 2.0] {
        p = p * square + c;
    }
    n as f32 * std::f32::consts::LN_2 + p * z
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn close_to_double_precision() {
        for i in -80_000..=80_000 {
            let x = i as f32 * 1e-3;
            let exact = f64::from(x);
            assert!((f64::from(exp(x)) / exact.exp() - 1.0).abs() < 3e-7, "exp({x})");
            assert!((f64::from(sigmoid(x)) - 1.0 / (1.0 + (-exact).exp())).abs() < 3e-7, "sigmoid({x})");
            assert!((f64::from(tanh(x)) - exact.tanh()).abs() < 3e-7, "tanh({x})");
        }
    }

    #[test]
    fn logarithm_is_close_to_double_precision() {
        for i in 1..=200_000 {
            for x in [i as f32 * 1e-4, i as f32 * 1e-7, i as f32 * 10.0] {
                let exact = f64::from(x).ln();
                assert!((f64::from(ln(x)) - exact).abs() < 2e-7 * (1.0 + exact.abs()), "ln({x})");
            }
        }
        assert_eq!(ln(1.0), 0.0);
    }

    #[test]
    fn extremes() {
        assert_eq!(sigmoid(f32::INFINITY), 1.0);
        assert!(sigmoid(f32::NEG_INFINITY) < 1e-30);
        assert_eq!(tanh(f32::NEG_INFINITY), -1.0);
        assert!(exp(f32::NAN).is_nan() && tanh(f32::NAN).is_nan());
    }
}
