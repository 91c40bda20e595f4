use crate::layout::{Length, MalformedMessage, Reader, Writer};
use crate::{Message, ObjectPose};
use bytemuck::{Pod, Zeroable};

/// What stands before the partners.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct PartnerFramesHeader {
    /// Initial poses of the frame that these are partners of.
    pub instances: u32,
    /// Partners of each.
    pub partners_per_instance: u32,
}

/// Another frame that shows an object from nearly the same side.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct PartnerFrame {
    /// The object's initial pose in that frame.
    pub pose: ObjectPose,
    /// That frame's fx, fy, cx, cy, pixels.
    pub intrinsics: [f64; 4],
    /// Its BOP scene.
    pub scene_id: u32,
    /// Its BOP image.
    pub image_id: u32,
    /// Pixels per row; 0 when too few frames are near and there is no partner.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl PartnerFrame {
    fn bytes(&self) -> usize {
        self.width as usize * self.height as usize * 3
    }
}

/// For each initial pose of a frame, other frames of the recording for the photometric loss (method.md).
///
/// Producer: player (sampling). Consumer: renderer. Instance i owns partners `i m .. (i + 1) m`.
#[derive(Debug, Clone, Copy)]
pub struct PartnerFrames<'a> {
    /// Counts.
    pub header: &'a PartnerFramesHeader,
    /// `instances x m`.
    pub partners: &'a [PartnerFrame],
    /// Their images one behind the other, each `height x width x 3`, RGB.
    pub rgb: &'a [u8],
}

impl<'a> PartnerFrames<'a> {
    /// Bytes of a message with these partners.
    #[must_use]
    pub fn byte_len(partners: &[PartnerFrame]) -> usize {
        let pixels = partners.iter().map(PartnerFrame::bytes).sum();
        Length::default().and::<PartnerFramesHeader>(1).and::<PartnerFrame>(partners.len()).and::<u8>(pixels).bytes()
    }

    /// Writes header and partners and hands out the pixels of all images.
    ///
    /// # Panics
    /// When `bytes` is shorter than [`Self::byte_len`] or not aligned to 64 bytes.
    pub fn write<'m>(
        bytes: &'m mut [u8],
        header: PartnerFramesHeader,
        partners: &[PartnerFrame],
    ) -> impl Iterator<Item = &'m mut [u8]> + use<'m> {
        let lengths: Vec<usize> = partners.iter().map(PartnerFrame::bytes).collect();
        let mut writer = Writer::new(bytes);
        writer.one(header);
        writer.array::<PartnerFrame>(partners.len()).copy_from_slice(partners);
        let mut rest = writer.array::<u8>(lengths.iter().sum());
        lengths.into_iter().map(move |length| {
            let (image, behind) = std::mem::take(&mut rest).split_at_mut(length);
            rest = behind;
            image
        })
    }

    /// The image of a partner; empty when there is none.
    #[must_use]
    pub fn image(&self, partner: usize) -> &'a [u8] {
        let begin: usize = self.partners[..partner].iter().map(PartnerFrame::bytes).sum();
        &self.rgb[begin..begin + self.partners[partner].bytes()]
    }
}

impl Message for PartnerFrames<'static> {
    const TYPE_NAME: &'static str = "PartnerFrames@1";
    type View<'a> = PartnerFrames<'a>;

    fn view(bytes: &[u8]) -> Result<PartnerFrames<'_>, MalformedMessage> {
        let mut reader = Reader::new(Self::TYPE_NAME, bytes)?;
        let header = reader.one::<PartnerFramesHeader>("header")?;
        let count = header.instances as usize * header.partners_per_instance as usize;
        let partners = reader.array::<PartnerFrame>("partners", count)?;
        let pixels = partners.iter().map(PartnerFrame::bytes).sum();
        Ok(PartnerFrames { header, partners, rgb: reader.array("rgb", pixels)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AlignedBytes;

    #[test]
    fn images_of_different_sizes_stand_behind_each_other() {
        let of = |width, height| PartnerFrame { width, height, ..PartnerFrame::zeroed() };
        let partners = [of(4, 2), of(0, 0), of(3, 3)];
        let header = PartnerFramesHeader { instances: 1, partners_per_instance: 3 };
        let mut bytes = AlignedBytes::zeroed(PartnerFrames::byte_len(&partners));
        for (value, image) in PartnerFrames::write(&mut bytes, header, &partners).enumerate() {
            image.fill(value as u8 + 1);
        }
        let read = PartnerFrames::view(&bytes).unwrap();
        assert_eq!((read.image(0), read.image(1).len(), read.image(2)), (&[1; 24][..], 0, &[3; 27][..]));
        assert!(PartnerFrames::view(&bytes[..bytes.len() - 64]).is_err());
    }
}
