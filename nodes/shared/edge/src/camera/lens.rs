use super::calibration::Calibration;
use super::{CalibrationError, Rectifier, image_size_px};
use pseudoflow_msgs::ros::CameraInfo;

/// A camera, ready to take images.
#[derive(Debug, Clone)]
pub struct Lens {
    intrinsics: [f64; 4],
    rectifier: Option<Rectifier>,
}

impl Lens {
    /// Reads a CameraInfo for images of `size` (width, height). `rectified`: the images are rectified already, so that P holds
    /// instead of K and D. Images with distortion are rectified to P, or to K where there is no P.
    ///
    /// # Errors
    /// When the calibration cannot be used for such images.
    pub fn new(info: &CameraInfo, size: (u32, u32), rectified: bool) -> Result<Self, CalibrationError> {
        let calibration = Calibration::new(info, size, rectified)?;
        let rectifier = Rectifier::new(&calibration, size)?;
        Ok(Self { intrinsics: calibration.rectified, rectifier })
    }

    /// Whether a CameraInfo can be used for images of the size that it states.
    ///
    /// # Errors
    /// As [`Self::new`], but for the size.
    pub fn check(info: &CameraInfo, rectified: bool) -> Result<(), CalibrationError> {
        Calibration::new(info, image_size_px(info), rectified).map(|_| ())
    }

    /// fx, fy, cx, cy of what [`Self::rectify`] leaves, pixels.
    #[must_use]
    pub fn intrinsics(&self) -> [f64; 4] {
        self.intrinsics
    }

    /// Whether [`Self::rectify`] changes an image.
    #[must_use]
    pub fn is_distorted(&self) -> bool {
        self.rectifier.is_some()
    }

    /// Where what a pixel of the rectified image shows is in the image as it came; `None` where the lens did not see it. The
    /// pixel itself where nothing is to be done.
    #[must_use]
    pub fn source(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        self.rectifier.as_ref().map_or(Some(pixel), |rectifier| rectifier.source(pixel))
    }

    /// Takes the distortion out of an image of R, G, B; `scratch` is memory to work in.
    pub fn rectify(&self, rgb: &mut Vec<u8>, scratch: &mut Vec<u8>) {
        if let Some(rectifier) = &self.rectifier {
            rectifier.apply(rgb, scratch);
            std::mem::swap(rgb, scratch);
        }
    }
}

/// The lens of the last calibration: made anew when the calibration or the image's size changes.
#[derive(Debug, Default)]
pub struct LensCache {
    made: Option<(CameraInfo, (u32, u32), bool, Lens)>,
}

impl LensCache {
    /// As [`Lens::new`].
    ///
    /// # Errors
    /// As [`Lens::new`].
    pub fn lens(&mut self, info: &CameraInfo, size: (u32, u32), rectified: bool) -> Result<&Lens, CalibrationError> {
        let info = CameraInfo { header: Default::default(), ..info.clone() };
        let made = match self.made.take() {
            Some(made) if (&made.0, made.1, made.2) == (&info, size, rectified) => made,
            // A calibration that cannot be used does not cost the one that can.
            old => {
                let lens = match Lens::new(&info, size, rectified) {
                    Ok(lens) => lens,
                    Err(error) => {
                        self.made = old;
                        return Err(error);
                    }
                };
                if lens.is_distorted() {
                    log::info!("images are rectified: {} {:?}", info.distortion_model, info.d);
                }
                (info, size, rectified, lens)
            }
        };
        Ok(&self.made.insert(made).3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_msgs::ros::Header;

    #[test]
    fn a_lens_is_made_once_for_a_calibration() {
        let mut cache = LensCache::default();
        let mut info = CameraInfo::pinhole(Header::default(), (64, 48), [60.0, 60.0, 32.0, 24.0]);
        assert!(!cache.lens(&info, (64, 48), false).unwrap().is_distorted());
        info.d = vec![-0.1, 0.0, 0.0, 0.0, 0.0];
        assert!(cache.lens(&info, (64, 48), false).unwrap().is_distorted());
        let first = cache.lens(&info, (64, 48), false).unwrap() as *const Lens;
        info.header.stamp.sec = 5;
        assert_eq!(cache.lens(&info, (64, 48), false).unwrap() as *const Lens, first);
        assert!(cache.lens(&info, (48, 64), false).is_err());
        assert_eq!(cache.lens(&info, (64, 48), false).unwrap() as *const Lens, first);
    }
}
