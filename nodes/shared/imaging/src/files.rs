use crate::ImagingError;
use image::error::{LimitError, LimitErrorKind};
use image::{
    Delay, DynamicImage, ExtendedColorType, Frame, ImageEncoder, RgbImage, codecs::gif::GifEncoder,
    codecs::gif::Repeat, codecs::jpeg::JpegEncoder, codecs::png::PngEncoder,
};
use std::io::Cursor;
use std::path::Path;

/// Depth along the optical axis, metres, row-major; 0 where there is none.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthImage {
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `height x width` depths, metres.
    pub data_m: Vec<f32>,
}

impl DepthImage {
    /// The depth at a pixel, metres; `None` outside the image and where there is none.
    #[must_use]
    pub fn at(&self, x: u32, y: u32) -> Option<f32> {
        let inside = x < self.width && y < self.height;
        inside.then(|| self.data_m[(y * self.width + x) as usize]).filter(|depth| *depth > 0.0)
    }
}

/// A picture with more pixels, or a longer side, is refused before any of it is decoded: a few KB may claim anything.
const MOST_PIXELS: u64 = 1 << 26;
const LONGEST_SIDE: u32 = 1 << 15;

/// Decodes within limits.
fn decode(bytes: &[u8]) -> image::ImageResult<DynamicImage> {
    let mut limits = image::Limits::default();
    (limits.max_image_width, limits.max_image_height) = (Some(LONGEST_SIDE), Some(LONGEST_SIDE));
    limits.max_alloc = Some(8 * MOST_PIXELS);
    let open = || image::ImageReader::new(Cursor::new(bytes)).with_guessed_format();
    let (width, height) = open()?.into_dimensions()?;
    if u64::from(width) * u64::from(height) > MOST_PIXELS {
        return Err(image::ImageError::Limits(LimitError::from_kind(LimitErrorKind::DimensionError)));
    }
    let mut reader = open()?;
    reader.limits(limits);
    reader.decode()
}

/// Decodes a JPEG or PNG. Grey images get three equal channels, alpha is dropped, 16 bits become 8.
///
/// # Errors
/// [`ImagingError::Image`], with `name` as the path; also when the picture has over 67 million pixels.
pub fn decode_rgb(bytes: &[u8], name: &str) -> Result<RgbImage, ImagingError> {
    let decoded = decode(bytes);
    decoded.map(DynamicImage::into_rgb8).map_err(|source| ImagingError::Image { path: name.into(), source })
}

/// Width and height of a JPEG or PNG, read from its first bytes.
///
/// # Errors
/// [`ImagingError::Image`], with `name` as the path.
pub fn image_size(bytes: &[u8], name: &str) -> Result<(u32, u32), ImagingError> {
    let reader = image::ImageReader::new(Cursor::new(bytes)).with_guessed_format();
    let size = reader.map_err(image::ImageError::IoError).and_then(image::ImageReader::into_dimensions);
    size.map_err(|source| ImagingError::Image { path: name.into(), source })
}

/// Reads a JPEG or PNG file as [`decode_rgb`] does.
///
/// # Errors
/// When the file cannot be read or decoded.
pub fn load_rgb(path: &Path) -> Result<RgbImage, ImagingError> {
    let bytes = std::fs::read(path).map_err(ImagingError::io(path))?;
    decode_rgb(&bytes, &path.to_string_lossy())
}

/// Reads a 16-bit depth PNG of a BOP set; `depth_scale` (scene_camera.json) times the value is millimetres.
///
/// # Errors
/// When the file cannot be read or decoded, or is no grey image.
pub fn load_depth(path: &Path, depth_scale: f64) -> Result<DepthImage, ImagingError> {
    let bytes = std::fs::read(path).map_err(ImagingError::io(path))?;
    let decoded = decode(&bytes).map_err(|source| ImagingError::Image { path: path.to_owned(), source })?;
    if decoded.color().has_color() {
        return Err(ImagingError::field(path, "colour type", "a colour image", "depth must be a 16-bit grey PNG"));
    }
    let grey = decoded.into_luma16();
    let data_m = grey.as_raw().iter().map(|&v| (f64::from(v) * depth_scale * 1e-3) as f32).collect();
    Ok(DepthImage { width: grey.width(), height: grey.height(), data_m })
}

/// PNG bytes of an RGB image.
///
/// # Errors
/// When the encoder fails (an image without pixels).
pub fn encode_png(image: &RgbImage) -> Result<Vec<u8>, ImagingError> {
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(image.as_raw(), image.width(), image.height(), ExtendedColorType::Rgb8)
        .map_err(|source| ImagingError::Image { path: "(PNG encoder)".into(), source })?;
    Ok(bytes)
}

/// JPEG bytes of an RGB image; `quality` from 1 to 100.
///
/// # Errors
/// When the encoder fails (an image without pixels, or a side over 65535).
pub fn encode_jpeg(image: &RgbImage, quality: u8) -> Result<Vec<u8>, ImagingError> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality.clamp(1, 100))
        .write_image(image.as_raw(), image.width(), image.height(), ExtendedColorType::Rgb8)
        .map_err(|source| ImagingError::Image { path: "(JPEG encoder)".into(), source })?;
    Ok(bytes)
}

/// GIF bytes of an animation that repeats for ever. Of each colour the upper five bits are kept: camera noise would make the file
/// several times as large.
///
/// # Errors
/// When the encoder fails (images without pixels, or of different sizes).
pub fn encode_gif(images: &[RgbImage], ms_per_image: u32) -> Result<Vec<u8>, ImagingError> {
    const SPEED: i32 = 10; // of choosing colours, 1 (best) to 30
    let failed = |source| ImagingError::Image { path: "(GIF encoder)".into(), source };
    let mut bytes = Vec::new();
    let mut encoder = GifEncoder::new_with_speed(&mut bytes, SPEED);
    encoder.set_repeat(Repeat::Infinite).map_err(failed)?;
    for image in images {
        let mut calm = DynamicImage::ImageRgb8(image.clone()).into_rgba8();
        calm.iter_mut().for_each(|v| *v = (*v & 0xf8) | 4);
        calm.pixels_mut().for_each(|pixel| pixel[3] = 255);
        let delay = Delay::from_numer_denom_ms(ms_per_image, 1);
        encoder.encode_frame(Frame::from_parts(calm, 0, 0, delay)).map_err(failed)?;
    }
    drop(encoder);
    Ok(bytes)
}

/// Writes a PNG file.
///
/// # Errors
/// When the image cannot be encoded or the file not written.
pub fn save_png(image: &RgbImage, path: &Path) -> Result<(), ImagingError> {
    std::fs::write(path, encode_png(image)?).map_err(ImagingError::io(path))
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn a_png_comes_back_unchanged_and_a_jpeg_nearly() {
        let image = RgbImage::from_fn(16, 9, |x, y| Rgb([(x * 15) as u8, (y * 20) as u8, 90]));
        assert_eq!(decode_rgb(&encode_png(&image).unwrap(), "png").unwrap(), image);
        assert_eq!(image_size(&encode_png(&image).unwrap(), "png").unwrap(), (16, 9));
        let jpeg = decode_rgb(&encode_jpeg(&image, 95).unwrap(), "jpeg").unwrap();
        let worst = jpeg.as_raw().iter().zip(image.as_raw()).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
        assert!(worst < 40, "{worst}");
    }

    #[test]
    fn an_animation_has_its_pictures_in_their_order() {
        use image::AnimationDecoder;
        let images = [0, 120, 240].map(|red| RgbImage::from_pixel(20, 10, Rgb([red, 60, 60])));
        let bytes = encode_gif(&images, 100).unwrap();
        let decoder = image::codecs::gif::GifDecoder::new(std::io::Cursor::new(bytes)).unwrap();
        let frames = decoder.into_frames().collect_frames().unwrap();
        let reds: Vec<i32> = frames.iter().map(|frame| i32::from(frame.buffer().get_pixel(5, 5)[0])).collect();
        assert!(reds.iter().zip([0, 120, 240]).all(|(red, was)| (red - was).abs() < 12), "{reds:?}");
        assert_eq!(frames[1].delay().numer_denom_ms(), (100, 1));
    }

    #[test]
    fn a_foreign_file_is_named() {
        let message = decode_rgb(b"no image", "frame 7").unwrap_err().to_string();
        assert!(message.contains("frame 7") && message.contains("JPEG or PNG"), "{message}");
    }
}
