use crate::BridgeError;
use crate::camera::{CameraConfig, CameraOrTopic, camera_or_topic};
use crate::names::{Names, QosOverride};
use crate::participant::node_name;
use pseudoflow_edge::Catalogue;
use pseudoflow_msgs::ros::Naming;
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Most messages that a publisher or subscription may keep.
const MAX_QUEUE_DEPTH: u32 = 10_000;

/// How poses are published, and which camera is taken.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct BridgeConfig {
    /// Name of the ROS 2 node.
    pub node_name: String,
    /// Namespace of the node and of all its topics; `/tf` stays where ROS 2 looks for it.
    pub namespace: String,
    /// Folder of the object set: names, boxes and meshes. `pseudoflow run` fills in that of the graph's other nodes.
    pub objects: Option<PathBuf>,
    /// What objects are called, by id, where there is no object set.
    pub object_names: BTreeMap<u32, String>,
    /// Weights of the networks: `vision_info`'s version goes up with them. `pseudoflow run` fills in the graph's.
    pub weights: Vec<PathBuf>,
    /// The object of `object_pose`, by name or id; without, the first that is found, until it is lost.
    pub object: Option<String>,
    /// How long the object of `object_pose` may be lost before another takes its place, seconds.
    pub switch_after_s: f64,
    /// Transforms.
    pub tf: TfConfig,
    /// Messages kept for slow reliable subscribers, 1 to 10000.
    #[schemars(range(min = 1, max = 10_000))]
    pub queue_depth: u32,
    /// The camera, where the bridge is the source of a live graph: its images' topic, or a mapping.
    #[serde(deserialize_with = "camera_or_topic")]
    #[schemars(with = "Option<CameraOrTopic>")]
    pub camera: Option<CameraConfig>,
    /// Other names for topics, as `-r FROM:=TO` gives them.
    pub remap: BTreeMap<String, String>,
    /// QoS by topic, as the parameters `qos_overrides.TOPIC...` give it.
    pub qos_overrides: BTreeMap<String, QosOverride>,
    /// Goes on where RMW_IMPLEMENTATION names a middleware that cannot hear DDS.
    pub allow_rmw_mismatch: bool,
}

impl Default for BridgeConfig {
    fn default() -> Self {
        Self {
            node_name: "pseudoflow".into(),
            namespace: "/".into(),
            objects: None,
            object_names: BTreeMap::new(),
            weights: Vec::new(),
            object: None,
            switch_after_s: 5.0,
            tf: TfConfig::default(),
            queue_depth: 100,
            camera: None,
            remap: BTreeMap::new(),
            qos_overrides: BTreeMap::new(),
            allow_rmw_mismatch: false,
        }
    }
}

/// What goes out on `/tf`.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TfConfig {
    /// Whether transforms are published.
    pub enabled: bool,
    /// What stands before the names of objects' frames; without, the namespace (`left/` for `/left`).
    pub prefix: Option<String>,
}

impl Default for TfConfig {
    fn default() -> Self {
        Self { enabled: true, prefix: None }
    }
}

impl BridgeConfig {
    /// Checks names and ranges.
    ///
    /// # Errors
    /// The first that is wrong.
    pub fn check(&self) -> Result<(), BridgeError> {
        self.checked().map(|_| ())
    }

    /// As [`Self::check`]; gives the objects, which take the longest to read.
    pub(crate) fn checked(&self) -> Result<Catalogue, BridgeError> {
        node_name(&self.namespace, &self.node_name)?;
        let names = Names::new(self);
        names.resolve("namespace", "object_pose")?;
        for (from, to) in &self.remap {
            names.resolve("remap", from)?;
            names.resolve("remap", to)?;
        }
        check_depth("queue_depth", self.queue_depth)?;
        if !(self.switch_after_s >= 0.0 && self.switch_after_s.is_finite()) {
            return Err(BridgeError::Seconds { field: "switch_after_s", value: self.switch_after_s });
        }
        let catalogue = self.catalogue()?;
        self.object.as_deref().map(|name| catalogue.naming.wanted(name)).transpose()?;
        self.camera.as_ref().map_or(Ok(()), |camera| camera.check(&names))?;
        Ok(catalogue)
    }

    /// What objects are called and look like.
    ///
    /// # Errors
    /// When the object set cannot be read, or two objects could not be told apart.
    pub fn catalogue(&self) -> Result<Catalogue, BridgeError> {
        match &self.objects {
            Some(folder) => Ok(Catalogue::load(folder)?),
            None => Ok(Catalogue { naming: Naming::new(self.object_names.clone())?, ..Catalogue::default() }),
        }
    }

    /// What stands before the names of objects' frames.
    pub(crate) fn tf_prefix(&self) -> String {
        let namespace = self.namespace.trim_matches('/');
        match &self.tf.prefix {
            Some(prefix) => prefix.clone(),
            None if namespace.is_empty() => String::new(),
            None => format!("{namespace}/"),
        }
    }
}

pub(crate) fn check_depth(field: &'static str, depth: u32) -> Result<(), BridgeError> {
    if (1..=MAX_QUEUE_DEPTH).contains(&depth) {
        return Ok(());
    }
    Err(BridgeError::Range { field, value: depth.into(), min: 1, max: MAX_QUEUE_DEPTH.into() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_configurations_are_valid() {
        let default: BridgeConfig = serde_json::from_str("{}").unwrap();
        default.check().unwrap();
        BridgeConfig { camera: Some(CameraConfig::of_topic("/camera/image_raw")), ..default }.check().unwrap();
    }

    #[test]
    fn what_is_wrong_is_named() {
        let refused = |config: BridgeConfig| config.check().unwrap_err().to_string();
        let default = BridgeConfig::default;
        assert!(refused(BridgeConfig { queue_depth: 0, ..default() }).contains("`queue_depth: 0`"));
        assert!(refused(BridgeConfig { namespace: "a b".into(), ..default() }).contains("`namespace: "));
        assert!(refused(BridgeConfig { node_name: "a/b".into(), ..default() }).contains("`node_name: "));
        let object_names = [(1, "cup".to_owned()), (2, "cup".to_owned())].into();
        assert!(refused(BridgeConfig { object_names, ..default() }).contains("`cup`"));
        let object_names: BTreeMap<_, _> = [(1, "soup can".to_owned()), (2, "soup_can".to_owned())].into();
        assert!(refused(BridgeConfig { object_names, ..default() }).contains("objects/soup_can/pose"));
        let object_names = [(1, "cup".to_owned())].into();
        let object = Some("teapot".to_owned());
        assert!(refused(BridgeConfig { object_names, object, ..default() }).contains("`object: teapot`"));
        assert!(refused(BridgeConfig { switch_after_s: f64::NAN, ..default() }).contains("`switch_after_s: NaN`"));
        assert!(serde_json::from_str::<BridgeConfig>(r#"{"nodename": "a"}"#).is_err());
    }

    #[test]
    fn frames_are_named_after_the_namespace() {
        let prefix =
            |namespace: &str| BridgeConfig { namespace: namespace.into(), ..BridgeConfig::default() }.tf_prefix();
        assert_eq!((prefix("/"), prefix("/left/arm")), (String::new(), "left/arm/".to_owned()));
    }
}
