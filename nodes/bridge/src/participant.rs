use crate::camera::Offer;
use crate::interfaces;
use crate::names::Names;
use crate::rosout::Rosout;
use crate::{BridgeError, DdsEnvironment, DiscoveryRange};
use pseudoflow_msgs::ros::RosMessage;
use pseudoflow_runtime::supervisor::Severity;
use ros2_client::dds::rustdds::DomainParticipantBuilder;
use ros2_client::dds::rustdds::discovery::PublicationBuiltinTopicData;
use ros2_client::qos::Reliability;
use ros2_client::ros2::policy;
use ros2_client::{Context, MessageTypeName, Name, Node, NodeName, NodeOptions, Publisher, QosProfile, Subscription};
use std::collections::BTreeMap;

/// The one DDS participant of a process, and its ROS 2 node.
///
/// There are no parameter services: parameters are read once, at the start.
pub struct Participant {
    node: Node,
    context: Context,
    rosout: Rosout,
    /// What our subscriptions request, by topic.
    requested: BTreeMap<String, Reliability>,
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
        // At once, and again when all threads have opened theirs.
        if environment.range.is_this_host() {
            keep_to_loopback();
        }
        let context = Context::from_domain_participant(participant).map_err(|error| create("the context", &error))?;
        let options = NodeOptions::new().enable_rosout(false).start_parameter_services(false);
        let mut node = context.new_node(name, options).map_err(|error| create("the node", &error))?;
        let rosout = Rosout::open(&mut node).map_err(|error| create("a publisher of /rosout", &error))?;
        if environment.range.is_this_host() {
            keep_to_loopback();
        }
        log::info!("DDS domain {}, discovery range {:?}, node {full_name}", environment.domain_id, environment.range);
        Ok(Self { node, context, rosout, requested: BTreeMap::new() })
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

    /// Publishes a topic of the configuration: its name resolved, its QoS as overrides ask for it.
    pub(crate) fn advertise<M: RosMessage>(
        &mut self,
        names: &Names,
        topic: &str,
        qos: QosProfile,
    ) -> Result<Publisher<M>, BridgeError> {
        let name = names.resolve("topic", topic)?;
        let qos = names.publisher_qos(&name, qos);
        self.publisher(&name, &qos)
    }

    /// Subscribes to a resolved topic, with QoS as overrides ask for it.
    pub(crate) fn subscribe<M: RosMessage>(
        &mut self,
        names: &Names,
        topic: &Name,
        qos: QosProfile,
    ) -> Result<Subscription<M>, BridgeError> {
        let qos = names.subscription_qos(topic, qos);
        let subscription = self.subscription(topic, &qos)?;
        self.requested.insert(topic.to_string(), qos.reliability);
        Ok(subscription)
    }

    /// The reliability that our subscription to a topic requests.
    pub(crate) fn requested(&self, topic: &Name) -> Option<Reliability> {
        self.requested.get(&topic.to_string()).copied()
    }

    /// Type and reliability of each publisher of an absolute topic name.
    pub(crate) fn offers(&self, topic: &str) -> Vec<Offer> {
        let dds_name = format!("rt{topic}");
        let writers = self.context.domain_participant().discovered_writers();
        let data = writers.iter().map(|writer| &writer.publication_topic_data);
        let of_topic = data.filter(|data| data.topic_name == dds_name);
        let reliable =
            |data: &PublicationBuiltinTopicData| matches!(data.reliability, Some(policy::Reliability::Reliable { .. }));
        of_topic.map(|data| Offer { type_name: data.type_name.clone(), reliable: reliable(data) }).collect()
    }

    /// Says a warning on /rosout; the logger is this node, or below it the node of the graph that warns.
    pub(crate) fn say(&self, severity: Severity, of: Option<&str>, line: &str) {
        self.rosout.say(severity, of, line);
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

fn keep_to_loopback() {
    match interfaces::keep_to_loopback() {
        Ok(sockets) => log::debug!("{sockets} UDP sockets hear loopback alone"),
        Err(error) => log::warn!(
            "the sockets of DDS cannot be bound to loopback ({error}; Linux 5.7 or later can): other hosts may send to them. \
             Close their ports, see docs/security.md"
        ),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_checked_before_anything_starts() {
        assert_eq!(node_name("/left/", "pseudoflow").unwrap().fully_qualified_name(), "/left/pseudoflow");
        assert_eq!(node_name("/", "pseudoflow").unwrap().fully_qualified_name(), "/pseudoflow");
        assert!(node_name("/", "pseudo flow").is_err());
    }

    /// As `ss` shows it: each UDP socket of this process is bound to the loopback interface.
    #[test]
    fn a_participant_of_this_host_hears_nobody_else() {
        let environment = DdsEnvironment { domain_id: 77, range: DiscoveryRange::Localhost, middleware: None };
        let _participant = Participant::open(environment, "/", "alone").unwrap();
        // Domain 77 has 250 ports from 7400 + 250 * 77; other tests' sockets live beside.
        let mut ports = interfaces::ports();
        ports.retain(|(port, _)| (26_650..26_900).contains(port));
        assert!(ports.len() >= 3, "discovery and user traffic: {ports:?}");
        assert!(ports.iter().all(|(_, device)| device.as_deref() == Some(b"lo")), "{ports:?}");
    }
}
