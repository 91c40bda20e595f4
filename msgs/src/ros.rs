//! ROS 2 messages as bags and DDS carry them: CDR through serde. Producer and consumers: player, recorder, bridge.
