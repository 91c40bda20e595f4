use crate::BridgeError;
use crate::participant::{node_name, topic_name};
use pseudoflow_msgs::ros::Naming;
use ros2_client::Name;
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;

/// Most messages that a publisher or subscription may keep.
const MAX_QUEUE_DEPTH: u32 = 10_000;

/// How poses are published, and which camera is taken.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct BridgeConfig {
    /// Name of the ROS 2 node.
    pub node_name: String,
    /// Namespace of `object_pose` and `object_poses`; `/tf` stays where ROS 2 looks for it.
    pub namespace: String,
    /// The object of `object_pose`; without it, the one with the best score.
    pub object_id: Option<u32>,
    /// What objects are called in `class_id`, by object id; the id in digits where a name is missing.
    pub object_names: BTreeMap<u32, String>,
    /// Messages kept for slow reliable subscribers, 1 to 10000.
    #[schemars(range(min = 1, max = 10_000))]
    pub queue_depth: u32,
    /// The camera, where the bridge is the source of a live graph.
    pub camera: Option<CameraConfig>,
}

impl Default for BridgeConfig {
    fn default() -> Self {
        Self {
            node_name: "pseudoflow".into(),
            namespace: "/".into(),
            object_id: None,
            object_names: BTreeMap::new(),
            queue_depth: 100,
            camera: None,
        }
    }
}

/// How images come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Transport {
    /// `sensor_msgs/Image`.
    #[default]
    Raw,
    /// `sensor_msgs/CompressedImage`: jpeg or png.
    Compressed,
}

/// The topics of a live camera.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Topic of the images, from `/` on.
    pub image: String,
    /// How they come.
    #[serde(default)]
    pub transport: Transport,
    /// Topic of their calibration; each image needs one of the same stamp.
    pub camera_info: String,
    /// Whether the images are rectified already: then P of the calibration holds, not K and D.
    #[serde(default)]
    pub rectified: bool,
    /// Topic of a detector's initial poses (Detection3DArray); each image then waits for one of the same stamp.
    #[serde(default)]
    pub detections: Option<String>,
    /// Images that wait for what belongs to them, 1 to 10000; older ones are dropped and counted.
    #[serde(default = "default_camera_depth")]
    #[schemars(range(min = 1, max = 10_000))]
    pub queue_depth: u32,
}

fn default_camera_depth() -> u32 {
    10
}

impl BridgeConfig {
    /// Checks names and ranges.
    ///
    /// # Errors
    /// The first that is wrong.
    pub fn check(&self) -> Result<(), BridgeError> {
        node_name(&self.node_name)?;
        self.topic("object_pose")?;
        check_depth("queue_depth", self.queue_depth)?;
        self.naming()?;
        self.camera.as_ref().map_or(Ok(()), CameraConfig::check)
    }

    /// What objects are called.
    ///
    /// # Errors
    /// When two could not be told apart.
    pub fn naming(&self) -> Result<Naming, BridgeError> {
        Naming::new(self.object_names.clone()).map_err(BridgeError::AmbiguousName)
    }

    /// A topic in the namespace.
    pub(crate) fn topic(&self, name: &str) -> Result<Name, BridgeError> {
        topic_name("namespace", &format!("{}/{name}", self.namespace.trim_end_matches('/')))
    }
}

impl CameraConfig {
    fn check(&self) -> Result<(), BridgeError> {
        topic_name("camera.image", &self.image)?;
        topic_name("camera.camera_info", &self.camera_info)?;
        if let Some(topic) = &self.detections {
            topic_name("camera.detections", topic)?;
        }
        check_depth("camera.queue_depth", self.queue_depth)
    }
}

fn check_depth(field: &'static str, depth: u32) -> Result<(), BridgeError> {
    if (1..=MAX_QUEUE_DEPTH).contains(&depth) {
        return Ok(());
    }
    Err(BridgeError::Range { field, value: depth.into(), min: 1, max: MAX_QUEUE_DEPTH.into() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> CameraConfig {
        serde_json::from_value(serde_json::json!({"image": "/camera/image_raw", "camera_info": "/camera/camera_info"}))
            .unwrap()
    }

    #[test]
    fn the_least_configurations_are_valid() {
        let default: BridgeConfig = serde_json::from_str("{}").unwrap();
        default.check().unwrap();
        BridgeConfig { camera: Some(camera()), ..default }.check().unwrap();
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
        let with = |camera| refused(BridgeConfig { camera: Some(camera), ..default() });
        assert!(with(CameraConfig { image: "image".into(), ..camera() }).contains("`camera.image: image`"));
        assert!(with(CameraConfig { detections: Some("//".into()), ..camera() }).contains("`camera.detections: "));
        assert!(with(CameraConfig { queue_depth: 10_001, ..camera() }).contains("`camera.queue_depth: 10001`"));
        assert!(serde_json::from_str::<BridgeConfig>(r#"{"nodename": "a"}"#).is_err());
    }

    #[test]
    fn topics_lie_in_the_namespace() {
        let topic = |namespace: &str| {
            let config = BridgeConfig { namespace: namespace.into(), ..BridgeConfig::default() };
            config.topic("object_pose").unwrap().to_string()
        };
        assert_eq!(topic("/"), "/object_pose");
        assert_eq!(topic("/robot/arm"), "/robot/arm/object_pose");
    }
}
