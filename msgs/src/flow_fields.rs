use crate::Message;
use crate::layout::{Length, MalformedMessage, Reader, Writer};
use bytemuck::{Pod, Zeroable};

/// What stands before the flow.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct FlowFieldsHeader {
    /// Fields in the message: one per view, then one per partner.
    pub fields: u32,
    /// Width and height, pixels.
    pub size_px: u32,
    /// Count of the weights in use: 0 for those of the start, one more with each swap.
    pub weights_version: u64,
    /// 1 when the network says how certain it is (the refiner does, RAFT does not), else 0.
    pub has_certainty: u32,
    /// Zero.
    pub reserved: u32,
}

/// Flow from each rendered reference to the real crop, and from view 0 of each instance to its partners' crops.
///
/// Producer: flow. Consumers: pnp, judge, consistency, trainer. With `V` views, field `v < V` belongs to view v of the frame's
/// `ReferenceViews` and field `V + p` to its partner p (zero where there is none).
#[derive(Debug, Clone, Copy)]
pub struct FlowFields<'a> {
    /// Count, size, weights.
    pub header: &'a FlowFieldsHeader,
    /// `fields x S x S x 2`: dx, dy in crop pixels, defined on the rendered image.
    pub flow_px: &'a [f32],
    /// `fields x 2 x S x S`, or empty without [`FlowFieldsHeader::has_certainty`]: for each rendered pixel 255 times the
    /// probability that its surface point is seen in the crop, then 255 times the confidence that its flow is right to about
    /// a pixel.
    pub certainty: &'a [u8],
}

/// [`FlowFields`] being written.
#[derive(Debug)]
pub struct FlowFieldsMut<'a> {
    /// `fields x S x S x 2`.
    pub flow_px: &'a mut [f32],
    /// `fields x 2 x S x S` or empty.
    pub certainty: &'a mut [u8],
}

fn values(header: &FlowFieldsHeader) -> usize {
    header.fields as usize * (header.size_px as usize).pow(2) * 2
}

fn certainties(header: &FlowFieldsHeader) -> usize {
    if header.has_certainty == 1 { values(header) } else { 0 }
}

impl FlowFields<'_> {
    /// Bytes of a message with this header.
    #[must_use]
    pub fn byte_len(header: &FlowFieldsHeader) -> usize {
        Length::default().and::<FlowFieldsHeader>(1).and::<f32>(values(header)).and::<u8>(certainties(header)).bytes()
    }

    /// Writes the header and hands out the rest.
    ///
    /// # Panics
    /// When `bytes` is shorter than [`Self::byte_len`] or not aligned to 64 bytes.
    pub fn write(bytes: &mut [u8], header: FlowFieldsHeader) -> FlowFieldsMut<'_> {
        let mut writer = Writer::new(bytes);
        writer.one(header);
        FlowFieldsMut { flow_px: writer.array(values(&header)), certainty: writer.array(certainties(&header)) }
    }
}

impl Message for FlowFields<'static> {
    const TYPE_NAME: &'static str = "FlowFields@2";
    type View<'a> = FlowFields<'a>;

    fn view(bytes: &[u8]) -> Result<FlowFields<'_>, MalformedMessage> {
        let mut reader = Reader::new(Self::TYPE_NAME, bytes)?;
        let header = reader.one::<FlowFieldsHeader>("header")?;
        let flow_px = reader.array("flow_px", values(header))?;
        Ok(FlowFields { header, flow_px, certainty: reader.array("certainty", certainties(header))? })
    }
}
