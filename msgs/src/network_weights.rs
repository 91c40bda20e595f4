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
    /// Bytes of the weights.
    pub weights_bytes: u64,
    /// Bytes of the publication before, 0 for none.
    pub previous_bytes: u64,
}

/// Weights of the flow network to swap in: a whole safetensors file, and the one before it. The flow node makes of them
/// what its engine runs.
///
/// A flow node in lockstep labels while the trainer trains: it wants the publication before the newest one, whether
/// or not the newest has come already. Hence both.
///
/// Producer: trainer. Consumer: flow.
#[derive(Debug, Clone, Copy)]
pub struct NetworkWeights<'a> {
    /// Version and lengths.
    pub header: &'a NetworkWeightsHeader,
    /// The safetensors file.
    pub weights: &'a [u8],
    /// That of the publication before.
    pub previous: &'a [u8],
}

impl NetworkWeights<'_> {
    /// Bytes of a message with this header.
    #[must_use]
    pub fn byte_len(header: &NetworkWeightsHeader) -> usize {
        let weights = Length::default().and::<NetworkWeightsHeader>(1).and::<u8>(header.weights_bytes as usize);
        weights.and::<u8>(header.previous_bytes as usize).bytes()
    }

    /// Writes a whole message.
    ///
    /// # Panics
    /// When `bytes` is shorter than [`Self::byte_len`] or not aligned to 64 bytes, or a file has another length than
    /// the header says.
    pub fn write(bytes: &mut [u8], header: NetworkWeightsHeader, weights: &[u8], previous: &[u8]) {
        let mut writer = Writer::new(bytes);
        writer.one(header);
        writer.array::<u8>(header.weights_bytes as usize).copy_from_slice(weights);
        writer.array::<u8>(header.previous_bytes as usize).copy_from_slice(previous);
    }
}

impl Message for NetworkWeights<'static> {
    const TYPE_NAME: &'static str = "NetworkWeights@3";
    type View<'a> = NetworkWeights<'a>;

    fn view(bytes: &[u8]) -> Result<NetworkWeights<'_>, MalformedMessage> {
        let mut reader = Reader::new(Self::TYPE_NAME, bytes)?;
        let header = reader.one::<NetworkWeightsHeader>("header")?;
        Ok(NetworkWeights {
            header,
            weights: reader.array("weights", header.weights_bytes as usize)?,
            previous: reader.array("previous", header.previous_bytes as usize)?,
        })
    }
}
