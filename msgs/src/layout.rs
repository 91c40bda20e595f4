//! Headers and arrays in one block of bytes: each section begins at a multiple of 64 bytes.

use bytemuck::{Pod, Zeroable};

/// Every section begins at a multiple of this many bytes; so does every payload in shared memory.
pub const ALIGNMENT: usize = 64;

/// Why bytes are not the message that they should be.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MalformedMessage {
    /// The block ends before the section does.
    #[error(
        "{message}: section `{section}` needs {needed} bytes, the block has {available}: do producer and consumer run the same pseudoflow version?"
    )]
    TooShort {
        /// Message type.
        message: &'static str,
        /// Section.
        section: &'static str,
        /// Bytes from the block's start to the section's end.
        needed: usize,
        /// Bytes of the block.
        available: usize,
    },
    /// The block does not begin at a multiple of [`ALIGNMENT`].
    #[error("{0}: the block is not aligned to 64 bytes: take it from AlignedBytes or the runtime")]
    Unaligned(&'static str),
    /// A field has no meaning.
    #[error(
        "{message}: field `{field}` is {value}, which has no meaning: do producer and consumer run the same pseudoflow version?"
    )]
    Field {
        /// Message type.
        message: &'static str,
        /// Field.
        field: &'static str,
        /// Its value.
        value: String,
    },
}

/// Adds up the sections of a message to find its length.
#[derive(Debug, Clone, Copy, Default)]
pub struct Length(usize);

impl Length {
    /// Adds a section of `count` values.
    #[must_use]
    pub fn and<T: Pod>(self, count: usize) -> Self {
        Self(self.0.next_multiple_of(ALIGNMENT) + count * size_of::<T>())
    }

    /// Bytes of all sections.
    #[must_use]
    pub fn bytes(self) -> usize {
        self.0
    }
}

/// Takes one section after another from a block.
pub(crate) struct Reader<'a> {
    message: &'static str,
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    pub(crate) fn new(message: &'static str, bytes: &'a [u8]) -> Result<Self, MalformedMessage> {
        if !(bytes.as_ptr() as usize).is_multiple_of(ALIGNMENT) {
            return Err(MalformedMessage::Unaligned(message));
        }
        Ok(Self { message, bytes, at: 0 })
    }

    pub(crate) fn array<T: Pod>(&mut self, section: &'static str, count: usize) -> Result<&'a [T], MalformedMessage> {
        let start = self.at.next_multiple_of(ALIGNMENT);
        let end = count.checked_mul(size_of::<T>()).and_then(|n| n.checked_add(start));
        let slice = end.and_then(|end| self.bytes.get(start..end)).ok_or(MalformedMessage::TooShort {
            message: self.message,
            section,
            needed: end.unwrap_or(usize::MAX),
            available: self.bytes.len(),
        })?;
        self.at = start + slice.len();
        Ok(bytemuck::cast_slice(slice))
    }

    pub(crate) fn one<T: Pod>(&mut self, section: &'static str) -> Result<&'a T, MalformedMessage> {
        Ok(&self.array::<T>(section, 1)?[0])
    }
}

/// Hands out one section after another of a block that is being written.
///
/// # Panics
/// When the block is unaligned or shorter than the sections asked for: the writer sized it itself.
pub(crate) struct Writer<'a>(&'a mut [u8], usize);

impl<'a> Writer<'a> {
    pub(crate) fn new(bytes: &'a mut [u8]) -> Self {
        assert!((bytes.as_ptr() as usize).is_multiple_of(ALIGNMENT), "message blocks are aligned to 64 bytes");
        Self(bytes, 0)
    }

    pub(crate) fn array<T: Pod>(&mut self, count: usize) -> &'a mut [T] {
        let padding = self.1.next_multiple_of(ALIGNMENT) - self.1;
        let rest = std::mem::take(&mut self.0);
        let (section, rest) = rest[padding..].split_at_mut(count * size_of::<T>());
        self.1 += padding + section.len();
        self.0 = rest;
        bytemuck::cast_slice_mut(section)
    }

    pub(crate) fn one<T: Pod>(&mut self, value: T) {
        self.array::<T>(1)[0] = value;
    }
}

/// An owned block of bytes aligned as messages need it: for tests, bags and messages kept beyond their sample.
#[derive(Debug, Clone, Default)]
pub struct AlignedBytes {
    blocks: Vec<Block>,
    len: usize,
}

#[repr(C, align(64))]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
struct Block([u8; ALIGNMENT]);

impl AlignedBytes {
    /// `len` zero bytes.
    #[must_use]
    pub fn zeroed(len: usize) -> Self {
        Self { blocks: vec![Block([0; ALIGNMENT]); len.div_ceil(ALIGNMENT)], len }
    }

    /// A copy of a block.
    #[must_use]
    pub fn copy_of(bytes: &[u8]) -> Self {
        let mut copy = Self::zeroed(bytes.len());
        copy.copy_from_slice(bytes);
        copy
    }
}

impl std::ops::Deref for AlignedBytes {
    type Target = [u8];
    fn deref(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.blocks)[..self.len]
    }
}

impl std::ops::DerefMut for AlignedBytes {
    fn deref_mut(&mut self) -> &mut [u8] {
        &mut bytemuck::cast_slice_mut(&mut self.blocks)[..self.len]
    }
}
