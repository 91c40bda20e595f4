//! RAFT-small's upsampling of the flow: eight times bilinear with `align_corners`, values times 8.

/// Upsampling factor of the feature resolution.
pub const UPSAMPLING: usize = 8;

/// The (8 n, n) interpolation matrix A, row-major.
pub fn align_corners_matrix(n: usize) -> Vec<f32> {
    let fine = UPSAMPLING * n;
    let mut a = vec![0.0; fine * n];
    for i in 0..fine {
        let position = (i * (n - 1)) as f64 / (fine - 1) as f64;
        let low = (position.floor() as usize).min(n.saturating_sub(2));
        let fraction = position - low as f64;
        a[i * n + low] += (1.0 - fraction) as f32;
        if low + 1 < n {
            a[i * n + low + 1] += fraction as f32;
        }
    }
    a
}
