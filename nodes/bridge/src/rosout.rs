//! `/rosout`, published as ROS 2's own nodes do: the last thousand lines stay for those who come later. ros2-client's keeps one line, so
//! that what is said at the start, when nobody has found the node yet, would be lost.

use crate::publisher_qos;
use pseudoflow_runtime::supervisor::Severity;
use ros2_client::builtin_interfaces::Time;
use ros2_client::log::{Log, LogLevel};
use ros2_client::qos::Durability;
use ros2_client::{MessageTypeName, Name, Node, Publisher, QosProfile};
use std::time::Duration;

/// Lines that are kept, and how long they are worth hearing: rcl's profile of `/rosout`.
const DEPTH: u32 = 1000;
const LIFESPAN: Duration = Duration::from_secs(10);

/// The log of a node on ROS 2.
pub(crate) struct Rosout {
    publisher: Publisher<Log>,
    logger: String,
}

impl Rosout {
    pub(crate) fn open(node: &mut Node) -> Result<Self, String> {
        let name = Name::parse("/rosout").map_err(|error| error.to_string())?;
        let qos =
            QosProfile { durability: Durability::TransientLocal, lifespan: Some(LIFESPAN), ..publisher_qos(DEPTH) };
        let topic = node.create_topic(&name, MessageTypeName::new("rcl_interfaces", "Log"), &qos);
        let publisher = topic.and_then(|topic| node.create_publisher(&topic, None));
        let publisher = publisher.map_err(|error| error.to_string())?;
        Ok(Self { publisher, logger: logger(&node.fully_qualified_name(), None) })
    }

    /// Says a line; `of` is the node of the graph that it comes from, where that is not the bridge.
    pub(crate) fn say(&self, severity: Severity, of: Option<&str>, line: &str) {
        let level = if severity == Severity::Error { LogLevel::Error } else { LogLevel::Warn };
        let log = Log {
            stamp: Time::now(),
            level: level as u8,
            name: logger(&self.logger, of),
            msg: line.to_owned(),
            file: String::new(),
            function: String::new(),
            line: 0,
        };
        if let Err(error) = self.publisher.publish(log) {
            log::debug!("/rosout: {error}");
        }
    }
}

/// The logger of a node as rcl names it, `left.eye` of `/left/eye`, and below it that of a node of the graph.
fn logger(node: &str, of: Option<&str>) -> String {
    let own = node.trim_matches('/').replace('/', ".");
    of.map_or_else(|| own.clone(), |below| format!("{own}.{below}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loggers_have_the_names_of_their_nodes() {
        assert_eq!(logger("/pseudoflow", None), "pseudoflow");
        assert_eq!(logger("/left/arm/eye", Some("flow")), "left.arm.eye.flow");
    }
}
