//! Pixels as camera drivers publish them, to rows of R, G, B of 8 bits each (sRGB as the driver had it).
//!
//! | encoding | bytes a pixel | here |
//! |---|---|---|
//! | `rgb8`, `bgr8` (`8UC3`), `rgba8`, `bgra8` (`8UC4`), `mono8` (`8UC1`) | 1 to 4 | copied |
//! | `mono16`, `rgb16`, `bgr16`, `rgba16`, `bgra16` | 2 to 8 | scaled by 255 / 65535, rounded |
//! | `bayer_{rggb,bggr,gbrg,grbg}{8,16}` | 1, 2 | bilinear (`bayer`) |
//! | `yuv422`, `uyvy`; `yuv422_yuy2`, `yuyv` | 2 | BT.601, 16 to 235 (`yuv`) |
//! | `nv12`, `nv21` | 3/2 | the same |
//!
//! Depth (`16UC1`, `32FC1`) is no picture and refused.

mod bayer;
mod yuv;

use pseudoflow_imaging::{decode_rgb, image_size};
use pseudoflow_msgs::ros::{CompressedImage, Image};

/// No camera has more pixels; a small file may claim more.
const MOST_PIXELS: u64 = 1 << 27;

/// Why an image cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PixelError {
    /// A layout that is no colour or grey image.
    #[error(
        "image encoding `{0}` is not supported: publish rgb8, bgr8, rgba8, bgra8, mono8, mono16, rgb16, bgr16, bayer_*8, yuv422, \
         yuv422_yuy2, nv12 or nv21"
    )]
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
    /// No pixels, or an odd number where pairs are needed.
    #[error("an image of {width} x {height} pixels `{encoding}`: {needs}")]
    Shape {
        /// Pixels per row.
        width: u32,
        /// Rows.
        height: u32,
        /// Layout of a pixel.
        encoding: String,
        /// What it must have.
        needs: &'static str,
    },
    /// A file that cannot be read.
    #[error("CompressedImage of format `{format}`: {cause}; publish jpeg or png of a colour or grey image")]
    Compressed {
        /// The message's `format`.
        format: String,
        /// What the decoder said.
        cause: String,
    },
}

/// How the bytes of a row are to be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Layout {
    /// Channels a pixel, bytes a channel, and the channel of R, G and B.
    Channels { count: usize, bytes: usize, rgb: [usize; 3] },
    /// Colour of the first two pixels of the first two rows; bytes a pixel.
    Bayer { pattern: bayer::Pattern, bytes: usize },
    /// Place of Y and U in the four bytes of two pixels.
    Packed(yuv::Order),
    /// A plane of Y and, at half the size, one of pairs; whether U comes first in them.
    Planes { u_first: bool },
}

fn layout(encoding: &str) -> Option<Layout> {
    let channels = |count, bytes, rgb| Some(Layout::Channels { count, bytes, rgb });
    match encoding {
        "rgb8" => channels(3, 1, [0, 1, 2]),
        "bgr8" | "8UC3" => channels(3, 1, [2, 1, 0]),
        "rgba8" => channels(4, 1, [0, 1, 2]),
        "bgra8" | "8UC4" => channels(4, 1, [2, 1, 0]),
        "mono8" | "8UC1" => channels(1, 1, [0; 3]),
        "mono16" => channels(1, 2, [0; 3]),
        "rgb16" => channels(3, 2, [0, 1, 2]),
        "bgr16" => channels(3, 2, [2, 1, 0]),
        "rgba16" => channels(4, 2, [0, 1, 2]),
        "bgra16" => channels(4, 2, [2, 1, 0]),
        "yuv422" | "uyvy" => Some(Layout::Packed(yuv::Order::Uyvy)),
        "yuv422_yuy2" | "yuyv" => Some(Layout::Packed(yuv::Order::Yuyv)),
        "nv12" => Some(Layout::Planes { u_first: true }),
        "nv21" => Some(Layout::Planes { u_first: false }),
        other => {
            let named = other.strip_prefix("bayer_")?;
            let (pattern, bits) = named.split_at_checked(4)?;
            let bytes = match bits {
                "8" => 1,
                "16" => 2,
                _ => return None,
            };
            Some(Layout::Bayer { pattern: bayer::Pattern::named(pattern)?, bytes })
        }
    }
}

/// Whether [`write_rgb`] would read an image.
///
/// # Errors
/// As [`write_rgb`].
pub fn check_rgb(image: &Image) -> Result<(), PixelError> {
    read_layout(image).map(|_| ())
}

fn read_layout(image: &Image) -> Result<Layout, PixelError> {
    let layout = layout(&image.encoding).ok_or_else(|| PixelError::Encoding(image.encoding.clone()))?;
    check(image, layout).map(|()| layout)
}

/// The pixels of an image in rows from the top, without padding, three bytes R, G, B each, into `rgb`; width and height.
///
/// # Errors
/// When the encoding is not listed above, there are no pixels, or the data are shorter than the size says.
pub fn write_rgb(image: &Image, rgb: &mut Vec<u8>) -> Result<(u32, u32), PixelError> {
    let layout = read_layout(image)?;
    let (width, height, step) = (image.width as usize, image.height as usize, image.step as usize);
    let rows = image.data.chunks_exact(step).take(height);
    rgb.clear();
    rgb.reserve(width * height * 3);
    match layout {
        Layout::Channels { count, bytes: 1, rgb: order } => rows.for_each(|row| copy(row, width, count, order, rgb)),
        Layout::Channels { count, rgb: order, .. } => {
            rows.for_each(|row| copy(&narrow(row, image.is_bigendian), width, count, order, rgb));
        }
        Layout::Bayer { pattern, bytes } => {
            let plane: Vec<u8> = match bytes {
                1 => rows.flat_map(|row| &row[..width]).copied().collect(),
                _ => rows.flat_map(|row| narrow(&row[..2 * width], image.is_bigendian)).collect(),
            };
            bayer::demosaic(&plane, width, height, pattern, rgb);
        }
        Layout::Packed(order) => rows.for_each(|row| yuv::packed(&row[..2 * width], order, rgb)),
        Layout::Planes { u_first } => yuv::planes(&image.data, width, height, step, u_first, rgb),
    }
    Ok((image.width, image.height))
}

/// The pixels of an image file, as [`write_rgb`].
///
/// # Errors
/// When it is no JPEG or PNG, damaged, or holds depth.
pub fn write_rgb_of_file(image: &CompressedImage, rgb: &mut Vec<u8>) -> Result<(u32, u32), PixelError> {
    let refused = |cause: String| PixelError::Compressed { format: image.format.clone(), cause };
    let format = image.format.as_str();
    if format.starts_with("16UC1") || format.starts_with("32FC1") || format.contains("compressedDepth") {
        return Err(refused("it holds depth".into()));
    }
    if format.contains("compressed bayer_") {
        return Err(refused("the file holds a Bayer mosaic".into()));
    }
    let announced = image_size(&image.data, "image").map_err(|error| refused(error.to_string()))?;
    if u64::from(announced.0) * u64::from(announced.1) > MOST_PIXELS {
        return Err(refused(format!("{announced:?} pixels are too many")));
    }
    let decoded = decode_rgb(&image.data, "image").map_err(|error| refused(error.to_string()))?;
    let size = decoded.dimensions();
    if size.0 == 0 || size.1 == 0 {
        return Err(refused("it has no pixels".into()));
    }
    *rgb = decoded.into_raw();
    Ok(size)
}

fn check(image: &Image, layout: Layout) -> Result<(), PixelError> {
    let (width, height) = (image.width as usize, image.height as usize);
    let shape = |needs| {
        let (width, height, encoding) = (image.width, image.height, image.encoding.clone());
        PixelError::Shape { width, height, encoding, needs }
    };
    if width == 0 || height == 0 {
        return Err(shape("it has no pixels"));
    }
    let (row_bytes, rows) = match layout {
        Layout::Channels { count, bytes, .. } => (width.saturating_mul(count * bytes), height),
        Layout::Bayer { .. } if width < 2 || height < 2 => return Err(shape("a mosaic has at least 2 x 2")),
        Layout::Bayer { bytes, .. } => (width.saturating_mul(bytes), height),
        Layout::Packed(_) if width % 2 != 0 => return Err(shape("two pixels share a colour: the width must be even")),
        Layout::Packed(_) => (width.saturating_mul(2), height),
        Layout::Planes { .. } if width % 2 != 0 || height % 2 != 0 => {
            return Err(shape("four pixels share a colour: width and height must be even"));
        }
        Layout::Planes { .. } => (width, height.saturating_add(height / 2)),
    };
    let step = image.step as usize;
    let needed = step.checked_mul(rows);
    if step < row_bytes || needed.is_none_or(|needed| needed > image.data.len()) {
        return Err(PixelError::Size {
            width: image.width,
            height: image.height,
            encoding: image.encoding.clone(),
            step: image.step,
            available: image.data.len(),
        });
    }
    Ok(())
}

fn copy(row: &[u8], width: usize, count: usize, order: [usize; 3], rgb: &mut Vec<u8>) {
    let row = &row[..width * count];
    match (count, order) {
        (3, [0, 1, 2]) => rgb.extend_from_slice(row),
        (3, _) => rgb.extend(row.as_chunks::<3>().0.iter().flat_map(|[b, g, r]| [*r, *g, *b])),
        (1, _) => rgb.extend(row.iter().flat_map(|grey| [*grey; 3])),
        _ => rgb.extend(row.chunks_exact(count).flat_map(|pixel| order.map(|c| pixel[c]))),
    }
}

/// Numbers of 16 bits to 8: 65535 becomes 255.
fn narrow(row: &[u8], is_bigendian: u8) -> Vec<u8> {
    let value = |pair: &[u8; 2]| if is_bigendian == 0 { u16::from_le_bytes(*pair) } else { u16::from_be_bytes(*pair) };
    row.as_chunks::<2>().0.iter().map(|pair| ((u32::from(value(pair)) * 255 + 32_767) / 65_535) as u8).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(encoding: &str, (width, height): (u32, u32), step: u32, data: &[u8]) -> Image {
        Image { height, width, encoding: encoding.into(), step, data: data.to_vec(), ..Image::default() }
    }

    fn rgb_of(encoding: &str, width: u32, step: u32, data: &[u8]) -> Result<Vec<u8>, PixelError> {
        let mut rgb = vec![1, 2, 3];
        write_rgb(&message(encoding, (width, 2), step, data), &mut rgb)?;
        Ok(rgb)
    }

    #[test]
    fn pixels_become_rgb_without_padding() {
        assert_eq!(rgb_of("rgb8", 1, 4, &[1, 2, 3, 0, 4, 5, 6, 0]).unwrap(), [1, 2, 3, 4, 5, 6]);
        assert_eq!(rgb_of("bgr8", 1, 3, &[1, 2, 3, 4, 5, 6]).unwrap(), [3, 2, 1, 6, 5, 4]);
        assert_eq!(rgb_of("bgra8", 1, 4, &[1, 2, 3, 9, 4, 5, 6, 9]).unwrap(), [3, 2, 1, 6, 5, 4]);
        assert_eq!(rgb_of("mono8", 2, 2, &[1, 2, 3, 4]).unwrap(), [1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4]);
    }

    #[test]
    fn sixteen_bits_are_scaled_in_either_byte_order() {
        assert_eq!(rgb_of("mono16", 1, 2, &[255, 255, 0, 128]).unwrap(), [255, 255, 255, 128, 128, 128]);
        assert_eq!(rgb_of("bgr16", 1, 6, &[0, 0, 0, 1, 0, 2, 0, 0, 0, 1, 0, 2]).unwrap(), [2, 1, 0, 2, 1, 0]);
        let mut big = message("mono16", (1, 1), 2, &[1, 0]);
        big.is_bigendian = 1;
        let mut rgb = Vec::new();
        write_rgb(&big, &mut rgb).unwrap();
        assert_eq!(rgb, [1, 1, 1]);
    }

    #[test]
    fn contradictory_sizes_and_other_encodings_are_refused() {
        for encoding in ["16UC1", "32FC1", "bayer_rggb12", "bayer_rg", "bayer_äöü8", ""] {
            assert_eq!(rgb_of(encoding, 1, 2, &[0; 4]), Err(PixelError::Encoding(encoding.into())));
        }
        for (width, step, bytes) in [(2, 6, 11), (2, 5, 12), (u32::MAX, u32::MAX, 12)] {
            let error = rgb_of("rgb8", width, step, &vec![0; bytes]).unwrap_err();
            assert!(matches!(error, PixelError::Size { .. }), "{error}");
        }
        for (encoding, width) in [("rgb8", 0), ("yuv422", 3), ("nv12", 1), ("bayer_rggb8", 1)] {
            let error = rgb_of(encoding, width, 64, &[0; 256]).unwrap_err();
            assert!(matches!(error, PixelError::Shape { .. }), "{error}");
        }
        let short = rgb_of("nv12", 2, 2, &[0; 5]).unwrap_err();
        assert!(matches!(short, PixelError::Size { .. }), "{short}");
    }

    #[test]
    fn png_comes_back_exactly_and_jpeg_nearly() {
        let picture = image::RgbImage::from_fn(16, 8, |x, y| image::Rgb([x as u8 * 8, y as u8 * 8, 90]));
        let file = |format| {
            let mut data = std::io::Cursor::new(Vec::new());
            picture.write_to(&mut data, format).unwrap();
            CompressedImage { format: "test".into(), data: data.into_inner(), ..CompressedImage::default() }
        };
        let (mut exact, mut near) = (Vec::new(), Vec::new());
        assert_eq!(write_rgb_of_file(&file(image::ImageFormat::Png), &mut exact).unwrap(), (16, 8));
        assert_eq!(write_rgb_of_file(&file(image::ImageFormat::Jpeg), &mut near).unwrap(), (16, 8));
        assert_eq!(&exact, picture.as_raw());
        assert!(exact.iter().zip(&near).all(|(a, b)| a.abs_diff(*b) < 32));
    }

    #[test]
    fn files_of_depth_and_damaged_files_are_refused() {
        for format in
            ["16UC1; png compressed ", "32FC1; compressedDepth png", "bayer_rggb8; jpeg compressed bayer_rggb8"]
        {
            let file = CompressedImage { format: format.into(), ..CompressedImage::default() };
            assert!(write_rgb_of_file(&file, &mut Vec::new()).unwrap_err().to_string().contains(format));
        }
        let file = CompressedImage { format: "jpeg".into(), data: vec![0xff, 0xd8, 1], ..CompressedImage::default() };
        assert!(write_rgb_of_file(&file, &mut Vec::new()).is_err());
    }
}
