use ros2_client::QosProfile;
use ros2_client::qos::{Durability, History, Reliability, WhenFull};
use std::time::Duration;

/// How long `publish` waits for a slow reliable subscriber before the sample is given up and counted.
const MAX_BLOCKING: Duration = Duration::from_millis(100);

/// What is published: reliable, volatile, keep last `depth`.
#[must_use]
pub fn publisher_qos(depth: u32) -> QosProfile {
    QosProfile {
        reliability: Reliability::Reliable { when_full: WhenFull::Wait(MAX_BLOCKING) },
        durability: Durability::Volatile,
        history: History::KeepLast { depth: depth as usize },
        ..QosProfile::publisher_default()
    }
}

/// What is said once and kept for those who come later: reliable, transient local, the last message.
#[must_use]
pub fn latched_qos() -> QosProfile {
    QosProfile { durability: Durability::TransientLocal, ..publisher_qos(1) }
}

/// What is subscribed: ROS 2's profile for sensor data (best effort, volatile), keep last `depth`.
#[must_use]
pub fn sensor_qos(depth: u32) -> QosProfile {
    QosProfile {
        reliability: Reliability::BestEffort,
        durability: Durability::Volatile,
        history: History::KeepLast { depth: depth as usize },
        ..QosProfile::subscription_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_publisher_offers_what_reliable_and_best_effort_subscribers_request() {
        let qos = publisher_qos(50);
        assert!(
            matches!(qos.reliability, Reliability::Reliable { when_full: WhenFull::Wait(wait) } if !wait.is_zero())
        );
        assert_eq!((qos.durability, qos.history), (Durability::Volatile, History::KeepLast { depth: 50 }));
        assert_eq!((qos.deadline, qos.lifespan, qos.liveliness_lease), (None, None, None));
    }

    #[test]
    fn a_sensor_subscription_requests_no_more_than_any_camera_offers() {
        let qos = sensor_qos(10);
        assert_eq!((qos.reliability, qos.durability), (Reliability::BestEffort, Durability::Volatile));
        assert_eq!((qos.deadline, qos.liveliness_lease), (None, None));
    }
}
