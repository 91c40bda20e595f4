use crate::Message;
use crate::layout::{Length, MalformedMessage, Reader, Writer};
use bytemuck::{Pod, Zeroable};

/// Where a detector saw an object: pixels of the frame, pixel centres at integers, edges at halves.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[allow(missing_docs, reason = "the fields are edges")]
pub struct Rectangle {
    /// Id of the object in its set.
    pub object_id: u32,
    /// How sure, 0..1.
    pub score: f32,
    pub left: f32,
    pub top: f32,
    pub right: f32,
    pub bottom: f32,
}

/// What stands before the rectangles.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct RectanglesHeader {
    /// How many follow.
    pub count: u32,
    /// BOP scene of the frame; 0 where there is none.
    pub scene_id: u32,
    /// BOP image of the frame.
    pub image_id: u32,
    /// Keeps the size a multiple of 8.
    pub reserved: u32,
}

/// What a detector saw in a frame.
///
/// Producer: player. Consumer: rectangle_finder.
#[derive(Debug, Clone, Copy)]
pub struct Rectangles<'a> {
    /// Count and names.
    pub header: &'a RectanglesHeader,
    /// The rectangles; several of one object are instances.
    pub rectangles: &'a [Rectangle],
}

impl Rectangles<'_> {
    /// Bytes of a message of this many rectangles.
    #[must_use]
    pub fn byte_len(count: usize) -> usize {
        Length::default().and::<RectanglesHeader>(1).and::<Rectangle>(count).bytes()
    }

    /// Writes a whole message.
    ///
    /// # Panics
    /// When `bytes` is shorter than [`Self::byte_len`] or not aligned to 64 bytes.
    pub fn write(bytes: &mut [u8], scene_id: u32, image_id: u32, rectangles: &[Rectangle]) {
        let mut writer = Writer::new(bytes);
        writer.one(RectanglesHeader { count: rectangles.len() as u32, scene_id, image_id, reserved: 0 });
        writer.array::<Rectangle>(rectangles.len()).copy_from_slice(rectangles);
    }
}

impl Message for Rectangles<'static> {
    const TYPE_NAME: &'static str = "Rectangles@1";
    type View<'a> = Rectangles<'a>;

    fn view(bytes: &[u8]) -> Result<Rectangles<'_>, MalformedMessage> {
        let mut reader = Reader::new(Self::TYPE_NAME, bytes)?;
        let header = reader.one::<RectanglesHeader>("header")?;
        let rectangles = reader.array::<Rectangle>("rectangles", header.count as usize)?;
        Ok(Rectangles { header, rectangles })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AlignedBytes;

    #[test]
    fn rectangles_round_trip() {
        let one = Rectangle { object_id: 5, score: 0.5, left: 1.0, top: 2.0, right: 3.0, bottom: 4.0 };
        let mut bytes = AlignedBytes::zeroed(Rectangles::byte_len(2));
        Rectangles::write(&mut bytes, 1, 2, &[one, one]);
        let view = Rectangles::view(&bytes).unwrap();
        assert_eq!((view.header.image_id, view.rectangles), (2, &[one, one][..]));
        assert!(Rectangles::view(&AlignedBytes::copy_of(&bytes[..64])).is_err());
    }
}
