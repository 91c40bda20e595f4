use crate::layout::{Length, MalformedMessage, Reader, Writer};
use crate::{CameraFrameHeader, Message, Rectangle, RectanglesHeader};

/// An image of the past in which a detector has seen something, and what: the answer comes later than the frame, so it brings the
/// image along.
///
/// Producer: bridge. Consumer: rectangle_finder.
#[derive(Debug, Clone, Copy)]
pub struct DetectedFrame<'a> {
    /// Size, camera and names of the image.
    pub header: &'a CameraFrameHeader,
    /// Where something was seen.
    pub rectangles: &'a [Rectangle],
    /// `height x width x 3`, RGB, no padding.
    pub rgb: &'a [u8],
}

fn pixel_bytes(header: &CameraFrameHeader) -> usize {
    header.width as usize * header.height as usize * 3
}

impl DetectedFrame<'_> {
    /// Bytes of a message for an image of this size with this many rectangles.
    #[must_use]
    pub fn byte_len(header: &CameraFrameHeader, rectangles: usize) -> usize {
        let length = Length::default().and::<CameraFrameHeader>(1).and::<RectanglesHeader>(1);
        length.and::<Rectangle>(rectangles).and::<u8>(pixel_bytes(header)).bytes()
    }

    /// Writes a whole message.
    ///
    /// # Panics
    /// When `bytes` is shorter than [`Self::byte_len`] or not aligned to 64 bytes, or `rgb` is not of the header's size.
    pub fn write(bytes: &mut [u8], header: CameraFrameHeader, rectangles: &[Rectangle], rgb: &[u8]) {
        let mut writer = Writer::new(bytes);
        let CameraFrameHeader { scene_id, image_id, .. } = header;
        let pixels = pixel_bytes(&header);
        writer.one(header);
        writer.one(RectanglesHeader { count: rectangles.len() as u32, scene_id, image_id, reserved: 0 });
        writer.array::<Rectangle>(rectangles.len()).copy_from_slice(rectangles);
        writer.array::<u8>(pixels).copy_from_slice(rgb);
    }
}

impl Message for DetectedFrame<'static> {
    const TYPE_NAME: &'static str = "DetectedFrame@1";
    type View<'a> = DetectedFrame<'a>;

    fn view(bytes: &[u8]) -> Result<DetectedFrame<'_>, MalformedMessage> {
        let mut reader = Reader::new(Self::TYPE_NAME, bytes)?;
        let header = reader.one::<CameraFrameHeader>("header")?;
        let counts = reader.one::<RectanglesHeader>("counts")?;
        let rectangles = reader.array::<Rectangle>("rectangles", counts.count as usize)?;
        let rgb = reader.array("rgb", pixel_bytes(header))?;
        Ok(DetectedFrame { header, rectangles, rgb })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AlignedBytes;
    use bytemuck::Zeroable;

    #[test]
    fn image_and_rectangles_round_trip() {
        let header = CameraFrameHeader { width: 2, height: 1, image_id: 7, ..CameraFrameHeader::zeroed() };
        let one = Rectangle { object_id: 5, score: 0.5, left: 1.0, top: 2.0, right: 3.0, bottom: 4.0 };
        let mut bytes = AlignedBytes::zeroed(DetectedFrame::byte_len(&header, 1));
        DetectedFrame::write(&mut bytes, header, &[one], &[1, 2, 3, 4, 5, 6]);
        let view = DetectedFrame::view(&bytes).unwrap();
        assert_eq!((view.header.image_id, view.rectangles, view.rgb), (7, &[one][..], &[1, 2, 3, 4, 5, 6][..]));
        assert!(DetectedFrame::view(&AlignedBytes::copy_of(&bytes[..bytes.len() - 1])).is_err());
    }
}
