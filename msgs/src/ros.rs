//! ROS 2 messages as bags and DDS carry them: CDR through serde, field by field as in the `.msg` files of ROS 2 Jazzy.
//!
//! Producers and consumers: player (reads bags), recorder (writes bags), bridge (DDS). Nothing else in the house
//! sees them: inside it, messages are read in place.
//!
//! | type | file |
//! |---|---|
//! | `sensor_msgs/Image`, `CompressedImage`, `CameraInfo` | `image`, `compressed_image`, `camera_info` |
//! | `geometry_msgs/PoseStamped`, `PoseWithCovarianceStamped` and their parts | `pose`, `pose_stamped` |
//! | `vision_msgs/Detection3DArray` | `detection3d_array` |
//! | `tf2_msgs/TFMessage` | `tf_message` |
//! | `diagnostic_msgs/DiagnosticArray` | `diagnostics` |
//! | `vision_msgs/VisionInfo`, `LabelInfo`, `Detection2DArray`, `std_msgs/String` | `vision` |
//!
//! ```
//! use pseudoflow_msgs::ros::{Header, Point, Pose, PoseStamped, RosMessage, Time, from_cdr, to_cdr};
//!
//! let header = Header { stamp: Time { sec: 12, nanosec: 0 }, frame_id: "camera_optical".into() };
//! let pose = Pose { position: Point { x: 0.1, y: 0.0, z: 0.8 }, ..Pose::default() };
//! let message = PoseStamped { header, pose };
//! // The bytes that DDS and bags carry.
//! assert_eq!(from_cdr::<PoseStamped>(&to_cdr(&message)?)?, message);
//! assert_eq!(PoseStamped::type_name(), "geometry_msgs/msg/PoseStamped");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod camera_info;
mod cdr;
mod compressed_image;
mod detection3d_array;
mod diagnostics;
mod follow;
mod header;
mod image;
mod naming;
mod object_poses;
mod pose;
mod pose_stamped;
mod schema;
mod tf_message;
mod vision;

pub use camera_info::{CameraInfo, RegionOfInterest};
pub use cdr::{CdrError, from_cdr, to_cdr};
pub use compressed_image::CompressedImage;
pub use detection3d_array::{BoundingBox3D, Detection3D, Detection3DArray, ObjectHypothesis, ObjectHypothesisWithPose};
pub use diagnostics::{DiagnosticArray, DiagnosticStatus, KeyValue, diagnostics};
pub use follow::{Followed, Follower};
pub use header::{Header, Time};
pub use image::Image;
pub use naming::{Naming, NamingError, ObjectBox};
pub use object_poses::{
    DetectionError, detections, object_poses, pose_stamped, pose_with_covariance_stamped, standing, transforms,
};
pub use pose::{Point, Pose, PoseWithCovariance, Quaternion, Vector3};
pub use pose_stamped::{PoseStamped, PoseWithCovarianceStamped};
pub use schema::BagMessage;
pub use tf_message::{TFMessage, Transform, TransformStamped};
pub use vision::{
    BoundingBox2D, Detection2D, Detection2DArray, LabelInfo, Point2D, Pose2D, StringMessage, VisionClass, VisionInfo,
};

use serde::Serialize;
use serde::de::DeserializeOwned;

/// A ROS 2 message type.
pub trait RosMessage: Serialize + DeserializeOwned + 'static {
    /// Its package, as in `sensor_msgs`.
    const PACKAGE: &'static str;
    /// Its name in the package, as in `Image`.
    const NAME: &'static str;

    /// The name that bags use: `sensor_msgs/msg/Image`.
    #[must_use]
    fn type_name() -> String {
        format!("{}/msg/{}", Self::PACKAGE, Self::NAME)
    }
}

macro_rules! ros_message {
    ($message:ty, $package:literal, $name:literal) => {
        impl crate::ros::RosMessage for $message {
            const PACKAGE: &'static str = $package;
            const NAME: &'static str = $name;
        }
    };
}
use ros_message;
