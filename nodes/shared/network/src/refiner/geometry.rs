//! What the refiner sees of the rendering's geometry.

/// Fills `planes` (2, S, S) from the rendering's depth (S x S, metres along z, 0 = background): depth relative to its mean over
/// the object, in half widths of the crop at that depth (`2 (z - mean) f / (mean S)`, 0 outside), and the mask (1 on the
/// object). Neither unit nor size of the object matter: the same view of a larger object further away gives the same planes.
///
/// `focal_px` is the focal length of the crop's intrinsics.
///
/// # Panics
/// When the lengths do not belong to `size_px`.
pub fn reference_geometry(depth_m: &[f32], size_px: usize, focal_px: f64, planes: &mut [f32]) {
    let area = size_px * size_px;
    assert!(depth_m.len() == area && planes.len() == 2 * area, "depth and planes of {size_px} px");
    let seen = |d: f32| d > 0.0 && d.is_finite();
    let (sum, count) =
        depth_m.iter().filter(|d| seen(**d)).fold((0.0_f64, 0_usize), |(sum, n), d| (sum + f64::from(*d), n + 1));
    let mean = (sum / count.max(1) as f64) as f32;
    let scale = if count > 0 { (2.0 * focal_px / size_px as f64) as f32 / mean } else { 0.0 };
    let (relative, mask) = planes.split_at_mut(area);
    for (i, &d) in depth_m.iter().enumerate() {
        (relative[i], mask[i]) = if seen(d) { ((d - mean) * scale, 1.0) } else { (0.0, 0.0) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn geometry_does_not_depend_on_the_scale() {
        let depth = [0.0, 1.0, 1.1, f32::NAN, 0.9, 1.0, 0.0, 0.0, 0.0];
        let mut planes = [9.0; 18];
        reference_geometry(&depth, 3, 300.0, &mut planes);
        assert_eq!(planes[9..18], [0.0, 1.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]);
        assert!((planes[2] - 2.0 * 0.1 * 300.0 / 3.0).abs() < 1e-3 && planes[0] == 0.0 && planes[3] == 0.0);
        let mut doubled = [9.0; 18];
        reference_geometry(&depth.map(|d| 2.0 * d), 3, 300.0, &mut doubled);
        assert!(planes.iter().zip(doubled).all(|(a, b)| (a - b).abs() < 1e-3));
    }
}
