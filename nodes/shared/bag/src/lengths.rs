//! Whether the lengths that a record states lie within it. The mcap crate reserves what a string claims before it looks how
//! much is there: four bytes of damage would reserve four gigabytes.

use mcap::records::op;

/// Chunks that unpack to more than this and to over a hundred times their packed size are refused.
const PLAIN_BYTES: u64 = 64 << 20;
const MOST_RATIO: u64 = 100;
/// What a whole file may unpack to, and how many times its size beside that.
const FILE_BYTES: u64 = 4 << 30;
const FILE_RATIO: u64 = 200;

/// What may be unpacked of a file.
#[derive(Debug, Clone, Copy)]
pub(super) struct Budget(u64);

impl Budget {
    pub(super) fn of_file(file_bytes: u64) -> Self {
        Self(file_bytes.saturating_mul(FILE_RATIO).saturating_add(FILE_BYTES))
    }

    /// Whether a chunk may be unpacked; what it takes is taken off.
    pub(super) fn take(&mut self, chunk: &[u8]) -> Result<(), String> {
        let unpacked = uncompressed_size(chunk).ok_or("a chunk's header is not valid")?;
        let most = PLAIN_BYTES.max(MOST_RATIO.saturating_mul(chunk.len() as u64));
        if unpacked > most.min(self.0) {
            return Err(format!("a chunk of {} bytes claims to unpack to {unpacked}: more than is read", chunk.len()));
        }
        self.0 -= unpacked;
        Ok(())
    }
}

/// Bytes that a chunk record says it unpacks to.
pub(super) fn uncompressed_size(chunk: &[u8]) -> Option<u64> {
    Some(u64::from_le_bytes(chunk.get(16..24)?.try_into().ok()?))
}

/// Whether all strings, maps and arrays of a record end within it.
pub(super) fn fit(opcode: u8, content: &[u8]) -> bool {
    let mut rest = Rest(content);
    let read = match opcode {
        op::HEADER => rest.strings(2),
        op::SCHEMA => rest.skip(2).and_then(|()| rest.strings(2)).and_then(|()| rest.string()),
        op::CHANNEL => rest.skip(4).and_then(|()| rest.strings(2)).and_then(|()| rest.map()),
        op::METADATA => rest.string().and_then(|()| rest.map()),
        op::CHUNK => rest.skip(28).and_then(|()| rest.string()).and_then(|()| rest.records()),
        _ => Some(()),
    };
    read.is_some()
}

struct Rest<'a>(&'a [u8]);

impl Rest<'_> {
    fn skip(&mut self, bytes: usize) -> Option<()> {
        self.0 = self.0.get(bytes..)?;
        Some(())
    }

    fn number<const N: usize>(&mut self) -> Option<usize> {
        let (head, tail) = self.0.split_first_chunk::<N>()?;
        self.0 = tail;
        let mut wide = [0; 8];
        wide[..N].copy_from_slice(head);
        usize::try_from(u64::from_le_bytes(wide)).ok()
    }

    fn string(&mut self) -> Option<()> {
        let length = self.number::<4>()?;
        self.skip(length)
    }

    fn strings(&mut self, count: usize) -> Option<()> {
        (0..count).try_for_each(|_| self.string())
    }

    /// Pairs of strings, so many bytes of them.
    fn map(&mut self) -> Option<()> {
        let length = self.number::<4>()?;
        let mut pairs = Rest(self.0.get(..length)?);
        while !pairs.0.is_empty() {
            pairs.strings(2)?;
        }
        self.skip(length)
    }

    fn records(&mut self) -> Option<()> {
        let length = self.number::<8>()?;
        self.skip(length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_beyond_the_record_are_seen() {
        let string = |length: u32, text: &str| [&length.to_le_bytes(), text.as_bytes()].concat();
        let header = |length| [string(4, "ros2"), string(length, "lib")].concat();
        assert!(fit(op::HEADER, &header(3)));
        assert!(!fit(op::HEADER, &header(4)) && !fit(op::HEADER, &header(u32::MAX)));
        let metadata = |length: u32| [string(1, "a"), string(length, ""), string(1, "k"), string(1, "v")].concat();
        assert!(fit(op::METADATA, &metadata(10)));
        assert!(!fit(op::METADATA, &metadata(9)) && !fit(op::METADATA, &metadata(11)));
    }

    #[test]
    fn what_a_chunk_unpacks_to_is_limited_by_what_it_is() {
        let chunk = |unpacked: u64, packed: usize| {
            let mut bytes = vec![0; packed];
            bytes[16..24].copy_from_slice(&unpacked.to_le_bytes());
            bytes
        };
        let mut budget = Budget::of_file(1 << 20);
        assert!(budget.take(&chunk(60 << 20, 5000)).is_ok(), "black pictures pack well");
        assert!(budget.take(&chunk(1 << 30, 41_000)).unwrap_err().contains("41000 bytes"));
        assert!(budget.take(&chunk(90 << 20, 1 << 20)).is_ok());
        let times = (0..1000).take_while(|_| budget.take(&chunk(64 << 20, 100)).is_ok()).count();
        assert!((60..70).contains(&times), "{times}");
        assert!(budget.take(&[0; 20]).is_err());
    }
}
