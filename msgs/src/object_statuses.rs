use crate::Message;
use crate::layout::{Length, MalformedMessage, Reader, Writer};
use bytemuck::{Pod, Zeroable};

/// Where the tracking of an object stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum TrackPhase {
    /// It has not been found, or not often enough in a row to be believed.
    Searching = 0,
    /// Each frame's pose starts from the last one.
    Tracking = 1,
    /// It was tracked and is gone; it is searched for.
    Lost = 2,
}

/// Why a track is in its phase.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum TrackReason {
    /// No detection yet.
    NotFound = 0,
    /// A detection, to be confirmed by the next frames.
    Detected = 1,
    /// Enough good frames in a row.
    Confirmed = 2,
    /// Flow and picture say that it is not there.
    NotSeen = 3,
    /// No pose could be solved from the flow.
    NotSolved = 4,
    /// The pose jumped further than things move.
    Jumped = 5,
    /// It left the image.
    LeftImage = 6,
    /// A second track came to the same place.
    Duplicate = 7,
    /// It is looked for where it was left among the other objects, to be confirmed by the next frames.
    Remembered = 8,
    /// The frame does not show it: it is held where it is believed to be.
    Hidden = 9,
    /// The frame was not used: it is older than one before it.
    OutOfOrder = 10,
    /// The frame was not used: it is black, or of one colour.
    Dark = 11,
}

impl TrackPhase {
    /// The phase of a stored number.
    #[must_use]
    pub fn from_u32(value: u32) -> Option<Self> {
        [Self::Searching, Self::Tracking, Self::Lost].into_iter().find(|phase| *phase as u32 == value)
    }

    /// As people read it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Searching => "searching",
            Self::Tracking => "tracking",
            Self::Lost => "lost",
        }
    }
}

impl TrackReason {
    const ALL: [Self; 12] = [
        Self::NotFound,
        Self::Detected,
        Self::Confirmed,
        Self::NotSeen,
        Self::NotSolved,
        Self::Jumped,
        Self::LeftImage,
        Self::Duplicate,
        Self::Remembered,
        Self::Hidden,
        Self::OutOfOrder,
        Self::Dark,
    ];

    /// The reason of a stored number.
    #[must_use]
    pub fn from_u32(value: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|reason| *reason as u32 == value)
    }

    /// As people read it.
    #[must_use]
    pub fn text(self) -> &'static str {
        match self {
            Self::NotFound => "not found yet",
            Self::Detected => "detected, not confirmed yet",
            Self::Confirmed => "confirmed",
            Self::NotSeen => "flow and picture say that it is not there",
            Self::NotSolved => "no pose from the flow",
            Self::Jumped => "the pose jumped",
            Self::LeftImage => "left the image",
            Self::Duplicate => "another track is at the same place",
            Self::Remembered => "looked for where it was left, not confirmed yet",
            Self::Hidden => "not seen at the moment, held where it is believed to be",
            Self::OutOfOrder => "the frame is older than one before it",
            Self::Dark => "the frame is black or of one colour",
        }
    }
}

/// One object's track.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct ObjectStatus {
    /// Id of the object in its set.
    pub object_id: u32,
    /// Tells instances of one object apart.
    pub instance: u32,
    /// A [`TrackPhase`].
    pub phase: u32,
    /// A [`TrackReason`].
    pub reason: u32,
    /// Good frames in a row.
    pub good_frames: u32,
    /// Bad frames in a row.
    pub bad_frames: u32,
    /// Confidence of its last pose, 0..1; of a detection its score.
    pub score: f64,
}

/// What stands before the tracks.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct ObjectStatusesHeader {
    /// How many follow.
    pub count: u32,
    /// 1 when the whole image was searched in this frame.
    pub searched: u32,
}

/// The tracks of all known objects after a frame's predictions were made.
///
/// Producers: initializer, tracker. Consumers: bridge, recorder.
#[derive(Debug, Clone, Copy)]
pub struct ObjectStatuses<'a> {
    /// Count.
    pub header: &'a ObjectStatusesHeader,
    /// The tracks.
    pub statuses: &'a [ObjectStatus],
}

impl ObjectStatuses<'_> {
    /// Bytes of a message of this many tracks.
    #[must_use]
    pub fn byte_len(count: usize) -> usize {
        Length::default().and::<ObjectStatusesHeader>(1).and::<ObjectStatus>(count).bytes()
    }

    /// Writes a whole message.
    ///
    /// # Panics
    /// When `bytes` is shorter than [`Self::byte_len`] or not aligned to 64 bytes.
    pub fn write(bytes: &mut [u8], searched: bool, statuses: &[ObjectStatus]) {
        let mut writer = Writer::new(bytes);
        writer.one(ObjectStatusesHeader { count: statuses.len() as u32, searched: u32::from(searched) });
        writer.array::<ObjectStatus>(statuses.len()).copy_from_slice(statuses);
    }
}

impl Message for ObjectStatuses<'static> {
    const TYPE_NAME: &'static str = "ObjectStatuses@1";
    type View<'a> = ObjectStatuses<'a>;

    fn view(bytes: &[u8]) -> Result<ObjectStatuses<'_>, MalformedMessage> {
        let mut reader = Reader::new(Self::TYPE_NAME, bytes)?;
        let header = reader.one::<ObjectStatusesHeader>("header")?;
        let statuses = reader.array::<ObjectStatus>("statuses", header.count as usize)?;
        let bad =
            |field, value: u32| MalformedMessage::Field { message: Self::TYPE_NAME, field, value: value.to_string() };
        for status in statuses {
            TrackPhase::from_u32(status.phase).ok_or_else(|| bad("phase", status.phase))?;
            TrackReason::from_u32(status.reason).ok_or_else(|| bad("reason", status.reason))?;
        }
        Ok(ObjectStatuses { header, statuses })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AlignedBytes;

    #[test]
    fn tracks_round_trip_and_a_bad_phase_is_named() {
        let mut status: ObjectStatus = bytemuck::Zeroable::zeroed();
        (status.object_id, status.phase, status.reason) = (5, TrackPhase::Lost as u32, TrackReason::Jumped as u32);
        let mut bytes = AlignedBytes::zeroed(ObjectStatuses::byte_len(2));
        ObjectStatuses::write(&mut bytes, true, &[status, status]);
        let view = ObjectStatuses::view(&bytes).unwrap();
        assert_eq!((view.header.searched, view.statuses), (1, &[status, status][..]));
        status.phase = 9;
        ObjectStatuses::write(&mut bytes, false, &[status, status]);
        assert!(matches!(ObjectStatuses::view(&bytes), Err(MalformedMessage::Field { field: "phase", .. })));
    }
}
