"""Bends the images of a recording as a lens would, and says so in CameraInfo; all other topics stay as they are.

    bend_recording.py BAG OUT plumb_bob|rational_polynomial|equidistant [straight]

With `straight` the images are decoded and written as PNG again, not bent: what the bent ones are to be held against.
"""

import sys
from pathlib import Path

import cv2
import numpy
import yaml
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

LENSES = {
    "plumb_bob": [-0.28, 0.09, 0.0012, -0.0007, -0.013],
    "rational_polynomial": [0.42, -2.1, 0.0006, -0.0003, 1.4, 0.31, -1.95, 1.33],
    "equidistant": [-0.013, 0.021, -0.017, 0.004],
}


def straight_from_bent(model, d, k, size):
    """Where each pixel of the bent image is in the straight one."""
    v, u = numpy.mgrid[0 : size[1], 0 : size[0]].astype(numpy.float64)
    pixels = numpy.stack([u.ravel(), v.ravel()], -1)[:, None]
    d = numpy.array(d)
    if model == "equidistant":
        points = getattr(cv2, "fisheye", cv2).undistortPoints(pixels, k, d, P=k)
    else:
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-9)
        points = cv2.undistortPoints(pixels, k, d, P=k, criteria=criteria)
    return points.reshape(size[1], size[0], 2).astype(numpy.float32)


def main(source, target, model, straight=None):
    cameras = {}
    with AnyReader([Path(source)]) as reader, Writer(
        Path(target), version=9, storage_plugin=StoragePlugin.MCAP
    ) as writer:
        # What `bag from-bop` keeps: which image of the scene each frame is.
        metadata = yaml.safe_load((Path(source) / "metadata.yaml").read_text())
        for key, value in (metadata["rosbag2_bagfile_information"].get("custom_data") or {}).items():
            writer.set_custom_data(key, value)
        store = reader.typestore
        to = {c.topic: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in reader.connections}
        for connection, _, raw in reader.messages():
            if connection.msgtype.endswith("CameraInfo"):
                info = reader.deserialize(raw, connection.msgtype)
                cameras[(info.header.stamp.sec, info.header.stamp.nanosec)] = info.k.reshape(3, 3)
        warps = {}
        for connection, stamp, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            if connection.msgtype.endswith("CameraInfo") and not straight:
                message.distortion_model, message.d = model, numpy.array(LENSES[model])
                raw = store.serialize_cdr(message, connection.msgtype)
            elif connection.msgtype.endswith("CompressedImage"):
                image = cv2.imdecode(message.data, cv2.IMREAD_COLOR)
                if not straight:
                    k = cameras[(message.header.stamp.sec, message.header.stamp.nanosec)]
                    size = (image.shape[1], image.shape[0])
                    key = (k.tobytes(), size)
                    if key not in warps:
                        warps[key] = straight_from_bent(model, LENSES[model], k, size)
                    # A lens does not blur as resampling does: the sharpest that OpenCV has.
                    image = cv2.remap(image, warps[key], None, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_CONSTANT)
                message.format, message.data = "png", cv2.imencode(".png", image)[1].ravel()
                raw = store.serialize_cdr(message, connection.msgtype)
            writer.write(to[connection.topic], stamp, bytes(raw))
    print(f"{target}: {model}{' straight' if straight else ''}")


main(*sys.argv[1:])
