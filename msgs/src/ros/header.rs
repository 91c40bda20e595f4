use serde::{Deserialize, Serialize};

const NANOSECONDS: i64 = 1_000_000_000;

/// `builtin_interfaces/Time`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Time {
    /// Whole seconds, rounded down.
    pub sec: i32,
    /// The rest, 0..1e9.
    pub nanosec: u32,
}

impl Time {
    /// The time of nanoseconds since the epoch; `None` outside the 68 years around it that the type can hold.
    #[must_use]
    pub fn from_ns(stamp_ns: i64) -> Option<Self> {
        let sec = i32::try_from(stamp_ns.div_euclid(NANOSECONDS)).ok()?;
        Some(Self { sec, nanosec: stamp_ns.rem_euclid(NANOSECONDS) as u32 })
    }

    /// Nanoseconds since the epoch.
    #[must_use]
    pub fn as_ns(self) -> i64 {
        i64::from(self.sec) * NANOSECONDS + i64::from(self.nanosec)
    }
}

/// `std_msgs/Header`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// When the data was taken.
    pub stamp: Time,
    /// The frame that the data is in.
    pub frame_id: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_round_trip_on_both_sides_of_the_epoch() {
        for stamp_ns in [0, 1, 1_700_000_000_123_456_789, -1, -1_000_000_001] {
            assert_eq!(Time::from_ns(stamp_ns).unwrap().as_ns(), stamp_ns);
        }
        assert_eq!(Time::from_ns(-1).unwrap(), Time { sec: -1, nanosec: 999_999_999 });
        assert_eq!(Time::from_ns(i64::MAX), None);
    }
}
