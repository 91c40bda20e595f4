//! Messages as bags hold them: CDR behind the four bytes of its encapsulation header.

use super::RosMessage;
use byteorder::{BigEndian, LittleEndian};

const LITTLE_ENDIAN: [u8; 4] = [0, 1, 0, 0];
const BIG_ENDIAN: [u8; 4] = [0, 0, 0, 0];

/// Why bytes are not the message that they should be, or a message cannot be written.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CdrError {
    /// The first four bytes name no plain CDR.
    #[error("{message}: the data begins with {found:02x?}, not with 00 01 00 00 or 00 00 00 00: is it CDR?")]
    Encapsulation {
        /// Message type.
        message: String,
        /// Up to four bytes.
        found: Vec<u8>,
    },
    /// CDR that does not fit the type.
    #[error("{message}: {reason}; is the data cut off, or of another type?")]
    Content {
        /// Message type.
        message: String,
        /// What the decoder said.
        reason: String,
    },
}

impl CdrError {
    fn content<M: RosMessage>(error: &cdr_encoding::Error) -> Self {
        Self::Content { message: M::type_name(), reason: error.to_string() }
    }
}

/// Writes a message as little-endian CDR with its encapsulation header.
///
/// # Errors
/// When a length does not fit into 32 bits.
pub fn to_cdr<M: RosMessage>(message: &M) -> Result<Vec<u8>, CdrError> {
    let mut bytes = LITTLE_ENDIAN.to_vec();
    let written = cdr_encoding::to_writer::<_, LittleEndian, _>(&mut bytes, message);
    written.map_err(|error| CdrError::content::<M>(&error))?;
    Ok(bytes)
}

/// Reads a message from CDR of either byte order with its encapsulation header.
///
/// # Errors
/// When the header or the content does not fit.
pub fn from_cdr<M: RosMessage>(bytes: &[u8]) -> Result<M, CdrError> {
    let content = bytes.get(4..).unwrap_or_default();
    let read = match bytes.first_chunk() {
        Some(&LITTLE_ENDIAN) => cdr_encoding::from_bytes::<M, LittleEndian>(content),
        Some(&BIG_ENDIAN) => cdr_encoding::from_bytes::<M, BigEndian>(content),
        _ => {
            let found = bytes[..bytes.len().min(4)].to_vec();
            return Err(CdrError::Encapsulation { message: M::type_name(), found });
        }
    };
    read.map(|(message, _)| message).map_err(|error| CdrError::content::<M>(&error))
}

#[cfg(test)]
mod tests {
    use super::super::{Header, PoseStamped};
    use super::*;

    #[test]
    fn round_trips_and_refuses_what_is_no_cdr() {
        let pose =
            PoseStamped { header: Header { frame_id: "camera".into(), ..Header::default() }, ..PoseStamped::default() };
        let bytes = to_cdr(&pose).unwrap();
        assert_eq!(bytes[..4], [0, 1, 0, 0]);
        assert_eq!(from_cdr::<PoseStamped>(&bytes).unwrap(), pose);
        let cut = from_cdr::<PoseStamped>(&bytes[..bytes.len() - 1]).unwrap_err();
        assert!(cut.to_string().contains("geometry_msgs/msg/PoseStamped"), "{cut}");
        assert!(matches!(from_cdr::<PoseStamped>(&[9, 9]), Err(CdrError::Encapsulation { .. })));
        assert!(matches!(from_cdr::<PoseStamped>(&[]), Err(CdrError::Encapsulation { .. })));
    }

    #[test]
    fn big_endian_is_read_too() {
        let mut bytes = BIG_ENDIAN.to_vec();
        bytes.extend(cdr_encoding::to_vec::<_, BigEndian>(&PoseStamped::default()).unwrap());
        assert_eq!(from_cdr::<PoseStamped>(&bytes).unwrap(), PoseStamped::default());
    }
}
