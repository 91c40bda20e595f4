"""Reads a recording as `rosbags` (an implementation of rosbag2 of its own) sees it and checks every message.

    read_with_rosbags.py BAG [TOPIC=COUNT ...]

For each topic: the type hash that the bag states is the one computed from the definition that it holds and, for
types that ROS 2 Jazzy ships, from Jazzy's own; every message decodes; stamps of headers and of the recording agree;
images decode; intrinsics and quaternions are sound. With TOPIC=COUNT the counts must be these.
"""

import io
import sys
from pathlib import Path

import numpy
from PIL import Image as Picture
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

JAZZY = get_typestore(Stores.ROS2_JAZZY)


def stamp_ns(message):
    header = message.transforms[0].header if hasattr(message, "transforms") else message.header
    return header.stamp.sec * 10**9 + header.stamp.nanosec


def check_image(message):
    picture = Picture.open(io.BytesIO(message.data.tobytes()))
    assert picture.format.lower() == message.format, (picture.format, message.format)
    picture.load()
    return picture.size


def check_camera(message):
    k = message.k.reshape(3, 3)
    assert numpy.isfinite(k).all() and k[0, 0] > 0 and k[1, 1] > 0 and k[2, 2] == 1
    assert not message.d.any()
    return (message.width, message.height)


def check_pose(pose):
    q = pose.orientation
    assert abs(numpy.linalg.norm([q.x, q.y, q.z, q.w]) - 1) < 1e-6
    assert pose.position.z > 0, "an object behind the camera"


def check(connection, message, sizes):
    kind = connection.msgtype.rsplit("/", 1)[-1]
    if kind == "CompressedImage":
        sizes.add(check_image(message))
    elif kind == "CameraInfo":
        sizes.add(check_camera(message))
    elif kind == "PoseStamped":
        check_pose(message.pose)
    elif kind == "PoseWithCovarianceStamped":
        check_pose(message.pose.pose)
        assert numpy.isfinite(message.pose.covariance).all()
    elif kind == "Detection3DArray":
        for detection in message.detections:
            assert detection.results[0].hypothesis.class_id
            check_pose(detection.results[0].pose.pose)
    elif kind == "TFMessage":
        assert all(t.child_frame_id and "/" not in t.child_frame_id for t in message.transforms)
    elif kind == "DiagnosticArray":
        assert all(s.name and s.message for s in message.status)
    else:
        raise AssertionError(f"no check for {connection.msgtype}")


def type_store(connection, bare):
    """A type store from what the bag itself says."""
    assert connection.msgdef.format == MessageDefinitionFormat.MSG, connection
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
    computed = store.hash_rihs01(connection.msgtype)
    # rosbags takes hashes from metadata.yaml alone: those of a bare file it leaves empty.
    assert bare or computed == connection.digest, f"{connection.topic}: {connection.digest}, computed {computed}"
    if connection.msgtype in JAZZY.fielddefs:
        jazzy = JAZZY.hash_rihs01(connection.msgtype)
        assert jazzy == computed, f"{connection.topic}: {computed}, Jazzy has {jazzy}"
    return store


def main(path, *expected):
    counts, sizes = {}, set()
    with Reader(Path(path)) as reader:
        stores = {connection.topic: type_store(connection, Path(path).is_file()) for connection in reader.connections}
        counts = {connection.topic: 0 for connection in reader.connections}
        for connection, time_ns, data in reader.messages():
            message = stores[connection.topic].deserialize_cdr(data, connection.msgtype)
            if not (hasattr(message, "transforms") and not message.transforms):
                assert stamp_ns(message) == time_ns, (connection.topic, stamp_ns(message), time_ns)
            check(connection, message, sizes)
            counts[connection.topic] += 1
        stated = {c.topic: c.msgcount for c in reader.connections}
        assert stated == counts, (stated, counts)
    assert len(sizes) == 1, f"images and cameras of several sizes: {sizes}"
    for text in expected:
        topic, count = text.split("=")
        assert counts.get(topic) == int(count), f"{topic}: {counts.get(topic)} messages, {count} expected"
    print(f"rosbags reads {path}: {sum(counts.values())} messages, {counts}")


if __name__ == "__main__":
    main(*sys.argv[1:])
