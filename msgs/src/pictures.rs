use crate::Message;
use crate::layout::{Length, MalformedMessage, Reader, Writer};
use bytemuck::{Pod, Zeroable};

/// Longest name of a picture, bytes.
const NAME_BYTES: usize = 48;

#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
struct Entry {
    /// UTF-8, filled up with zeros.
    name: [u8; NAME_BYTES],
    /// Length of the JPEG.
    bytes: u64,
}

/// Pictures for people of what a node did with a frame, as JPEG.
///
/// Producer: consistency. Consumer: recorder.
#[derive(Debug, Clone)]
pub struct Pictures<'a> {
    /// Name, as in a topic without its first slash, and JPEG.
    pub pictures: Vec<(&'a str, &'a [u8])>,
}

impl Pictures<'_> {
    /// Bytes of a message of these pictures.
    #[must_use]
    pub fn byte_len(pictures: &[(&str, Vec<u8>)]) -> usize {
        let head = Length::default().and::<u64>(1).and::<Entry>(pictures.len());
        pictures.iter().fold(head, |length, (_, jpeg)| length.and::<u8>(jpeg.len())).bytes()
    }

    /// Writes a whole message.
    ///
    /// # Panics
    /// When `bytes` is shorter than [`Self::byte_len`] or not aligned to 64 bytes, or a name is longer than 48 bytes.
    pub fn write(bytes: &mut [u8], pictures: &[(&str, Vec<u8>)]) {
        let mut writer = Writer::new(bytes);
        writer.one(pictures.len() as u64);
        for (entry, (name, jpeg)) in writer.array::<Entry>(pictures.len()).iter_mut().zip(pictures) {
            *entry = Entry { name: [0; NAME_BYTES], bytes: jpeg.len() as u64 };
            entry.name[..name.len()].copy_from_slice(name.as_bytes());
        }
        pictures.iter().for_each(|(_, jpeg)| writer.array::<u8>(jpeg.len()).copy_from_slice(jpeg));
    }
}

impl Message for Pictures<'static> {
    const TYPE_NAME: &'static str = "Pictures@1";
    type View<'a> = Pictures<'a>;

    fn view(bytes: &[u8]) -> Result<Pictures<'_>, MalformedMessage> {
        let mut reader = Reader::new(Self::TYPE_NAME, bytes)?;
        let count = *reader.one::<u64>("count")? as usize;
        let mut pictures = Vec::new();
        for entry in reader.array::<Entry>("entries", count)? {
            let end = entry.name.iter().position(|byte| *byte == 0).unwrap_or(NAME_BYTES);
            let name = std::str::from_utf8(&entry.name[..end]).map_err(|_| MalformedMessage::Field {
                message: Self::TYPE_NAME,
                field: "name",
                value: format!("{:?}", &entry.name[..end]),
            })?;
            pictures.push((name, reader.array::<u8>("jpeg", entry.bytes as usize)?));
        }
        Ok(Pictures { pictures })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AlignedBytes;

    #[test]
    fn pictures_round_trip_and_a_cut_off_message_is_refused() {
        let pictures = [("labels/sigma", vec![1, 2, 3]), ("labels/flow", vec![]), ("x", vec![9; 100])];
        let mut bytes = AlignedBytes::zeroed(Pictures::byte_len(&pictures));
        Pictures::write(&mut bytes, &pictures);
        let view = Pictures::view(&bytes).unwrap();
        assert_eq!(view.pictures, pictures.each_ref().map(|(name, jpeg)| (*name, jpeg.as_slice())));
        assert!(Pictures::view(&bytes[..200]).is_err());
    }
}
