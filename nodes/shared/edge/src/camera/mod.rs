//! A camera as its driver describes it, to one that the house computes with: without distortion, fx, fy, cx, cy of the very
//! image (pixels, pixel centres at integers).

mod calibration;
mod distortion;
mod file;
mod lens;
mod rectify;

pub use calibration::{CalibrationError, image_size_px};
pub use distortion::Distortion;
pub use file::{CalibrationFileError, read_calibration};
pub use lens::{Lens, LensCache};
pub use rectify::Rectifier;
