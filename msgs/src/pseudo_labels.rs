use crate::Message;
use crate::layout::{Length, MalformedMessage, Reader, Writer};
use bytemuck::{Pod, Zeroable};

/// What stands before the labels.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct PseudoLabelsHeader {
    /// Publication of the teacher's weights that made the flow.
    pub weights_version: u64,
    /// Objects (instances) of the frame.
    pub instances: u32,
    /// Views of each.
    pub views_per_instance: u32,
    /// Width and height, pixels.
    pub size_px: u32,
    /// BOP scene of the frame.
    pub scene_id: u32,
    /// BOP image of the frame.
    pub image_id: u32,
    /// Largest sigma of a valid label, pixels of these crops.
    pub tau_px: f32,
}

/// What came out for one instance; pixels are counted over all views.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct InstanceLabels {
    /// BOP object.
    pub object_id: u32,
    /// 1 when there are enough valid labels to train with.
    pub usable: u32,
    /// Pixels on the object.
    pub visible_px: u32,
    /// Of these, seen by enough views.
    pub voted_px: u32,
    /// Of these, with a label.
    pub valid_px: u32,
    /// Median sigma of the voted pixels, pixels; NaN without any.
    pub median_sigma_px: f32,
}

/// Labels for the flow of each view, made from the teacher's flows alone.
///
/// Producer: consistency. Consumers: trainer, recorder. View v is that of the frame's `ReferenceViews`.
#[derive(Debug, Clone, Copy)]
pub struct PseudoLabels<'a> {
    /// Counts and size.
    pub header: &'a PseudoLabelsHeader,
    /// One of each instance.
    pub info: &'a [InstanceLabels],
    /// Disagreement of the views: `instances x n x S x S`; NaN off the object and where too few views see the point.
    pub sigma_px: &'a [f32],
    /// 255 where there is a label, else 0: `instances x n x S x S`.
    pub valid: &'a [u8],
    /// The label, dx and dy: `instances x n x S x S x 2`; NaN where not valid.
    pub label_px: &'a [f32],
}

/// [`PseudoLabels`] being written; the fields are those of the message.
#[derive(Debug)]
#[allow(missing_docs, reason = "the fields are those of PseudoLabels")]
pub struct PseudoLabelsMut<'a> {
    pub info: &'a mut [InstanceLabels],
    pub sigma_px: &'a mut [f32],
    pub valid: &'a mut [u8],
    pub label_px: &'a mut [f32],
}

fn pixels(header: &PseudoLabelsHeader) -> usize {
    header.instances as usize * header.views_per_instance as usize * (header.size_px as usize).pow(2)
}

impl PseudoLabels<'_> {
    /// Bytes of a message with this header.
    #[must_use]
    pub fn byte_len(header: &PseudoLabelsHeader) -> usize {
        let n = pixels(header);
        Length::default()
            .and::<PseudoLabelsHeader>(1)
            .and::<InstanceLabels>(header.instances as usize)
            .and::<f32>(n)
            .and::<u8>(n)
            .and::<f32>(2 * n)
            .bytes()
    }

    /// Writes the header and hands out the rest.
    ///
    /// # Panics
    /// When `bytes` is shorter than [`Self::byte_len`] or not aligned to 64 bytes.
    pub fn write(bytes: &mut [u8], header: PseudoLabelsHeader) -> PseudoLabelsMut<'_> {
        let n = pixels(&header);
        let mut writer = Writer::new(bytes);
        writer.one(header);
        PseudoLabelsMut {
            info: writer.array(header.instances as usize),
            sigma_px: writer.array(n),
            valid: writer.array(n),
            label_px: writer.array(2 * n),
        }
    }
}

impl Message for PseudoLabels<'static> {
    const TYPE_NAME: &'static str = "PseudoLabels@1";
    type View<'a> = PseudoLabels<'a>;

    fn view(bytes: &[u8]) -> Result<PseudoLabels<'_>, MalformedMessage> {
        let mut reader = Reader::new(Self::TYPE_NAME, bytes)?;
        let header = reader.one::<PseudoLabelsHeader>("header")?;
        let n = pixels(header);
        Ok(PseudoLabels {
            header,
            info: reader.array("info", header.instances as usize)?,
            sigma_px: reader.array("sigma_px", n)?,
            valid: reader.array("valid", n)?,
            label_px: reader.array("label_px", 2 * n)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AlignedBytes;

    #[test]
    fn sections_do_not_overlap() {
        let header =
            PseudoLabelsHeader { instances: 2, views_per_instance: 3, size_px: 5, ..PseudoLabelsHeader::zeroed() };
        let mut bytes = AlignedBytes::zeroed(PseudoLabels::byte_len(&header));
        let message = PseudoLabels::write(&mut bytes, header);
        message.info.fill(InstanceLabels { valid_px: 9, ..InstanceLabels::zeroed() });
        message.sigma_px.fill(1.0);
        message.valid.fill(2);
        message.label_px.fill(3.0);
        let read = PseudoLabels::view(&bytes).unwrap();
        assert!(read.info.len() == 2 && read.info.iter().all(|i| i.valid_px == 9));
        assert!(read.sigma_px.len() == 150 && read.sigma_px.iter().all(|v| *v == 1.0));
        assert!(read.valid.len() == 150 && read.valid.iter().all(|v| *v == 2));
        assert!(read.label_px.len() == 300 && read.label_px.iter().all(|v| *v == 3.0));
        assert!(PseudoLabels::view(&bytes[..bytes.len() - 64]).is_err());
    }
}
