use crate::{BridgeError, DdsEnvironment, DiscoveryRange};
use pseudoflow_msgs::ros::RosMessage;
use ros2_client::dds::rustdds::DomainParticipantBuilder;
use ros2_client::{Context, MessageTypeName, Name, Node, NodeName, NodeOptions, Publisher, QosProfile, Subscription};

/// The one DDS participant of a process, and its ROS 2 node.
///
/// There are no parameter services and no `/rosout`: the node only publishes and subscribes.
pub struct Participant {
    node: Node,
}

impl Participant {
    /// Joins the domain that the environment names, within its discovery range.
    ///
    /// # Errors
    /// When the node's name is none or DDS cannot open its ports.
    pub fn open(environment: DdsEnvironment, namespace: &str, node_name: &str) -> Result<Self, BridgeError> {
        let name = self::node_name(namespace, node_name)?;
        let full_name = name.fully_qualified_name();
        let mut builder = DomainParticipantBuilder::new(environment.domain_id)
            .same_host_loopback(environment.range != DiscoveryRange::Off);
        if let Some(networks) = environment.range.only_networks() {
            builder = builder.with_only_networks(networks);
        }
        let participant = builder.build().map_err(|error| create("the participant", &error))?;
        let context = Context::from_domain_participant(participant).map_err(|error| create("the context", &error))?;
        let options = NodeOptions::new().enable_rosout(true).start_parameter_services(false);
        let node = context.new_node(name, options).map_err(|error| create("the node", &error))?;
        log::info!("DDS domain {}, discovery range {:?}, node {full_name}", environment.domain_id, environment.range);
        Ok(Self { node })
    }

    /// Publishes a topic. A name without leading `/` lies in the root namespace too.
    ///
    /// # Errors
    /// When DDS refuses.
    pub fn publisher<M: RosMessage>(&mut self, topic: &Name, qos: &QosProfile) -> Result<Publisher<M>, BridgeError> {
        let failed = |error| create(&format!("a publisher of {topic}"), &error);
        let dds_topic = self.node.create_topic(topic, type_name::<M>(), qos).map_err(failed)?;
        self.node.create_publisher(&dds_topic, None).map_err(failed)
    }

    /// Subscribes to a topic.
    ///
    /// # Errors
    /// When DDS refuses.
    pub fn subscription<M: RosMessage>(
        &mut self,
        topic: &Name,
        qos: &QosProfile,
    ) -> Result<Subscription<M>, BridgeError> {
        let failed = |error| create(&format!("a subscription to {topic}"), &error);
        let dds_topic = self.node.create_topic(topic, type_name::<M>(), qos).map_err(failed)?;
        self.node.create_subscription(&dds_topic, None).map_err(failed)
    }

    /// How many subscribers of an absolute topic name have been found.
    #[must_use]
    pub fn subscribers(&self, topic: &str) -> usize {
        self.node.subscription_count(topic)
    }

    /// How many publishers of an absolute topic name have been found.
    #[must_use]
    pub fn publishers(&self, topic: &str) -> usize {
        self.node.publisher_count(topic)
    }
}

fn type_name<M: RosMessage>() -> MessageTypeName {
    MessageTypeName::new(M::PACKAGE, M::NAME)
}

fn create(what: &str, error: &dyn std::fmt::Display) -> BridgeError {
    BridgeError::Create { what: what.to_owned(), cause: error.to_string() }
}

pub(crate) fn node_name(namespace: &str, name: &str) -> Result<NodeName, BridgeError> {
    let namespace = format!("/{}", namespace.trim_matches('/'));
    let field = if NodeName::new("/", name).is_ok() { "namespace" } else { "node_name" };
    NodeName::new(&namespace, name).map_err(|error| BridgeError::Name {
        field,
        name: if field == "namespace" { namespace.clone() } else { name.to_owned() },
        cause: error.to_string(),
    })
}

/// A topic of the configuration.
pub(crate) fn topic_name(field: &'static str, name: &str) -> Result<Name, BridgeError> {
    let parsed = if name.starts_with('/') {
        Name::parse(name).map_err(|error| error.to_string())
    } else {
        Err("it does not begin with `/`".to_owned())
    };
    parsed.map_err(|cause| BridgeError::Name { field, name: name.to_owned(), cause })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_checked_before_anything_starts() {
        assert!(topic_name("image", "/camera/image_raw").is_ok());
        for name in ["image", "/", "/camera/", "/a b", "/1st"] {
            let text = topic_name("image", name).unwrap_err().to_string();
            assert!(text.contains("`image: "), "{text}");
        }
        assert_eq!(node_name("/left/", "pseudoflow").unwrap().fully_qualified_name(), "/left/pseudoflow");
        assert_eq!(node_name("/", "pseudoflow").unwrap().fully_qualified_name(), "/pseudoflow");
        assert!(node_name("/", "pseudo flow").is_err());
    }
}
