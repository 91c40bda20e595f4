use crate::EnvironmentError;
use pseudoflow_edge::CatalogueError;
use pseudoflow_edge::camera::CalibrationFileError;
use pseudoflow_msgs::ros::NamingError;

/// What goes wrong at the edge to ROS 2.
#[derive(Debug, thiserror::Error)]
pub enum BridgeError {
    /// The environment cannot be honoured.
    #[error(transparent)]
    Environment(#[from] EnvironmentError),
    /// DDS did not give what was asked for.
    #[error(
        "DDS: cannot create {what}: {cause}; are there free UDP ports and no more than a dozen participants on this host?"
    )]
    Create {
        /// Participant, node, publisher or subscription, with its topic.
        what: String,
        /// What ros2-client said.
        cause: String,
    },
    /// A name that ROS 2 does not allow.
    #[error("`{field}: {name}` is no ROS 2 name: {cause}; use letters, digits, `_` and `/`, such as /camera/image_raw")]
    Name {
        /// Configuration field.
        field: &'static str,
        /// Its value.
        name: String,
        /// What ros2-client said.
        cause: String,
    },
    /// A number outside its range.
    #[error("`{field}: {value}`: must be from {min} to {max}")]
    Range {
        /// Configuration field.
        field: &'static str,
        /// Its value.
        value: u64,
        /// Smallest.
        min: u64,
        /// Largest.
        max: u64,
    },
    /// Two objects that could not be told apart outside.
    #[error("`object_names`: {0}")]
    Naming(#[from] NamingError),
    /// An object set that cannot be named.
    #[error("`objects`: {0}")]
    Catalogue(#[from] CatalogueError),
    /// A calibration file.
    #[error("`camera.calibration`: {0}")]
    Calibration(#[from] CalibrationFileError),
    /// Another middleware than DDS.
    #[error(
        "RMW_IMPLEMENTATION={0}: pseudoflow speaks DDS, which nodes of this middleware do not hear; run them with \
         rmw_cyclonedds_cpp or rmw_fastrtps_cpp, or go on with --allow-rmw-mismatch (`allow_rmw_mismatch: true`)"
    )]
    Middleware(String),
    /// Seconds that are none.
    #[error("`{field}: {value}`: give seconds from 0 on (`camera.memory_s`: up to 60)")]
    Seconds {
        /// Configuration field.
        field: &'static str,
        /// Its value.
        value: f64,
    },
    /// A stamp that ROS time cannot hold.
    #[error("frame {index} has stamp {stamp_ns} ns, outside of what builtin_interfaces/Time holds (1901 to 2038)")]
    Stamp {
        /// Frame.
        index: u64,
        /// Its stamp.
        stamp_ns: i64,
    },
    /// A message that DDS did not take.
    #[error("DDS: cannot publish on {topic}: {cause}")]
    Publish {
        /// Topic.
        topic: String,
        /// What ros2-client said.
        cause: String,
    },
    /// The graph takes frames from a bridge without a camera.
    #[error("the graph takes frames from the bridge, but its configuration names no camera: add `camera: ...`")]
    NoCamera,
}
