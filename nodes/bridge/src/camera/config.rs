use crate::BridgeError;
use crate::config::check_depth;
use crate::names::Names;
use schemars::JsonSchema;
use serde::de::value::MapAccessDeserializer;
use serde::de::{MapAccess, Visitor};
use serde::{Deserialize, Deserializer};
use std::fmt;
use std::path::PathBuf;

/// How images come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Transport {
    /// Whatever is published: `sensor_msgs/Image`, else `CompressedImage` on `IMAGE/compressed`.
    #[default]
    Auto,
    /// `sensor_msgs/Image`.
    Raw,
    /// `sensor_msgs/CompressedImage`: jpeg or png.
    Compressed,
}

/// Which CameraInfo belongs to an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum InfoMode {
    /// The one with the image's stamp, as drivers publish it.
    #[default]
    Exact,
    /// The last one that came.
    Latest,
}

/// The topics of a live camera: a mapping, or the images' topic alone.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Topic of the images, such as `/camera/image_raw`.
    pub image: String,
    /// How they come: `auto` (raw, else the files on IMAGE/compressed), `raw`, or `compressed` (the topic itself holds JPEG or PNG files).
    #[serde(default)]
    pub transport: Transport,
    /// Topic of their calibration; without, `camera_info` beside the images.
    #[serde(default)]
    pub camera_info: Option<String>,
    /// Which calibration belongs to an image.
    #[serde(default)]
    pub info: InfoMode,
    /// Calibration file (YAML of camera_calibration) for a camera that publishes none.
    #[serde(default)]
    pub calibration: Option<PathBuf>,
    /// Whether the images are rectified already: then P of the calibration holds, not K and D. Else they are rectified here.
    #[serde(default)]
    pub rectified: bool,
    /// Topic of a detector's initial poses (Detection3DArray).
    #[serde(default)]
    pub detections: Option<String>,
    /// Topic of a detector's rectangles (Detection2DArray).
    #[serde(default)]
    pub rectangles: Option<String>,
    /// How long an image is remembered for a detector's answer, seconds.
    #[serde(default = "default_memory_s")]
    pub memory_s: f64,
    /// Images that wait for their calibration, 1 to 10000; older ones are dropped and counted.
    #[serde(default = "default_camera_depth")]
    #[schemars(range(min = 1, max = 10_000))]
    pub queue_depth: u32,
}

fn default_memory_s() -> f64 {
    2.0
}

fn default_camera_depth() -> u32 {
    10
}

/// Longest memory: images are large.
const MOST_MEMORY_S: f64 = 60.0;

/// A mapping, or the images' topic alone: for the schema of graphs.
#[derive(JsonSchema)]
#[serde(untagged)]
#[allow(dead_code, reason = "its schema is all that is needed")]
pub(crate) enum CameraOrTopic {
    Topic(String),
    Camera(CameraConfig),
}

/// Reads a mapping, or the images' topic alone; an unknown key of the mapping is named.
pub(crate) fn camera_or_topic<'de, D: Deserializer<'de>>(reader: D) -> Result<Option<CameraConfig>, D::Error> {
    struct Either;
    impl<'de> Visitor<'de> for Either {
        type Value = Option<CameraConfig>;
        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a topic, or a mapping with `image`")
        }
        fn visit_str<E>(self, image: &str) -> Result<Self::Value, E> {
            Ok(Some(CameraConfig::of_topic(image)))
        }
        fn visit_unit<E>(self) -> Result<Self::Value, E> {
            Ok(None)
        }
        fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
            CameraConfig::deserialize(MapAccessDeserializer::new(map)).map(Some)
        }
    }
    reader.deserialize_any(Either)
}

impl CameraConfig {
    /// The camera whose images are on a topic, with the defaults.
    #[must_use]
    pub fn of_topic(image: &str) -> Self {
        Self {
            image: image.to_owned(),
            transport: Transport::Auto,
            camera_info: None,
            info: InfoMode::Exact,
            calibration: None,
            rectified: false,
            detections: None,
            rectangles: None,
            memory_s: default_memory_s(),
            queue_depth: default_camera_depth(),
        }
    }

    /// The topic of raw images: that of the configuration without `/compressed`.
    pub(crate) fn raw_topic(&self) -> &str {
        self.image.strip_suffix("/compressed").unwrap_or(&self.image)
    }

    /// The topic of compressed images, as image_transport names it.
    pub(crate) fn compressed_topic(&self) -> String {
        match self.transport {
            // Who names a transport names its topic.
            Transport::Compressed => self.image.clone(),
            _ => format!("{}/compressed", self.raw_topic()),
        }
    }

    /// The calibration's topic.
    pub(crate) fn info_topic(&self) -> String {
        self.camera_info.clone().unwrap_or_else(|| match self.raw_topic().rsplit_once('/') {
            Some((folder, _)) => format!("{folder}/camera_info"),
            None => "camera_info".to_owned(),
        })
    }

    pub(crate) fn check(&self, names: &Names) -> Result<(), BridgeError> {
        names.resolve("camera.image", &self.image)?;
        names.resolve("camera.camera_info", &self.info_topic())?;
        for (field, topic) in [("camera.detections", &self.detections), ("camera.rectangles", &self.rectangles)] {
            topic.as_deref().map(|topic| names.resolve(field, topic)).transpose()?;
        }
        if !(self.memory_s >= 0.0 && self.memory_s <= MOST_MEMORY_S) {
            return Err(BridgeError::Seconds { field: "camera.memory_s", value: self.memory_s });
        }
        if let Some(path) = &self.calibration {
            pseudoflow_edge::camera::read_calibration(path)?;
        }
        check_depth("camera.queue_depth", self.queue_depth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BridgeConfig;

    fn read(text: &str) -> Result<BridgeConfig, serde_json::Error> {
        serde_json::from_str(text)
    }

    #[test]
    fn one_name_suffices() {
        let camera = read(r#"{"camera": "/cam/image_raw"}"#).unwrap().camera.unwrap();
        assert_eq!(camera, read(r#"{"camera": {"image": "/cam/image_raw"}}"#).unwrap().camera.unwrap());
        assert_eq!(
            (camera.raw_topic(), camera.compressed_topic()),
            ("/cam/image_raw", "/cam/image_raw/compressed".into())
        );
        assert_eq!(camera.info_topic(), "/cam/camera_info");
        let compressed = CameraConfig::of_topic("/cam/image_raw/compressed");
        assert_eq!((compressed.raw_topic(), compressed.info_topic()), ("/cam/image_raw", "/cam/camera_info".into()));
        assert_eq!(CameraConfig::of_topic("image").info_topic(), "camera_info");
        assert!(read(r#"{"camera": null}"#).unwrap().camera.is_none());
    }

    #[test]
    fn wrong_cameras_are_named() {
        assert!(read(r#"{"camera": {"image": "/a", "topc": 1}}"#).unwrap_err().to_string().contains("topc"));
        assert!(read(r#"{"camera": 3}"#).unwrap_err().to_string().contains("a topic, or a mapping"));
        let refused = |change: fn(&mut CameraConfig)| {
            let mut camera = CameraConfig::of_topic("/cam/image_raw");
            change(&mut camera);
            camera.check(&Names::new(&BridgeConfig::default())).unwrap_err().to_string()
        };
        assert!(refused(|c| c.image = "/a b".into()).contains("`camera.image: /a b`"));
        assert!(refused(|c| c.detections = Some("//".into())).contains("`camera.detections: "));
        assert!(refused(|c| c.queue_depth = 10_001).contains("`camera.queue_depth: 10001`"));
        assert!(refused(|c| c.memory_s = -1.0).contains("`camera.memory_s: -1`"));
        assert!(refused(|c| c.calibration = Some("/nowhere.yaml".into())).contains("/nowhere.yaml"));
    }
}
