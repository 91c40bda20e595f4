"""Adds to a recording (of `pseudoflow bag from-bop`) what a perfect detector of rectangles would say, vision_msgs/Detection2DArray
on /detections:

    rectangles_of_truth.py BAG SCENE MODELS OUT

SCENE holds `scene_gt.json` of the same images. A rectangle is around the whole projection of an object, hidden parts included
(BOP's `bbox_obj`), and named as MODELS/names.json says. Truth goes in, so the result is for measuring alone.
"""

import json
import sys
from pathlib import Path

import numpy
import yaml
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

VISION = {
    "Point2D": "float64 x\nfloat64 y\n",
    "Pose2D": "vision_msgs/Point2D position\nfloat64 theta\n",
    "BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y\n",
    "ObjectHypothesis": "string class_id\nfloat64 score\n",
    "ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n",
    "Detection2D": "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
    "vision_msgs/BoundingBox2D bbox\nstring id\n",
    "Detection2DArray": "std_msgs/Header header\nvision_msgs/Detection2D[] detections\n",
}
STORE = get_typestore(Stores.ROS2_JAZZY)
for name, text in VISION.items():
    STORE.register(get_types_from_msg(text, f"vision_msgs/msg/{name}"))
T = STORE.types


def vertices_mm(path):
    """Vertices of a binary PLY whose first properties are float x, y, z."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    sizes = {"float": 4, "float32": 4, "double": 8, "uchar": 1, "uint8": 1, "int": 4, "uint": 4}
    count, step, inside, text = 0, 0, False, "ascii" in head.decode().split("\n")[1]
    for line in head.decode().splitlines():
        words = line.split()
        if words[0] == "element":
            inside = words[1] == "vertex"
            count = int(words[2]) if inside else count
        elif words[0] == "property" and inside:
            step += sizes[words[1]]
    if text:
        return numpy.array([line.split()[:3] for line in body.decode().splitlines()[:count]], float)
    rows = numpy.frombuffer(body[: count * step], numpy.uint8).reshape(count, step)
    return rows[:, :12].copy().view(numpy.float32).astype(float)


def rectangle(vertices, instance, k):
    seen = (vertices @ numpy.array(instance["cam_R_m2c"]).reshape(3, 3).T + instance["cam_t_m2c"]) @ k.T
    seen = seen[:, :2] / seen[:, 2:]
    low, high = seen.min(0), seen.max(0)
    return (low + high) / 2, high - low


def detection(header, name, middle, size):
    pose = T["geometry_msgs/msg/PoseWithCovariance"](
        T["geometry_msgs/msg/Pose"](
            T["geometry_msgs/msg/Point"](0.0, 0.0, 0.0), T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        ),
        numpy.zeros(36),
    )
    said = T["vision_msgs/msg/ObjectHypothesisWithPose"](T["vision_msgs/msg/ObjectHypothesis"](name, 1.0), pose)
    center = T["vision_msgs/msg/Pose2D"](T["vision_msgs/msg/Point2D"](*map(float, middle)), 0.0)
    box = T["vision_msgs/msg/BoundingBox2D"](center, *map(float, size))
    return T["vision_msgs/msg/Detection2D"](header, [said], box, "")


def main(bag, scene, models, out):
    names = json.loads((Path(models) / "names.json").read_text())
    truth = json.loads((Path(scene) / "scene_gt.json").read_text())
    meshes = {int(i): vertices_mm(Path(models) / f"obj_{int(i):06d}.ply") for i in names}
    custom = yaml.safe_load((Path(bag) / "metadata.yaml").read_text())["rosbag2_bagfile_information"]["custom_data"]
    ids = iter(json.loads(custom["bop_ids"]))
    with AnyReader([Path(bag)]) as reader, Writer(Path(out), version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for key, value in custom.items():
            writer.set_custom_data(key, value)
        to = {c.topic: writer.add_connection(c.topic, c.msgtype, typestore=reader.typestore) for c in reader.connections}
        kind = "vision_msgs/msg/Detection2DArray"
        said = writer.add_connection("/detections", kind, typestore=STORE)
        for connection, stamp, raw in reader.messages():
            writer.write(to[connection.topic], stamp, bytes(raw))
            if connection.msgtype.endswith("CameraInfo"):
                info = reader.deserialize(raw, connection.msgtype)
                time = T["builtin_interfaces/msg/Time"](info.header.stamp.sec, info.header.stamp.nanosec)
                header = T["std_msgs/msg/Header"](time, info.header.frame_id)
                instances = truth[str(next(ids)[1])]
                k = numpy.array(info.k).reshape(3, 3)
                found = [
                    detection(header, names[str(i["obj_id"])], *rectangle(meshes[i["obj_id"]], i, k)) for i in instances
                ]
                message = T[kind](header, found)
                writer.write(said, stamp, STORE.serialize_cdr(message, kind))


main(*sys.argv[1:])
