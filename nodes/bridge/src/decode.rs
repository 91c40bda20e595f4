use pseudoflow_edge::pixels::{PixelError, write_rgb, write_rgb_of_file};
use pseudoflow_msgs::ros::{CompressedImage, Header, Image, RosMessage};

/// What a camera topic can carry.
pub(crate) trait CameraImage: RosMessage {
    fn header(&self) -> &Header;
    /// Pixels in rows, three bytes R, G, B each, into `rgb`; width and height are returned.
    fn decode(&self, rgb: &mut Vec<u8>) -> Result<(u32, u32), PixelError>;
}

impl CameraImage for Image {
    fn header(&self) -> &Header {
        &self.header
    }

    fn decode(&self, rgb: &mut Vec<u8>) -> Result<(u32, u32), PixelError> {
        write_rgb(self, rgb)
    }
}

impl CameraImage for CompressedImage {
    fn header(&self) -> &Header {
        &self.header
    }

    fn decode(&self, rgb: &mut Vec<u8>) -> Result<(u32, u32), PixelError> {
        write_rgb_of_file(self, rgb)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{ImageFormat, RgbImage};
    use std::io::Cursor;

    fn compressed(format: ImageFormat) -> CompressedImage {
        let picture = RgbImage::from_fn(16, 8, |x, y| image::Rgb([x as u8 * 8, y as u8 * 8, 90]));
        let mut data = Cursor::new(Vec::new());
        picture.write_to(&mut data, format).unwrap();
        CompressedImage { format: "test".into(), data: data.into_inner(), ..CompressedImage::default() }
    }

    #[test]
    fn png_comes_back_exactly_and_jpeg_nearly() {
        let (mut exact, mut near) = (Vec::new(), Vec::new());
        assert_eq!(compressed(ImageFormat::Png).decode(&mut exact).unwrap(), (16, 8));
        assert_eq!(compressed(ImageFormat::Jpeg).decode(&mut near).unwrap(), (16, 8));
        assert_eq!(exact[(2 * 16 + 3) * 3..][..3], [24, 16, 90]);
        assert!(exact.iter().zip(&near).all(|(a, b)| a.abs_diff(*b) < 32));
    }

    #[test]
    fn a_cut_off_file_is_an_error_that_names_the_format() {
        let mut cut = compressed(ImageFormat::Png);
        cut.data.truncate(40);
        assert!(cut.decode(&mut Vec::new()).unwrap_err().to_string().contains("`test`"));
    }
}
