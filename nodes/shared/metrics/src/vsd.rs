use pseudoflow_geometry::Intrinsics;

/// How far behind the measured surface a rendered one may lie and still count as visible, metres (BOP: 15 mm for all
/// sets but ITODD).
pub const VSD_DELTA_M: f64 = 0.015;

/// Three depth images of one size, row-major, depth along the optical axis in metres, 0 where there is none.
#[derive(Debug, Clone, Copy)]
pub struct VsdDepths<'a> {
    /// Width of the images, pixels.
    pub width: usize,
    /// What the camera measured (or a rendering of everything that is there).
    pub test_m: &'a [f32],
    /// The model rendered in the true pose.
    pub gt_m: &'a [f32],
    /// The model rendered in the estimated pose.
    pub est_m: &'a [f32],
}

/// VSD: the share of the visible surface (of truth or estimate) that is not matched, for each misalignment
/// tolerance. Hodan et al., "BOP: Benchmark for 6D Object Pose Estimation", ECCV 2018, eq. 1, with the visibility
/// masks of 2019 (pixels without measured depth count as visible) and the step cost; bop_toolkit `pose_error.vsd`.
///
/// `intrinsics` belong to the pixels of the images; `taus` are in diameters. Without visible surface the error is 1.
///
/// The toolkit renders with OpenGL, where pixel `(i, j)` samples the point `(i + 0.5, j + 0.5)` of the image that
/// `K` defines; to agree with it, render `gt_m` and `est_m` with the principal point moved by (-0.5, -0.5), and
/// pass the unmoved `K` here.
#[must_use]
pub fn vsd(depths: &VsdDepths, intrinsics: &Intrinsics, diameter_m: f64, delta_m: f64, taus: &[f64; 10]) -> [f64; 10] {
    let (mut union, mut inter, mut far) = (0_usize, 0_usize, [0_usize; 10]);
    for i in 0..depths.gt_m.len().min(depths.est_m.len()).min(depths.test_m.len()) {
        let (gt, est) = (depths.gt_m[i], depths.est_m[i]);
        if gt <= 0.0 && est <= 0.0 {
            continue;
        }
        // From depth along the axis to distance from the camera centre.
        let x = ((i % depths.width) as f64 - intrinsics.cx) / intrinsics.fx;
        let y = ((i / depths.width) as f64 - intrinsics.cy) / intrinsics.fy;
        let slant = (x * x + y * y + 1.0).sqrt();
        let test_m = slant * f64::from(depths.test_m[i]);
        let (gt_m, est_m) = (slant * f64::from(gt), slant * f64::from(est));
        let unoccluded = |d: f64| d > 0.0 && (test_m == 0.0 || d - test_m <= delta_m);
        let gt_visible = unoccluded(gt_m);
        let est_visible = unoccluded(est_m) || (gt_visible && est_m > 0.0);
        union += usize::from(gt_visible || est_visible);
        if gt_visible && est_visible {
            inter += 1;
            let distance = (gt_m - est_m).abs() / diameter_m;
            for (count, tau) in far.iter_mut().zip(taus) {
                *count += usize::from(distance >= *tau);
            }
        }
    }
    far.map(|far| if union == 0 { 1.0 } else { (far + union - inter) as f64 / union as f64 })
}

#[cfg(test)]
mod tests {
    use super::*;

    const K: Intrinsics = Intrinsics { fx: 100.0, fy: 100.0, cx: 1.0, cy: 0.5 };

    fn errors(test_m: &[f32], gt_m: &[f32], est_m: &[f32]) -> [f64; 10] {
        let taus = crate::vsd_taus();
        vsd(&VsdDepths { width: 2, test_m, gt_m, est_m }, &K, 0.1, VSD_DELTA_M, &taus)
    }

    #[test]
    fn equal_depths_have_no_error_and_disjoint_ones_all() {
        assert_eq!(errors(&[0.0; 4], &[1.0, 1.0, 0.0, 0.0], &[1.0, 1.0, 0.0, 0.0]), [0.0; 10]);
        assert_eq!(errors(&[0.0; 4], &[1.0, 1.0, 0.0, 0.0], &[0.0, 0.0, 1.0, 1.0]), [1.0; 10]);
        assert_eq!(errors(&[0.0; 4], &[0.0; 4], &[0.0; 4]), [1.0; 10]);
    }

    #[test]
    fn the_tolerance_counts_in_diameters() {
        // 12 mm apart is 0.12 diameters: wrong for tau 0.05 and 0.1, right from 0.15 on.
        let e = errors(&[0.0; 4], &[1.0, 0.0, 0.0, 0.0], &[1.012, 0.0, 0.0, 0.0]);
        assert_eq!(e, [1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn hidden_surface_does_not_count() {
        // The second pixel is behind something measured 0.1 m nearer, in truth and estimate alike.
        let e = errors(&[1.0, 0.9, 0.0, 0.0], &[1.0, 1.0, 0.0, 0.0], &[1.0, 1.2, 0.0, 0.0]);
        assert_eq!(e, [0.0; 10]);
        // An estimate in front of visible truth is visible; one behind it too, where truth itself is visible.
        let e = errors(&[1.0; 4], &[1.0, 1.0, 0.0, 0.0], &[1.0, 1.2, 0.0, 0.0]);
        assert_eq!(e[0], 0.5);
    }
}
