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
}

#[cfg(test)]
mod tests {
    use super::super::{from_cdr, to_cdr};
    use super::*;

    #[test]
    fn a_pinhole_has_k_and_p_alike_and_goes_through_cdr() {
        let info = CameraInfo::pinhole(Header::default(), (640, 480), [600.0, 610.0, 320.0, 240.0]);
        assert_eq!((info.k[0], info.k[4], info.p[2], info.p[6]), (600.0, 610.0, 320.0, 240.0));
        assert_eq!(from_cdr::<CameraInfo>(&to_cdr(&info).unwrap()).unwrap(), info);
    }
}
