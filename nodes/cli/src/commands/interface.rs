//! `pseudoflow interface`: the page of docs/ about ROS 2, made of the code. A test holds the page against it.

use anyhow::Result;
use pseudoflow_bridge::{BridgeConfig, CameraConfig, TfConfig, topics_table};
use serde_json::Value;
use std::process::ExitCode;

pub(crate) fn run() -> Result<ExitCode> {
    print!("{}", page());
    Ok(ExitCode::SUCCESS)
}

const HEAD: &str = "\
# The interface to ROS 2

Made by `pseudoflow interface > docs/interface.md`; do not edit. Poses are `camera_from_object`: where the object is in the camera's
optical frame. Every message out carries the image's stamp and optical frame; no clock is read. Covariances are in ROS's order
(x, y, z, rotation about x, y, z; fixed axes of the camera).

## Topics

Relative names lie in the node's namespace (`/NAMESPACE/object_pose`); `-r FROM:=TO` renames any of them. NAME is the object's name in
the set's `names.json`, with `_` for what ROS 2 does not allow in topics and `object_` before a digit. Two objects whose names become
the same topic are refused before the start. `class_id` is the name as it stands; detections may also give the object's id in digits.

";

const STARTING: &str = "
## Starting

```sh
pseudoflow run config/graphs/live_track.yaml --ros-args -r __ns:=/left -r __node:=eye -p camera.image:=/camera/image_raw --params-file f.yaml
ros2 launch pseudoflow track.launch.yaml camera:=/camera/image_raw namespace:=left
```

| argument | does |
|---|---|
| `-r __ns:=/NS`, `-r __node:=NAME` | names the node; everything relative lies below |
| `-r FROM:=TO` | renames a topic; one that matches nothing is one line in the log |
| `-p NODE.KEY:=VALUE` | as `--set NODE.KEY=VALUE`; a key without a node of the graph is the bridge's |
| `--params-file FILE` | the same from a file, for `/**`, `/NS/NODE`, `NODE`; one for another node is one line in the log |
| `-p qos_overrides.TOPIC.publisher.depth:=5` | also `history`, `reliability`, `durability`, and `subscription` |
| `--log-level LEVEL` | debug, info, warn, error, fatal |

`--allow-rmw-mismatch` goes on under `RMW_IMPLEMENTATION=rmw_zenoh_cpp`, whose nodes do not hear DDS. ROS_DOMAIN_ID, ROS_LOCALHOST_ONLY and
ROS_AUTOMATIC_DISCOVERY_RANGE are honoured; ROS_STATIC_PEERS, CYCLONEDDS_URI, FASTRTPS_DEFAULT_PROFILES_FILE and ROS_DISCOVERY_SERVER are
not, and the log says so.

Messages are the same for all releases of ROS 2 since Humble. The node graph (`ros_discovery_info`, from which `ros2 node list` and `ros2 topic
info` read who publishes what) is not: Humble's gids have 24 bytes, later ones 16. The default build speaks the latter; for Humble build with
`--no-default-features --features humble,training,embed`.

## Cameras

Images are rectified inside: `plumb_bob` (4 or 5 coefficients), `rational_polynomial` (8), `equidistant` (4), to P, or to K where there is no
P, by cubic convolution; what the lens did not see is grey. Regions of interest and binning change the intrinsics as REP 104 says. Encodings: rgb8, bgr8, rgba8,
bgra8, mono8, their forms of 16 bits, bayer_* of 8 and 16 bits, yuv422 (uyvy), yuv422_yuy2 (yuyv), nv12, nv21; JPEG and PNG. What cannot
be used is dropped, counted, and named in the log, on `/rosout` and on `diagnostics`; it never ends the run. When no image comes for two
seconds, the log says why.

";

fn page() -> String {
    let mut page = HEAD.to_owned() + &topics_table() + STARTING;
    page += "## Settings of the node `bridge`\n\n";
    page += &keys::<BridgeConfig>("");
    page += &keys::<TfConfig>("tf.");
    page += &keys::<CameraConfig>("camera.");
    page
}

/// A list of a configuration's keys with what their documentation says.
fn keys<C: schemars::JsonSchema>(above: &str) -> String {
    let schema = schemars::schema_for!(C).to_value();
    let properties = schema.get("properties").and_then(Value::as_object).into_iter().flatten();
    let line = |(key, value): (&String, &Value)| {
        let text = value.get("description").and_then(Value::as_str).unwrap_or_default().replace('\n', " ");
        let default = value.get("default").filter(|v| !v.is_null() && !v.is_object() && !v.is_array());
        let default = default.map(|v| format!(" ({v})")).unwrap_or_default();
        format!("- `{above}{key}`{default}: {text}\n")
    };
    properties.map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_that_of_the_code() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/interface.md");
        let kept = std::fs::read_to_string(path).unwrap_or_default();
        assert!(kept == page(), "docs/interface.md is old: cargo run --release -- interface > docs/interface.md");
    }

    #[test]
    fn every_key_is_explained() {
        for line in page().lines().filter(|line| line.starts_with("- `")) {
            assert!(line.split(": ").nth(1).is_some_and(|text| text.len() > 10), "{line}");
        }
    }
}
