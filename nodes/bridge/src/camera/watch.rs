//! Why no image comes: said after two seconds without one, then after four, eight, ...

use std::time::{Duration, Instant};

/// How long a camera may be silent before the log says why.
const PATIENCE: Duration = Duration::from_secs(2);

/// What is known of a topic.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct TopicState {
    pub(crate) name: String,
    /// Type that we subscribe to.
    pub(crate) wanted: &'static str,
    /// Type and reliability of each publisher that was found.
    pub(crate) offers: Vec<Offer>,
    /// Whether our subscription requests reliability.
    pub(crate) reliable: bool,
    /// Messages that came since the last image went on.
    pub(crate) came: u64,
}

/// A publisher that was found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Offer {
    /// As DDS names it: `sensor_msgs::msg::dds_::Image_`.
    pub(crate) type_name: String,
    pub(crate) reliable: bool,
}

impl TopicState {
    /// What is wrong with the topic; `None` when its messages come.
    fn problem(&self) -> Option<String> {
        if self.came > 0 {
            return None;
        }
        let Self { name, wanted, .. } = self;
        let fitting: Vec<&Offer> = self.offers.iter().filter(|offer| ros_type(&offer.type_name) == *wanted).collect();
        Some(match (self.offers.first(), fitting.first()) {
            (None, _) => format!("{name} has no publisher: is the driver running, in this ROS_DOMAIN_ID?"),
            (Some(other), None) => format!("{name} is a {}, expected {wanted}", ros_type(&other.type_name)),
            (_, Some(_)) if self.reliable && !fitting.iter().any(|offer| offer.reliable) => {
                format!("{name} is published best effort, but reliability is requested (qos_overrides)")
            }
            _ => format!("{name} has {} publishers, but no message has come", fitting.len()),
        })
    }
}

/// `sensor_msgs/Image` of `sensor_msgs::msg::dds_::Image_`.
fn ros_type(dds: &str) -> String {
    dds.replace("::msg::dds_::", "/").trim_end_matches('_').to_owned()
}

/// Notices that nothing comes.
#[derive(Debug)]
pub(crate) struct Watch {
    silent_since: Instant,
    patience: Duration,
}

impl Watch {
    pub(crate) fn new(now: Instant) -> Self {
        Self { silent_since: now, patience: PATIENCE }
    }

    /// An image went on.
    pub(crate) fn image(&mut self, now: Instant) {
        *self = Self::new(now);
    }

    /// Whether it is time to say why none comes.
    pub(crate) fn is_due(&mut self, now: Instant) -> bool {
        let due = now.duration_since(self.silent_since) >= self.patience;
        if due {
            self.patience *= 2;
        }
        due
    }
}

/// Why no image goes on, in words.
pub(crate) fn why(topics: &[TopicState], waiting: (usize, usize)) -> String {
    let problems: Vec<String> = topics.iter().filter_map(TopicState::problem).collect();
    match (problems.is_empty(), waiting) {
        (false, _) => problems.join("; "),
        (true, (1.., 1..)) => {
            "the stamps of images and of their CameraInfo never meet: `info: latest` takes the newest one".into()
        }
        (true, _) => "messages come, but none can be used: see what was dropped".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn topic(offers: &[(&str, bool)], came: u64) -> TopicState {
        let offers = offers.iter().map(|(name, reliable)| Offer { type_name: (*name).into(), reliable: *reliable });
        let (name, wanted) = ("/cam/image".into(), "sensor_msgs/Image");
        TopicState { name, wanted, offers: offers.collect(), reliable: false, came }
    }

    const IMAGE: &str = "sensor_msgs::msg::dds_::Image_";

    #[test]
    fn each_cause_is_named() {
        assert!(why(&[topic(&[], 0)], (0, 0)).contains("no publisher"));
        let compressed = "sensor_msgs::msg::dds_::CompressedImage_";
        let text = why(&[topic(&[(compressed, true)], 0)], (0, 0));
        assert!(text.contains("is a sensor_msgs/CompressedImage, expected sensor_msgs/Image"), "{text}");
        let strict = TopicState { reliable: true, ..topic(&[(IMAGE, false)], 0) };
        assert!(why(&[strict], (0, 0)).contains("best effort"));
        assert!(why(&[topic(&[(IMAGE, true)], 0)], (0, 0)).contains("no message has come"));
        assert!(why(&[topic(&[(IMAGE, true)], 5)], (3, 4)).contains("never meet"));
        assert!(why(&[topic(&[(IMAGE, true)], 5)], (0, 0)).contains("dropped"));
    }

    #[test]
    fn silence_is_mentioned_ever_less_often() {
        let start = Instant::now();
        let mut watch = Watch::new(start);
        let due: Vec<u64> = (0..20).filter(|s| watch.is_due(start + Duration::from_secs(*s))).collect();
        assert_eq!(due, [2, 4, 8, 16]);
        watch.image(start + Duration::from_secs(20));
        assert!(!watch.is_due(start + Duration::from_secs(21)));
    }
}
