"""Prints the poses that pseudoflow publishes on /object_pose (geometry_msgs/PoseStamped).

    python3 nodes/cli/examples/subscribe.py [COUNT]      ends after COUNT poses; without, it goes on

In a ROS 2 workspace by rclpy. Elsewhere by CycloneDDS alone (pip install cyclonedds), with the messages as
tests/interop/cyclone_types.py writes them down: take that file along.
"""

import os
import sys
from pathlib import Path


def show(message):
    """The object in the camera's optical frame: x right, y down, z forward, metres; a unit quaternion."""
    stamp, p, q = message.header.stamp, message.pose.position, message.pose.orientation
    time_s = stamp.sec + 1e-9 * stamp.nanosec
    print(f"{time_s:.3f} {message.header.frame_id}: x {p.x:+.3f} y {p.y:+.3f} z {p.z:+.3f} m", end="")
    print(f", rotation {q.x:+.3f} {q.y:+.3f} {q.z:+.3f} {q.w:+.3f}", flush=True)


def poses_by_rclpy(rclpy):
    from geometry_msgs.msg import PoseStamped

    rclpy.init()
    node = rclpy.create_node("pose_printer")
    came = []
    node.create_subscription(PoseStamped, "object_pose", came.append, 10)
    while rclpy.ok():
        rclpy.spin_once(node)
        while came:
            yield came.pop(0)


def poses_by_cyclonedds():
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.internal import InvalidSample
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration

    sys.path.append(str(Path(__file__).resolve().parents[3] / "tests/interop"))
    from cyclone_types import PoseStamped

    participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
    qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(10))
    # A ROS 2 topic is a DDS topic whose name begins with `rt`.
    reader = DataReader(participant, Topic(participant, "rt/object_pose", PoseStamped, qos=qos), qos=qos)
    for sample in reader.take_iter(timeout=duration(seconds=60)):
        if not isinstance(sample, InvalidSample):  # says no more than that a publisher has gone
            yield sample


def poses():
    try:
        import rclpy
    except ImportError:
        return poses_by_cyclonedds()
    return poses_by_rclpy(rclpy)


def main():
    most = int(sys.argv[1]) if len(sys.argv) > 1 else None
    for number, message in enumerate(poses(), start=1):
        show(message)
        if number == most:
            return None
    return "no pose came within a minute"


if __name__ == "__main__":
    sys.exit(main())
