use crate::Message;
use crate::layout::{Length, MalformedMessage, Reader, Writer};
use bytemuck::{Pod, Zeroable};

/// What stands before the networks.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct NetworkWeightsHeader {
    /// Publication: 0 for the weights that training began with.
    pub version: u64,
    /// Training steps behind them.
    pub step: u64,
    /// Frames between two publications.
    pub frames_per_version: u64,
    /// Bytes of the ONNX file.
    pub onnx_bytes: u64,
    /// Bytes of the publication before, 0 for none.
    pub previous_onnx_bytes: u64,
}

/// A flow network to swap in: a whole ONNX file, and the one before it.
///
/// A flow node in lockstep labels while the trainer trains: it wants the publication before the newest one, whether
/// or not the newest has come already. Hence both.
///
/// Producer: trainer. Consumer: flow.
#[derive(Debug, Clone, Copy)]
pub struct NetworkWeights<'a> {
    /// Version and lengths.
    pub header: &'a NetworkWeightsHeader,
    /// The ONNX file.
    pub onnx: &'a [u8],
    /// The ONNX file of the publication before.
    pub previous_onnx: &'a [u8],
}

impl NetworkWeights<'_> {
    /// Bytes of a message with this header.
    #[must_use]
    pub fn byte_len(header: &NetworkWeightsHeader) -> usize {
        let onnx = Length::default().and::<NetworkWeightsHeader>(1).and::<u8>(header.onnx_bytes as usize);
        onnx.and::<u8>(header.previous_onnx_bytes as usize).bytes()
    }

    /// Writes a whole message.
    ///
    /// # Panics
    /// When `bytes` is shorter than [`Self::byte_len`] or not aligned to 64 bytes, or a file has another length than
    /// the header says.
    pub fn write(bytes: &mut [u8], header: NetworkWeightsHeader, onnx: &[u8], previous_onnx: &[u8]) {
        let mut writer = Writer::new(bytes);
        writer.one(header);
        writer.array::<u8>(header.onnx_bytes as usize).copy_from_slice(onnx);
        writer.array::<u8>(header.previous_onnx_bytes as usize).copy_from_slice(previous_onnx);
    }
}

impl Message for NetworkWeights<'static> {
    const TYPE_NAME: &'static str = "NetworkWeights@2";
    type View<'a> = NetworkWeights<'a>;

    fn view(bytes: &[u8]) -> Result<NetworkWeights<'_>, MalformedMessage> {
        let mut reader = Reader::new(Self::TYPE_NAME, bytes)?;
        let header = reader.one::<NetworkWeightsHeader>("header")?;
        Ok(NetworkWeights {
            header,
            onnx: reader.array("onnx", header.onnx_bytes as usize)?,
            previous_onnx: reader.array("previous_onnx", header.previous_onnx_bytes as usize)?,
        })
    }
}
