//! Names as ROS 2 resolves them: relative ones lie in the node's namespace, `~/` below the node; then remapping rules apply.
//! And the QoS that parameters `qos_overrides.*` ask for.

use crate::{BridgeConfig, BridgeError};
use ros2_client::qos::{Durability, History, Reliability, WhenFull};
use ros2_client::{Name, QosProfile};
use schemars::JsonSchema;
use serde::Deserialize;
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};

/// QoS of one topic, as ROS 2's parameters `qos_overrides.TOPIC.publisher.*` and `.subscription.*`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct QosOverride {
    /// Of what we publish.
    pub publisher: QosSettings,
    /// Of what we subscribe to.
    pub subscription: QosSettings,
}

/// The policies that may be set.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct QosSettings {
    /// Messages kept, 1 to 10000.
    #[schemars(range(min = 1, max = 10_000))]
    pub depth: Option<u32>,
    /// `keep_last` or `keep_all`.
    pub history: Option<HistoryPolicy>,
    /// `reliable` or `best_effort`.
    pub reliability: Option<ReliabilityPolicy>,
    /// `volatile` or `transient_local`.
    pub durability: Option<DurabilityPolicy>,
}

/// How many messages are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs, reason = "the names of ROS 2")]
pub enum HistoryPolicy {
    KeepLast,
    KeepAll,
}

/// Whether lost messages are repeated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs, reason = "the names of ROS 2")]
pub enum ReliabilityPolicy {
    Reliable,
    BestEffort,
}

/// Whether late subscribers get what was published before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs, reason = "the names of ROS 2")]
pub enum DurabilityPolicy {
    Volatile,
    TransientLocal,
}

impl QosSettings {
    fn apply(&self, mut qos: QosProfile) -> QosProfile {
        if let Some(depth) = self.depth {
            qos.history = History::KeepLast { depth: depth.max(1) as usize };
        }
        if self.history == Some(HistoryPolicy::KeepAll) {
            qos.history = History::KeepAll;
        }
        match self.reliability {
            Some(ReliabilityPolicy::Reliable) => {
                qos.reliability = Reliability::Reliable { when_full: WhenFull::DEFAULT };
            }
            Some(ReliabilityPolicy::BestEffort) => qos.reliability = Reliability::BestEffort,
            None => {}
        }
        match self.durability {
            Some(DurabilityPolicy::Volatile) => qos.durability = Durability::Volatile,
            Some(DurabilityPolicy::TransientLocal) => qos.durability = Durability::TransientLocal,
            None => {}
        }
        qos
    }
}

/// Resolves names.
#[derive(Debug)]
pub(crate) struct Names {
    namespace: String,
    node: String,
    remap: BTreeMap<String, String>,
    overrides: BTreeMap<String, QosOverride>,
    /// Rules and overrides that have matched something.
    used: RefCell<BTreeSet<String>>,
}

impl Names {
    pub(crate) fn new(config: &BridgeConfig) -> Self {
        let namespace = format!("/{}", config.namespace.trim_matches('/'));
        let node = format!("{}/{}", namespace.trim_end_matches('/'), config.node_name);
        let mut names = Self {
            namespace,
            node,
            remap: BTreeMap::new(),
            overrides: BTreeMap::new(),
            used: RefCell::new(BTreeSet::new()),
        };
        names.remap = config.remap.iter().map(|(from, to)| (names.expand(from), names.expand(to))).collect();
        let overrides = config.qos_overrides.iter();
        names.overrides = overrides.map(|(topic, qos)| (names.expand(topic), qos.clone())).collect();
        names
    }

    /// The full name, before remapping.
    fn expand(&self, name: &str) -> String {
        match name.strip_prefix("~/") {
            Some(below) => format!("{}/{below}", self.node),
            None if name.starts_with('/') => name.to_owned(),
            None => format!("{}/{name}", self.namespace.trim_end_matches('/')),
        }
    }

    /// The full name of a topic; `field` is what the configuration calls it.
    pub(crate) fn resolve(&self, field: &'static str, name: &str) -> Result<Name, BridgeError> {
        let full = self.expand(name);
        let full = match self.remap.get(&full) {
            Some(to) => {
                self.used.borrow_mut().insert(full);
                to.clone()
            }
            None => full,
        };
        Name::parse(&full).map_err(|error| BridgeError::Name { field, name: name.to_owned(), cause: error.to_string() })
    }

    pub(crate) fn publisher_qos(&self, topic: &Name, qos: QosProfile) -> QosProfile {
        self.override_of(topic).map_or(qos.clone(), |settings| settings.publisher.apply(qos))
    }

    pub(crate) fn subscription_qos(&self, topic: &Name, qos: QosProfile) -> QosProfile {
        self.override_of(topic).map_or(qos.clone(), |settings| settings.subscription.apply(qos))
    }

    fn override_of(&self, topic: &Name) -> Option<&QosOverride> {
        let name = topic.to_string();
        let found = self.overrides.get(&name);
        if found.is_some() {
            self.used.borrow_mut().insert(name);
        }
        found
    }

    /// One line for each rule that has matched nothing.
    pub(crate) fn unused(&self) -> Vec<String> {
        let used = self.used.borrow();
        let rules = self.remap.iter().filter(|(from, _)| !used.contains(*from));
        let overrides = self.overrides.keys().filter(|topic| !used.contains(*topic));
        rules
            .map(|(from, to)| format!("remapping {from}:={to} matches no topic of this node"))
            .chain(overrides.map(|topic| format!("qos_overrides.{topic} matches no topic of this node")))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(namespace: &str, remap: &[(&str, &str)]) -> Names {
        let remap = remap.iter().map(|(from, to)| ((*from).to_owned(), (*to).to_owned())).collect();
        Names::new(&BridgeConfig { namespace: namespace.into(), remap, ..BridgeConfig::default() })
    }

    #[test]
    fn names_lie_in_the_namespace_unless_they_are_absolute() {
        let resolve = |namespace: &str, name: &str| names(namespace, &[]).resolve("topic", name).unwrap().to_string();
        assert_eq!(resolve("/", "object_pose"), "/object_pose");
        assert_eq!(resolve("/robot/arm", "object_poses/refused"), "/robot/arm/object_poses/refused");
        assert_eq!((resolve("/left", "/tf"), resolve("left/", "~/x")), ("/tf".into(), "/left/pseudoflow/x".into()));
        for wrong in ["", "/", "a b", "//", "/1st"] {
            assert!(names("/", &[]).resolve("topic", wrong).unwrap_err().to_string().contains("`topic: "), "{wrong}");
        }
    }

    #[test]
    fn rules_apply_to_full_names() {
        let names = names("/left", &[("object_pose", "cup"), ("/tf", "tf"), ("never", "ever")]);
        let resolve = |name: &str| names.resolve("topic", name).unwrap().to_string();
        assert_eq!((resolve("object_pose"), resolve("/tf")), ("/left/cup".into(), "/left/tf".into()));
        assert_eq!(names.used.borrow().len(), 2);
        assert_eq!(resolve("object_poses"), "/left/object_poses");
    }

    #[test]
    fn overrides_change_one_topic() {
        let text =
            r#"{"qos_overrides": {"/left/object_pose": {"publisher": {"depth": 3, "reliability": "best_effort"}}}}"#;
        let config: BridgeConfig = serde_json::from_str(text).unwrap();
        let names = Names::new(&BridgeConfig { namespace: "/left".into(), ..config });
        let topic = names.resolve("topic", "object_pose").unwrap();
        let qos = names.publisher_qos(&topic, crate::publisher_qos(100));
        assert_eq!((qos.history, qos.reliability), (History::KeepLast { depth: 3 }, Reliability::BestEffort));
        let other = names.resolve("topic", "object_poses").unwrap();
        assert_eq!(names.publisher_qos(&other, crate::publisher_qos(100)), crate::publisher_qos(100));
    }
}
