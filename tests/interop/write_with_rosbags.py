"""Writes a bag as `rosbags` makes it: 10 raw images, their camera, and a topic of strings that nobody plays.

    write_with_rosbags.py BAG [zstd]
"""

import sys
from pathlib import Path

import numpy
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types
SIZE = (320, 240)


def header(number):
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=1_700_000_000 + number // 30, nanosec=number % 30 * 33_333_333)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id="camera_optical_frame")


def messages(number):
    width, height = SIZE
    data = ((numpy.arange(width * height * 3, dtype=numpy.uint32) // 960 + number) % 256).astype(numpy.uint8)
    image = TYPES["sensor_msgs/msg/Image"](
        header(number), height, width, encoding="bgr8", is_bigendian=0, step=3 * width, data=data
    )
    k = numpy.array([300.0, 0, 159.5, 0, 300, 119.5, 0, 0, 1])
    p = numpy.array([300.0, 0, 159.5, 0, 0, 300, 119.5, 0, 0, 0, 1, 0])
    roi = TYPES["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, do_rectify=False)
    info = TYPES["sensor_msgs/msg/CameraInfo"](
        header(number), height, width, "plumb_bob", numpy.zeros(5), k, numpy.eye(3).ravel(), p, 0, 0, roi
    )
    return {
        "/camera/image_raw": image,
        "/camera/camera_info": info,
        "/chatter": TYPES["std_msgs/msg/String"](f"frame {number}"),
    }


def main(path, compression=None):
    writer = Writer(Path(path), version=9, storage_plugin=StoragePlugin.MCAP)
    if compression:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connections = {
            topic: writer.add_connection(topic, message.__msgtype__, typestore=STORE)
            for topic, message in messages(0).items()
        }
        for number in range(10):
            for topic, message in messages(number).items():
                stamp = header(number).stamp
                data = STORE.serialize_cdr(message, message.__msgtype__)
                writer.write(connections[topic], stamp.sec * 10**9 + stamp.nanosec, data)


if __name__ == "__main__":
    main(*sys.argv[1:])
