use super::Header;
use serde::{Deserialize, Serialize};

/// `sensor_msgs/Image`: an uncompressed image.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Image {
    /// When and where it was taken.
    pub header: Header,
    /// Rows.
    pub height: u32,
    /// Pixels per row.
    pub width: u32,
    /// Layout of a pixel: `rgb8`, `bgr8`, `mono8`, ...
    pub encoding: String,
    /// Whether numbers of several bytes have the high byte first.
    pub is_bigendian: u8,
    /// Bytes per row, padding included.
    pub step: u32,
    /// `height x step` bytes.
    #[serde(with = "serde_bytes")]
    pub data: Vec<u8>,
}

super::ros_message!(Image, "sensor_msgs", "Image");

/// Why an image cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ImageError {
    /// A layout that is no colour or grey image of 8 bits.
    #[error("image encoding `{0}` is not supported: publish rgb8, bgr8, rgba8, bgra8 or mono8")]
    Encoding(String),
    /// The sizes contradict each other.
    #[error(
        "an image of {width} x {height} pixels `{encoding}` with step {step} cannot have {available} bytes of data: is the message cut off?"
    )]
    Size {
        /// Pixels per row.
        width: u32,
        /// Rows.
        height: u32,
        /// Layout of a pixel.
        encoding: String,
        /// Bytes per row.
        step: u32,
        /// Bytes that came.
        available: usize,
    },
}

impl Image {
    /// The pixels in rows from the top, without padding, each three bytes R, G, B; none for an empty image.
    ///
    /// # Errors
    /// When the encoding is not one of 8-bit colour or grey, or the data are shorter than the size says.
    pub fn write_rgb(&self, rgb: &mut Vec<u8>) -> Result<(), ImageError> {
        let (channels, order) = self.layout()?;
        let (width, step) = (self.width as usize, self.step as usize);
        let needed = step.checked_mul(self.height as usize);
        if step < width.saturating_mul(channels) || needed.is_none_or(|needed| needed > self.data.len()) {
            return Err(ImageError::Size {
                width: self.width,
                height: self.height,
                encoding: self.encoding.clone(),
                step: self.step,
                available: self.data.len(),
            });
        }
        rgb.clear();
        if width == 0 {
            return Ok(());
        }
        for row in self.data.chunks_exact(step).take(self.height as usize) {
            if (channels, order) == (3, [0, 1, 2]) {
                rgb.extend_from_slice(&row[..width * 3]);
            } else {
                rgb.extend(row[..width * channels].chunks_exact(channels).flat_map(|pixel| order.map(|c| pixel[c])));
            }
        }
        Ok(())
    }

    /// Bytes per pixel, and where in a pixel R, G and B are.
    fn layout(&self) -> Result<(usize, [usize; 3]), ImageError> {
        match self.encoding.as_str() {
            "rgb8" => Ok((3, [0, 1, 2])),
            "bgr8" | "8UC3" => Ok((3, [2, 1, 0])),
            "rgba8" => Ok((4, [0, 1, 2])),
            "bgra8" | "8UC4" => Ok((4, [2, 1, 0])),
            "mono8" | "8UC1" => Ok((1, [0, 0, 0])),
            other => Err(ImageError::Encoding(other.to_owned())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{from_cdr, to_cdr};
    use super::*;

    #[test]
    fn cdr_has_the_layout_of_the_msg_file() {
        let image = Image {
            header: Header { frame_id: "cam".into(), ..Header::default() },
            height: 1,
            width: 2,
            encoding: "mono8".into(),
            is_bigendian: 0,
            step: 2,
            data: vec![7, 9],
        };
        #[rustfmt::skip]
        let expected = [
            0, 1, 0, 0, // encapsulation
            0, 0, 0, 0, 0, 0, 0, 0, // stamp
            4, 0, 0, 0, b'c', b'a', b'm', 0, // frame_id
            1, 0, 0, 0, 2, 0, 0, 0, // height, width
            6, 0, 0, 0, b'm', b'o', b'n', b'o', b'8', 0, // encoding
            0, 0, // is_bigendian, padding
            2, 0, 0, 0, 2, 0, 0, 0, 7, 9, // step, data
        ];
        assert_eq!(to_cdr(&image).unwrap(), expected);
        assert_eq!(from_cdr::<Image>(&expected).unwrap(), image);
    }

    fn rgb_of(encoding: &str, width: u32, step: u32, data: &[u8]) -> Result<Vec<u8>, ImageError> {
        let height = 2;
        let image = Image { height, width, encoding: encoding.into(), step, data: data.to_vec(), ..Image::default() };
        let mut rgb = vec![1, 2, 3];
        image.write_rgb(&mut rgb)?;
        Ok(rgb)
    }

    #[test]
    fn pixels_become_rgb_without_padding() {
        assert_eq!(rgb_of("rgb8", 1, 4, &[1, 2, 3, 0, 4, 5, 6, 0]).unwrap(), [1, 2, 3, 4, 5, 6]);
        assert_eq!(rgb_of("bgr8", 1, 3, &[1, 2, 3, 4, 5, 6]).unwrap(), [3, 2, 1, 6, 5, 4]);
        assert_eq!(rgb_of("bgra8", 1, 4, &[1, 2, 3, 9, 4, 5, 6, 9]).unwrap(), [3, 2, 1, 6, 5, 4]);
        assert_eq!(rgb_of("mono8", 2, 2, &[1, 2, 3, 4]).unwrap(), [1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4]);
        assert_eq!(rgb_of("rgb8", 0, 0, &[]).unwrap(), []);
    }

    #[test]
    fn contradictory_sizes_and_other_encodings_are_refused() {
        assert_eq!(rgb_of("16UC1", 1, 2, &[0; 4]), Err(ImageError::Encoding("16UC1".into())));
        for (width, step, bytes) in [(2, 6, 11), (2, 5, 12), (u32::MAX, u32::MAX, 12)] {
            let error = rgb_of("rgb8", width, step, &vec![0; bytes]).unwrap_err();
            assert!(matches!(error, ImageError::Size { .. }), "{error}");
        }
    }
}
