use super::Distortion;
use nalgebra::Matrix3;
use pseudoflow_msgs::ros::CameraInfo;

/// Why a calibration cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// A focal length is not positive or a number is not finite.
    #[error("CameraInfo field `{field}` gives fx {0}, fy {1}, cx {2}, cy {3}: calibrate the camera", .intrinsics[0], .intrinsics[1], .intrinsics[2], .intrinsics[3])]
    NotACamera {
        /// `k` or `p`.
        field: &'static str,
        /// fx, fy, cx, cy.
        intrinsics: [f64; 4],
    },
    /// K or P has a skew, which the house's cameras lack.
    #[error("CameraInfo field `{field}` has skew {skew}: only cameras without skew are supported")]
    Skew {
        /// `k` or `p`.
        field: &'static str,
        /// Pixels.
        skew: f64,
    },
    /// A coefficient is NaN or infinite.
    #[error("CameraInfo field `{field}[{index}]` is {value}: calibrate the camera")]
    NotFinite {
        /// `d` or `r`.
        field: &'static str,
        /// Which.
        index: usize,
        /// Its value.
        value: f64,
    },
    /// A lens model that nobody here knows.
    #[error("CameraInfo field `distortion_model` is `{0}`: known are plumb_bob, rational_polynomial and equidistant")]
    Model(String),
    /// A number of coefficients that the model does not have.
    #[error("CameraInfo: {model} has {found} coefficients in `d`, needed are {needed:?}")]
    Coefficients {
        /// The model.
        model: String,
        /// How many came.
        found: usize,
        /// How many it has.
        needed: &'static [usize],
    },
    /// The lens would show one thing at two places within the image.
    #[error(
        "CameraInfo field `d`: the distortion folds back inside the image, {radius_px:.0} pixels from the principal point (radius \
         {radius:.3} in units of the focal length): calibrate anew with points out to the corners"
    )]
    Folds {
        /// X / Z of the first ray that comes back.
        radius: f64,
        /// Where it is seen in the image as it came, pixels from the principal point.
        radius_px: f64,
    },
    /// R is no rotation.
    #[error("CameraInfo field `r` is no rotation: calibrate the camera")]
    Rotation,
    /// The image is not of the size that the calibration is for.
    #[error(
        "an image of {image:?} pixels came with a CameraInfo for {info:?} (after roi and binning): publish both from one driver"
    )]
    Resized {
        /// Width and height of the image.
        image: (u32, u32),
        /// Width and height that the calibration gives it.
        info: (u32, u32),
    },
    /// A region that does not lie in the image.
    #[error("CameraInfo field `roi` is {roi:?} in an image of {size:?}: it must lie inside")]
    Region {
        /// x, y, width, height.
        roi: [u32; 4],
        /// Width and height.
        size: (u32, u32),
    },
}

/// What a calibration says about the image as it came: after region of interest and binning.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Calibration {
    /// fx, fy, cx, cy of the image as it came.
    pub(super) raw: [f64; 4],
    pub(super) distortion: Option<Distortion>,
    /// `rectified_from_camera`.
    pub(super) rotation: Matrix3<f64>,
    /// fx, fy, cx, cy of the rectified image.
    pub(super) rectified: [f64; 4],
}

impl Calibration {
    /// Reads a CameraInfo; `rectified`: the image is rectified already, so that P holds and K and D do not.
    pub(super) fn new(info: &CameraInfo, image: (u32, u32), rectified: bool) -> Result<Self, CalibrationError> {
        check_size(info, image)?;
        let partial = |intrinsics| partial(info, intrinsics);
        if rectified {
            let p = partial(checked("p", [info.p[0], info.p[1], info.p[2], info.p[5], info.p[6]])?);
            return Ok(Self { raw: p, distortion: None, rotation: Matrix3::identity(), rectified: p });
        }
        let raw = partial(checked("k", [info.k[0], info.k[1], info.k[2], info.k[4], info.k[5]])?);
        let distortion = Distortion::new(&info.distortion_model, &info.d)?;
        let rotation = rotation(info)?;
        let has_p = distortion.is_some() && info.p[0] != 0.0;
        let rectified =
            if has_p { partial(checked("p", [info.p[0], info.p[1], info.p[2], info.p[5], info.p[6]])?) } else { raw };
        Ok(Self { raw, distortion, rotation: if has_p { rotation } else { Matrix3::identity() }, rectified })
    }
}

fn checked(field: &'static str, [fx, skew, cx, fy, cy]: [f64; 5]) -> Result<[f64; 4], CalibrationError> {
    let intrinsics = [fx, fy, cx, cy];
    if !(intrinsics.iter().all(|v| v.is_finite()) && fx > 0.0 && fy > 0.0) {
        return Err(CalibrationError::NotACamera { field, intrinsics });
    }
    if skew != 0.0 {
        return Err(CalibrationError::Skew { field, skew });
    }
    Ok(intrinsics)
}

/// Region, then binning (REP 104; as `image_geometry` computes it): the region's corner becomes the origin, then all is divided.
fn partial(info: &CameraInfo, [fx, fy, cx, cy]: [f64; 4]) -> [f64; 4] {
    let (bx, by) = (f64::from(info.binning_x.max(1)), f64::from(info.binning_y.max(1)));
    let (x, y) = (f64::from(info.roi.x_offset), f64::from(info.roi.y_offset));
    [fx / bx, fy / by, (cx - x) / bx, (cy - y) / by]
}

/// Width and height of the images that a CameraInfo is for, after region and binning; 0 where it leaves its size 0.
#[must_use]
pub fn image_size_px(info: &CameraInfo) -> (u32, u32) {
    let roi = info.roi;
    let whole = roi.width == 0 && roi.height == 0;
    let rest = (info.width.saturating_sub(roi.x_offset), info.height.saturating_sub(roi.y_offset));
    let full = if whole { rest } else { (roi.width, roi.height) };
    (full.0 / info.binning_x.max(1), full.1 / info.binning_y.max(1))
}

fn check_size(info: &CameraInfo, image: (u32, u32)) -> Result<(), CalibrationError> {
    let roi = info.roi;
    let size = (info.width, info.height);
    let fits =
        |offset: u32, extent: u32, all: u32| all == 0 || offset.checked_add(extent).is_some_and(|end| end <= all);
    if !(fits(roi.x_offset, roi.width, size.0) && fits(roi.y_offset, roi.height, size.1)) {
        return Err(CalibrationError::Region { roi: [roi.x_offset, roi.y_offset, roi.width, roi.height], size });
    }
    let expected = image_size_px(info);
    let unstated = size == (0, 0) && (roi.width, roi.height) == (0, 0);
    if !unstated && expected != image {
        return Err(CalibrationError::Resized { image, info: expected });
    }
    Ok(())
}

/// R; zeros mean that there is none.
fn rotation(info: &CameraInfo) -> Result<Matrix3<f64>, CalibrationError> {
    if let Some(index) = info.r.iter().position(|v| !v.is_finite()) {
        return Err(CalibrationError::NotFinite { field: "r", index, value: info.r[index] });
    }
    if info.r == [0.0; 9] {
        return Ok(Matrix3::identity());
    }
    let r = Matrix3::from_row_slice(&info.r);
    let orthonormal = (r * r.transpose() - Matrix3::identity()).abs().max() < 1e-3;
    if orthonormal && r.determinant() > 0.0 { Ok(r) } else { Err(CalibrationError::Rotation) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_msgs::ros::RegionOfInterest;

    fn camera() -> CameraInfo {
        CameraInfo {
            height: 480,
            width: 640,
            k: [600.0, 0.0, 320.0, 0.0, 610.0, 240.0, 0.0, 0.0, 1.0],
            p: [500.0, 0.0, 310.0, 0.0, 0.0, 510.0, 230.0, 0.0, 0.0, 0.0, 1.0, 0.0],
            ..CameraInfo::default()
        }
    }

    #[test]
    fn raw_images_take_k_and_rectified_ones_p() {
        let read = |rectified| Calibration::new(&camera(), (640, 480), rectified).unwrap().rectified;
        assert_eq!((read(false), read(true)), ([600.0, 610.0, 320.0, 240.0], [500.0, 510.0, 310.0, 230.0]));
    }

    #[test]
    fn region_and_binning_change_the_intrinsics_exactly() {
        let roi = RegionOfInterest { x_offset: 100, y_offset: 40, height: 200, width: 400, do_rectify: false };
        let info = CameraInfo { roi, binning_x: 2, binning_y: 4, ..camera() };
        let read = Calibration::new(&info, (200, 50), false).unwrap();
        assert_eq!(read.raw, [300.0, 152.5, 110.0, 50.0]);
        let error = Calibration::new(&info, (400, 200), false).unwrap_err();
        assert_eq!(error, CalibrationError::Resized { image: (400, 200), info: (200, 50) });
        let outside = CameraInfo { roi: RegionOfInterest { width: u32::MAX, ..roi }, ..camera() };
        assert!(Calibration::new(&outside, (1, 1), false).unwrap_err().to_string().contains("roi"));
    }

    #[test]
    fn what_is_no_usable_calibration_is_refused() {
        let refused = |change: fn(&mut CameraInfo)| {
            let mut info = camera();
            change(&mut info);
            Calibration::new(&info, (640, 480), false).unwrap_err().to_string()
        };
        assert!(refused(|c| c.k = [0.0; 9]).contains("calibrate"));
        assert!(refused(|c| c.k[2] = f64::NAN).contains("cx NaN"));
        assert!(refused(|c| c.k[4] = -1.0).contains("fy -1"));
        assert!(refused(|c| c.k[1] = 2.0).contains("skew 2"));
        assert!(refused(|c| c.d = vec![0.0, 0.1]).contains("distortion_model"));
        assert!(refused(|c| c.r = [0.5; 9]).contains("rotation"));
        assert!(refused(|c| c.width = 641).contains("641"));
    }
}
