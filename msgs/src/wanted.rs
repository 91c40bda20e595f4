use crate::Message;
use crate::layout::{Length, MalformedMessage, Reader, Writer};
use bytemuck::{Pod, Zeroable};

/// What stands before the ids of a [`Wanted`].
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct WantedHeader {
    /// How many ids follow.
    pub count: u32,
    /// BOP scene of the frame; 0 where there is none.
    pub scene_id: u32,
    /// BOP image of the frame.
    pub image_id: u32,
    /// Keeps the size a multiple of 8.
    pub reserved: u32,
}

/// The objects that should be searched for: expected in view, and in this frame not found yet, or lost.
///
/// Producer: tracker. Consumers: initializer, rectangle_finder.
#[derive(Debug, Clone, Copy)]
pub struct Wanted<'a> {
    /// Count and names.
    pub header: &'a WantedHeader,
    /// Ids of the objects, ascending.
    pub object_ids: &'a [u32],
}

impl Wanted<'_> {
    /// Bytes of a message of this many objects.
    #[must_use]
    pub fn byte_len(count: usize) -> usize {
        Length::default().and::<WantedHeader>(1).and::<u32>(count).bytes()
    }

    /// Writes a whole message.
    ///
    /// # Panics
    /// When `bytes` is shorter than [`Self::byte_len`] or not aligned to 64 bytes.
    pub fn write(bytes: &mut [u8], scene_id: u32, image_id: u32, object_ids: &[u32]) {
        let mut writer = Writer::new(bytes);
        writer.one(WantedHeader { count: object_ids.len() as u32, scene_id, image_id, reserved: 0 });
        writer.array::<u32>(object_ids.len()).copy_from_slice(object_ids);
    }
}

impl Message for Wanted<'static> {
    const TYPE_NAME: &'static str = "Wanted@1";
    type View<'a> = Wanted<'a>;

    fn view(bytes: &[u8]) -> Result<Wanted<'_>, MalformedMessage> {
        let mut reader = Reader::new(Self::TYPE_NAME, bytes)?;
        let header = reader.one::<WantedHeader>("header")?;
        let object_ids = reader.array::<u32>("object_ids", header.count as usize)?;
        Ok(Wanted { header, object_ids })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AlignedBytes;

    #[test]
    fn ids_round_trip() {
        let mut bytes = AlignedBytes::zeroed(Wanted::byte_len(3));
        Wanted::write(&mut bytes, 1, 2, &[1, 5, 7]);
        let view = Wanted::view(&bytes).unwrap();
        assert_eq!((view.header.image_id, view.object_ids), (2, &[1, 5, 7][..]));
        let short = AlignedBytes::copy_of(&bytes[..bytes.len() - 8]);
        assert!(Wanted::view(&short).is_err());
    }
}
