use crate::Message;
use crate::layout::{Length, MalformedMessage, Reader, Writer};
use bytemuck::{Pod, Zeroable};

/// What stands before the network.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct NetworkWeightsHeader {
    /// Count of the weights: 1 for the first that were sent.
    pub version: u64,
    /// Training step that they come from.
    pub step: u64,
    /// Bytes of the ONNX file.
    pub onnx_bytes: u64,
}

/// A flow network to swap in: a whole ONNX file.
///
/// Producer: trainer. Consumer: flow.
#[derive(Debug, Clone, Copy)]
pub struct NetworkWeights<'a> {
    /// Version and length.
    pub header: &'a NetworkWeightsHeader,
    /// The ONNX file.
    pub onnx: &'a [u8],
}

impl NetworkWeights<'_> {
    /// Bytes of a message for an ONNX file of this length.
    #[must_use]
    pub fn byte_len(onnx_bytes: usize) -> usize {
        Length::default().and::<NetworkWeightsHeader>(1).and::<u8>(onnx_bytes).bytes()
    }

    /// Writes a whole message.
    ///
    /// # Panics
    /// When `bytes` is shorter than [`Self::byte_len`] or not aligned to 64 bytes.
    pub fn write(bytes: &mut [u8], version: u64, step: u64, onnx: &[u8]) {
        let mut writer = Writer::new(bytes);
        writer.one(NetworkWeightsHeader { version, step, onnx_bytes: onnx.len() as u64 });
        writer.array::<u8>(onnx.len()).copy_from_slice(onnx);
    }
}

impl Message for NetworkWeights<'static> {
    const TYPE_NAME: &'static str = "NetworkWeights@1";
    type View<'a> = NetworkWeights<'a>;

    fn view(bytes: &[u8]) -> Result<NetworkWeights<'_>, MalformedMessage> {
        let mut reader = Reader::new(Self::TYPE_NAME, bytes)?;
        let header = reader.one::<NetworkWeightsHeader>("header")?;
        Ok(NetworkWeights { header, onnx: reader.array("onnx", header.onnx_bytes as usize)? })
    }
}
