//! Durations in buckets that grow by an eighth: constant memory, quantiles good to 6 %.

use std::sync::atomic::{AtomicU64, Ordering};

/// Buckets of a histogram: 1 us to over an hour.
pub(crate) const BUCKETS: usize = 256;
const STEPS: u64 = 8;

/// Counts one duration.
pub(crate) fn record(buckets: &[AtomicU64], ns: u64) {
    buckets[bucket(ns).min(BUCKETS - 1)].fetch_add(1, Ordering::Relaxed);
}

fn bucket(ns: u64) -> usize {
    let us = ns / 1000;
    if us < STEPS {
        return us as usize;
    }
    let octave = u64::from(us.ilog2());
    let step = (us >> (octave - 3)) - STEPS;
    ((octave - 2) * STEPS + step) as usize
}

/// Where a bucket begins and how wide it is, microseconds.
fn bounds_us(bucket: usize) -> (f64, f64) {
    let bucket = bucket as u64;
    if bucket < STEPS {
        return (bucket as f64, 1.0);
    }
    let width = ((bucket / STEPS - 1) as f64).exp2();
    ((STEPS + bucket % STEPS) as f64 * width, width)
}

/// The duration that a share of all counted ones does not exceed, milliseconds; `None` when nothing was counted.
pub(crate) fn quantile_ms(buckets: &[AtomicU64], share: f64) -> Option<f64> {
    let counts: Vec<u64> = buckets.iter().map(|count| count.load(Ordering::Relaxed)).collect();
    let total: u64 = counts.iter().sum();
    if total == 0 {
        return None;
    }
    let rank = (share * total as f64).ceil().max(1.0) as u64;
    let mut below = 0;
    for (bucket, count) in counts.iter().enumerate() {
        below += count;
        if below >= rank {
            let (begin, width) = bounds_us(bucket);
            return Some((begin + width / 2.0) / 1000.0);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_quantile_lies_within_an_eighth_of_the_value(us in 8u64..3_000_000_000) {
            let buckets: Vec<AtomicU64> = (0..BUCKETS).map(|_| AtomicU64::new(0)).collect();
            record(&buckets, us * 1000);
            let read = quantile_ms(&buckets, 0.5).unwrap() * 1000.0;
            prop_assert!((read / us as f64 - 1.0).abs() < 0.0626, "{us} us read as {read}");
        }
    }

    #[test]
    fn quantiles_stand_in_order() {
        let buckets: Vec<AtomicU64> = (0..BUCKETS).map(|_| AtomicU64::new(0)).collect();
        assert_eq!(quantile_ms(&buckets, 0.5), None);
        for ms in 1..=100 {
            record(&buckets, ms * 1_000_000);
        }
        let (half, most) = (quantile_ms(&buckets, 0.5).unwrap(), quantile_ms(&buckets, 0.99).unwrap());
        assert!((46.0..54.0).contains(&half) && (92.0..106.0).contains(&most), "{half} {most}");
    }
}
