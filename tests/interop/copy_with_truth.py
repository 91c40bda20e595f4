"""Copies a bag with `rosbags`, on request with ground truth of every image as one more topic.

    copy_with_truth.py FROM TO [SCENE_GT.json]

The truth is a vision_msgs/Detection3DArray on /ground_truth with the stamps of the images, as somebody who has it would
record it.
"""

import copy
import json
import sys
from pathlib import Path

import numpy
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

TRUTH = "/ground_truth"


def quaternion(r):
    """x, y, z, w of a rotation matrix with a trace above -1."""
    w = numpy.sqrt(max(1e-12, 1 + numpy.trace(r))) / 2
    x, y, z = (r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1])
    return x / (4 * w), y / (4 * w), z / (4 * w), w


def with_true_poses(detections, entries):
    """The detections with the true pose of each object in place of its rough one."""
    out = copy.deepcopy(detections)
    for detection in out.detections:
        object_id = detection.results[0].hypothesis.class_id
        truth = next((e for e in entries if str(e["obj_id"]) == object_id), None)
        if truth is None:
            continue
        pose = detection.results[0].pose.pose
        rotation = numpy.array(truth["cam_R_m2c"]).reshape(3, 3)
        pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w = quaternion(rotation)
        pose.position.x, pose.position.y, pose.position.z = (v / 1000 for v in truth["cam_t_m2c"])
    return out


def main(source, target, truth=None):
    truth = json.loads(Path(truth).read_text()) if truth else None
    count = 0
    with AnyReader([Path(source)]) as reader, Writer(
        Path(target), version=9, storage_plugin=StoragePlugin.MCAP
    ) as writer:
        store = reader.typestore
        connections = {c.topic: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in reader.connections}
        if truth:
            kind = next(c.msgtype for c in reader.connections if c.msgtype.endswith("Detection3DArray"))
            connections[TRUTH] = writer.add_connection(TRUTH, kind, typestore=store)
        images = sorted(truth, key=int) if truth else []
        for connection, stamp, raw in reader.messages():
            writer.write(connections[connection.topic], stamp, raw)
            if truth and connection.topic == "/initial_poses":
                message = with_true_poses(reader.deserialize(raw, connection.msgtype), truth[images[count]])
                writer.write(connections[TRUTH], stamp, bytes(store.serialize_cdr(message, connection.msgtype)))
                count += 1
    print(f"{target}: {count} messages of truth")
    return 0 if not truth or count == len(images) else 1


sys.exit(main(*sys.argv[1:]))
