use super::{Header, Naming};
use crate::{ObjectStatus, TrackPhase, TrackReason};
use serde::{Deserialize, Serialize};

/// `diagnostic_msgs/KeyValue`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyValue {
    /// What.
    pub key: String,
    /// How much.
    pub value: String,
}

/// `diagnostic_msgs/DiagnosticStatus`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticStatus {
    /// 0: fine, 1: a warning, 2: an error, 3: stale.
    pub level: u8,
    /// Of what.
    pub name: String,
    /// In words.
    pub message: String,
    /// The instance.
    pub hardware_id: String,
    /// Details.
    pub values: Vec<KeyValue>,
}

/// `diagnostic_msgs/DiagnosticArray`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticArray {
    /// Stamp of the image.
    pub header: Header,
    /// One for each object.
    pub status: Vec<DiagnosticStatus>,
}

super::ros_message!(DiagnosticArray, "diagnostic_msgs", "DiagnosticArray");

/// The tracks of a frame as diagnostics: fine while tracking, a warning otherwise.
#[must_use]
pub fn diagnostics(header: &Header, statuses: &[ObjectStatus], naming: &Naming) -> DiagnosticArray {
    let status = |s: &ObjectStatus| {
        let phase = TrackPhase::from_u32(s.phase).unwrap_or(TrackPhase::Searching);
        let reason = TrackReason::from_u32(s.reason).unwrap_or(TrackReason::NotFound);
        let value = |key: &str, value: String| KeyValue { key: key.into(), value };
        DiagnosticStatus {
            level: u8::from(phase != TrackPhase::Tracking),
            name: naming.class_id(s.object_id),
            message: format!("{}: {}", phase.name(), reason.text()),
            hardware_id: s.instance.to_string(),
            values: vec![
                value("phase", phase.name().into()),
                value("reason", reason.text().into()),
                value("score", format!("{:.3}", s.score)),
                value("good_frames", s.good_frames.to_string()),
                value("bad_frames", s.bad_frames.to_string()),
            ],
        }
    };
    DiagnosticArray { header: header.clone(), status: statuses.iter().map(status).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lost_object_is_a_warning_with_its_reason() {
        let status = |phase: TrackPhase, reason: TrackReason| ObjectStatus {
            object_id: 5,
            instance: 1,
            phase: phase as u32,
            reason: reason as u32,
            good_frames: 0,
            bad_frames: 3,
            score: 0.25,
        };
        let tracks =
            [status(TrackPhase::Tracking, TrackReason::Confirmed), status(TrackPhase::Lost, TrackReason::NotSeen)];
        let found = diagnostics(&Header::default(), &tracks, &Naming::new([(5, "cup".to_owned())].into()).unwrap());
        assert_eq!(found.status.iter().map(|s| s.level).collect::<Vec<_>>(), [0, 1]);
        assert_eq!((found.status[1].name.as_str(), found.status[1].hardware_id.as_str()), ("cup", "1"));
        assert!(found.status[1].message.starts_with("lost: flow and picture"));
    }
}
