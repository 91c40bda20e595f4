//! What a bag says about its message types: the definition in ROS 2's `.msg` language and its hash.
//!
//! The definitions (`msgs/msg/*.msg`) are those of ROS 2 Jazzy and vision_msgs 4 without comments, each with all that
//! it depends on behind lines of 80 `=`. The hashes (RIHS01 of REP 2011) were computed by `rosbags`' type store from
//! the same definitions; `tests/interop/read_with_rosbags.py` computes them again from what a bag holds.

use super::{
    CameraInfo, CompressedImage, Detection3DArray, DiagnosticArray, Image, PoseStamped, PoseWithCovarianceStamped,
    RosMessage, TFMessage,
};

/// A message type that bags can hold.
pub trait BagMessage: RosMessage {
    /// The definition with all that it depends on.
    const DEFINITION: &'static str;
    /// `RIHS01_` and 64 hexadecimal digits.
    const TYPE_HASH: &'static str;
}

macro_rules! bag_message {
    ($message:ty, $file:literal, $hash:literal) => {
        impl BagMessage for $message {
            const DEFINITION: &'static str = include_str!($file);
            const TYPE_HASH: &'static str = concat!("RIHS01_", $hash);
        }
    };
}

bag_message!(Image, "../../msg/Image.msg", "d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47");
bag_message!(
    CompressedImage,
    "../../msg/CompressedImage.msg",
    "15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a"
);
bag_message!(
    CameraInfo,
    "../../msg/CameraInfo.msg",
    "b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275"
);
bag_message!(
    PoseStamped,
    "../../msg/PoseStamped.msg",
    "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"
);
bag_message!(
    PoseWithCovarianceStamped,
    "../../msg/PoseWithCovarianceStamped.msg",
    "26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e"
);
bag_message!(TFMessage, "../../msg/TFMessage.msg", "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087");
bag_message!(
    Detection3DArray,
    "../../msg/Detection3DArray.msg",
    "793f5eab9595ac1c0da07873cc859db42eae51f0ee76056db8562515d830e018"
);
bag_message!(
    DiagnosticArray,
    "../../msg/DiagnosticArray.msg",
    "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"
);

#[cfg(test)]
mod tests {
    use super::*;

    /// Every type that a definition names must stand in it.
    fn complete<M: BagMessage>() {
        let separator = "=".repeat(80);
        let sections: Vec<&str> = M::DEFINITION.split(&separator).collect();
        let defined: Vec<&str> = sections[1..]
            .iter()
            .map(|s| s.trim_start().lines().next().unwrap().strip_prefix("MSG: ").unwrap())
            .collect();
        for line in M::DEFINITION.lines().filter(|l| !l.starts_with(['=', 'M'])) {
            let type_name = line.split(['[', ' ']).next().unwrap();
            assert!(!type_name.contains('/') || defined.contains(&type_name), "{}: {line}", M::type_name());
        }
    }

    #[test]
    fn definitions_are_complete() {
        complete::<Image>();
        complete::<CompressedImage>();
        complete::<CameraInfo>();
        complete::<PoseStamped>();
        complete::<PoseWithCovarianceStamped>();
        complete::<TFMessage>();
        complete::<Detection3DArray>();
        complete::<DiagnosticArray>();
    }
}
