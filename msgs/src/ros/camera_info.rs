use super::Header;
use serde::{Deserialize, Serialize};

/// `sensor_msgs/RegionOfInterest`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RegionOfInterest {
    /// Left edge, pixels of the full image.
    pub x_offset: u32,
    /// Upper edge.
    pub y_offset: u32,
    /// Rows; 0 with `width` 0 means the whole image.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// Whether the region should be rectified.
    pub do_rectify: bool,
}

/// `sensor_msgs/CameraInfo`: the calibration of a camera.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraInfo {
    /// Of the image that it belongs to.
    pub header: Header,
    /// Rows of the calibrated image.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// Name of the distortion model.
    pub distortion_model: String,
    /// Distortion coefficients; empty or zero for an image without distortion.
    pub d: Vec<f64>,
    /// Row-major intrinsics of the raw image; K\[0\] = 0 for an uncalibrated camera.
    pub k: [f64; 9],
    /// Rectification, row-major.
    pub r: [f64; 9],
    /// Row-major 3 x 4 projection of the rectified image.
    pub p: [f64; 12],
    /// Pixels of the sensor per pixel of the image, horizontally; 0 means 1.
    pub binning_x: u32,
    /// The same vertically.
    pub binning_y: u32,
    /// Part of the full image that was sent.
    pub roi: RegionOfInterest,
}

super::ros_message!(CameraInfo, "sensor_msgs", "CameraInfo");

/// Why a calibration cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum IntrinsicsError {
    /// A focal length is not positive or a number is not finite.
    #[error("CameraInfo field `{field}` gives fx {0}, fy {1}, cx {2}, cy {3}: calibrate the camera", .intrinsics[0], .intrinsics[1], .intrinsics[2], .intrinsics[3])]
    NotACamera {
        /// `k` or `p`.
        field: &'static str,
        /// fx, fy, cx, cy.
        intrinsics: [f64; 4],
    },
    /// The image is distorted and nothing was said of rectification.
    #[error("CameraInfo field `d` is {0:?}: the image is distorted; rectify it (image_proc) and set `rectified: true`")]
    Distorted(Vec<f64>),
    /// K or P has a skew, which the house's cameras lack.
    #[error("CameraInfo field `{field}` has skew {skew}: only cameras without skew are supported")]
    Skew {
        /// `k` or `p`.
        field: &'static str,
        /// Pixels.
        skew: f64,
    },
    /// Binning or a region of interest is set, which would change the intrinsics.
    #[error(
        "CameraInfo field `{0}` is set: publish the full image with its own intrinsics (binning 0 or 1, empty roi)"
    )]
    Partial(&'static str),
}

impl CameraInfo {
    /// The camera of a rectified image of `size` (width, height): no distortion, K and P alike. `intrinsics`: fx, fy,
    /// cx, cy in pixels.
    #[must_use]
    pub fn pinhole(header: Header, size: (u32, u32), intrinsics: [f64; 4]) -> Self {
        let [fx, fy, cx, cy] = intrinsics;
        Self {
            header,
            width: size.0,
            height: size.1,
            distortion_model: "plumb_bob".into(),
            d: vec![0.0; 5],
            k: [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
            r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            p: [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
            ..Self::default()
        }
    }

    /// fx, fy, cx, cy (pixels, pixel centres at integers) of the image that this belongs to: those of `k`, or of
    /// `p` when the image is `rectified`.
    ///
    /// # Errors
    /// When they are missing, NaN, skewed, or would not hold for the image as it came.
    pub fn intrinsics(&self, rectified: bool) -> Result<[f64; 4], IntrinsicsError> {
        if !rectified && self.d.iter().any(|c| *c != 0.0) {
            return Err(IntrinsicsError::Distorted(self.d.clone()));
        }
        if self.binning_x > 1 || self.binning_y > 1 {
            return Err(IntrinsicsError::Partial("binning"));
        }
        let roi = self.roi;
        let whole = [0, self.width].contains(&roi.width) && [0, self.height].contains(&roi.height);
        if roi.x_offset != 0 || roi.y_offset != 0 || !whole {
            return Err(IntrinsicsError::Partial("roi"));
        }
        let (field, [fx, skew, cx, fy, cy]) = if rectified {
            ("p", [self.p[0], self.p[1], self.p[2], self.p[5], self.p[6]])
        } else {
            ("k", [self.k[0], self.k[1], self.k[2], self.k[4], self.k[5]])
        };
        let intrinsics = [fx, fy, cx, cy];
        if !(intrinsics.iter().all(|v| v.is_finite()) && fx > 0.0 && fy > 0.0) {
            return Err(IntrinsicsError::NotACamera { field, intrinsics });
        }
        if skew != 0.0 {
            return Err(IntrinsicsError::Skew { field, skew });
        }
        Ok(intrinsics)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{from_cdr, to_cdr};
    use super::*;

    #[test]
    fn a_pinhole_gives_its_intrinsics_back() {
        let info = CameraInfo::pinhole(Header::default(), (640, 480), [600.0, 610.0, 320.0, 240.0]);
        for rectified in [false, true] {
            assert_eq!(info.intrinsics(rectified).unwrap(), [600.0, 610.0, 320.0, 240.0]);
        }
    }

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
        assert_eq!(camera().intrinsics(false).unwrap(), [600.0, 610.0, 320.0, 240.0]);
        assert_eq!(camera().intrinsics(true).unwrap(), [500.0, 510.0, 310.0, 230.0]);
        assert_eq!(from_cdr::<CameraInfo>(&to_cdr(&camera()).unwrap()).unwrap(), camera());
    }

    #[test]
    fn what_is_no_usable_calibration_is_refused() {
        let refused = |change: fn(&mut CameraInfo)| {
            let mut info = camera();
            change(&mut info);
            info.intrinsics(false).unwrap_err().to_string()
        };
        assert!(refused(|c| c.k = [0.0; 9]).contains("calibrate"));
        assert!(refused(|c| c.k[2] = f64::NAN).contains("cx NaN"));
        assert!(refused(|c| c.k[4] = -1.0).contains("fy -1"));
        assert!(refused(|c| c.k[1] = 2.0).contains("skew 2"));
        assert!(refused(|c| c.d = vec![0.0, 0.1]).contains("distorted"));
        assert!(refused(|c| c.binning_x = 2).contains("binning"));
        assert!(refused(|c| c.roi.x_offset = 2).contains("roi"));
    }
}
