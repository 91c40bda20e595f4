use crate::Message;
use crate::layout::{Length, MalformedMessage, Reader, Writer};
use bytemuck::{Pod, Zeroable};

/// Bytes kept for the name of the optical frame, zero-terminated UTF-8.
pub const FRAME_ID_BYTES: usize = 64;

/// What stands before the pixels of a [`CameraFrame`].
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct CameraFrameHeader {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// BOP scene of the frame; 0 where there is none.
    pub scene_id: u32,
    /// BOP image of the frame; the frame's count where there is none.
    pub image_id: u32,
    /// fx, fy, cx, cy in pixels (pixel centres at integers), image already rectified.
    pub intrinsics: [f64; 4],
    /// Name of the optical frame, zero-terminated UTF-8.
    pub frame_id: [u8; FRAME_ID_BYTES],
}

impl CameraFrameHeader {
    /// The name of the optical frame.
    #[must_use]
    pub fn frame_id(&self) -> &str {
        let end = self.frame_id.iter().position(|b| *b == 0).unwrap_or(FRAME_ID_BYTES);
        std::str::from_utf8(&self.frame_id[..end]).unwrap_or("")
    }

    /// Puts a name into the fixed field; `None` when it is longer than 63 bytes.
    #[must_use]
    pub fn frame_id_bytes(name: &str) -> Option<[u8; FRAME_ID_BYTES]> {
        let mut bytes = [0; FRAME_ID_BYTES];
        bytes[..FRAME_ID_BYTES - 1].get_mut(..name.len())?.copy_from_slice(name.as_bytes());
        Some(bytes)
    }
}

/// One rectified colour image of the camera.
///
/// Producers: player, bridge. Consumers: renderer, recorder, initializer.
///
/// ```
/// use pseudoflow_msgs::{AlignedBytes, CameraFrame, CameraFrameHeader, Message};
///
/// let frame_id = CameraFrameHeader::frame_id_bytes("camera_optical").expect("at most 63 bytes");
/// let intrinsics = [600.0, 600.0, 0.5, 0.5];
/// let header = CameraFrameHeader { width: 2, height: 2, scene_id: 0, image_id: 0, intrinsics, frame_id };
/// let mut bytes = AlignedBytes::zeroed(CameraFrame::byte_len(2, 2));
/// CameraFrame::write(&mut bytes, header).rgb.fill(200);
///
/// let frame = CameraFrame::view(&bytes)?;
/// assert_eq!((frame.header.frame_id(), frame.rgb.len()), ("camera_optical", 12));
/// # Ok::<(), pseudoflow_msgs::MalformedMessage>(())
/// ```
#[derive(Debug, Clone, Copy)]
pub struct CameraFrame<'a> {
    /// Size, camera and names.
    pub header: &'a CameraFrameHeader,
    /// `height x width x 3`, RGB, no padding.
    pub rgb: &'a [u8],
}

/// A [`CameraFrame`] being written.
#[derive(Debug)]
pub struct CameraFrameMut<'a> {
    /// `height x width x 3`, RGB.
    pub rgb: &'a mut [u8],
}

impl CameraFrame<'_> {
    /// Bytes of a message for an image of this size.
    #[must_use]
    pub fn byte_len(width: u32, height: u32) -> usize {
        Length::default().and::<CameraFrameHeader>(1).and::<u8>(pixels(width, height) * 3).bytes()
    }

    /// Writes the header and hands out the pixels.
    ///
    /// # Panics
    /// When `bytes` is shorter than [`Self::byte_len`] or not aligned to 64 bytes.
    pub fn write(bytes: &mut [u8], header: CameraFrameHeader) -> CameraFrameMut<'_> {
        let mut writer = Writer::new(bytes);
        writer.one(header);
        CameraFrameMut { rgb: writer.array(pixels(header.width, header.height) * 3) }
    }
}

fn pixels(width: u32, height: u32) -> usize {
    width as usize * height as usize
}

impl Message for CameraFrame<'static> {
    const TYPE_NAME: &'static str = "CameraFrame@1";
    type View<'a> = CameraFrame<'a>;

    fn view(bytes: &[u8]) -> Result<CameraFrame<'_>, MalformedMessage> {
        let mut reader = Reader::new(Self::TYPE_NAME, bytes)?;
        let header = reader.one::<CameraFrameHeader>("header")?;
        let rgb = reader.array("rgb", pixels(header.width, header.height) * 3)?;
        Ok(CameraFrame { header, rgb })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AlignedBytes;

    #[test]
    fn what_is_written_is_read_in_place() {
        let header = CameraFrameHeader {
            width: 5,
            height: 3,
            scene_id: 1,
            image_id: 2,
            intrinsics: [1.0, 2.0, 3.0, 4.0],
            frame_id: CameraFrameHeader::frame_id_bytes("camera_optical").unwrap(),
        };
        let mut bytes = AlignedBytes::zeroed(CameraFrame::byte_len(5, 3));
        CameraFrame::write(&mut bytes, header).rgb[44] = 9;
        let frame = CameraFrame::view(&bytes).unwrap();
        assert_eq!((frame.header, frame.rgb.len(), frame.rgb[44]), (&header, 45, 9));
        assert_eq!(frame.header.frame_id(), "camera_optical");
        let short = AlignedBytes::copy_of(&bytes[..bytes.len() - 1]);
        assert!(matches!(CameraFrame::view(&short), Err(MalformedMessage::TooShort { section: "rgb", .. })));
        assert!(CameraFrameHeader::frame_id_bytes(&"x".repeat(64)).is_none());
    }
}
