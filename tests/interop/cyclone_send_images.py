"""Plays a camera and a detector with CycloneDDS for examples/receive_images.rs: 640 x 480.

    cyclone_send_images.py raw|compressed FRAMES HZ
"""

import io
import os
import sys
import time

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from PIL import Image as Picture

import cyclone_types as ros

WIDTH, HEIGHT = 640, 480


def image(kind, header, index):
    colour = (index % 256, 100, 200)
    if kind == "raw":
        data = bytes(colour) * (WIDTH * HEIGHT)
        return ros.Image(header, HEIGHT, WIDTH, "rgb8", 0, WIDTH * 3, data)
    file = io.BytesIO()
    Picture.new("RGB", (WIDTH, HEIGHT), colour).save(file, "JPEG", quality=95, subsampling=0)
    return ros.CompressedImage(header, "rgb8; jpeg compressed rgb8", file.getvalue())


def camera_info(header):
    k = [600.0, 0.0, 319.5, 0.0, 601.0, 239.5, 0.0, 0.0, 1.0]
    r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    p = [600.0, 0.0, 319.5, 0.0, 0.0, 601.0, 239.5, 0.0, 0.0, 0.0, 1.0, 0.0]
    d = [0.0] * 5
    return ros.CameraInfo(header, HEIGHT, WIDTH, "plumb_bob", d, k, r, p, 0, 0, ros.RegionOfInterest(0, 0, 0, 0, False))


def detections(header):
    pose = ros.Pose(ros.Point(0.1, 0.2, 0.3), ros.Quaternion(0.0, 0.0, 0.0, 1.0))
    result = ros.ObjectHypothesisWithPose(ros.ObjectHypothesis("5", 0.8), ros.PoseWithCovariance(pose, [0.0] * 36))
    box = ros.BoundingBox3D(pose, ros.Vector3(0.0, 0.0, 0.0))
    return ros.Detection3DArray(header, [ros.Detection3D(header, [result], box, "0")])


def main():
    kind, frames, hz = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
    participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
    # A camera driver's usual offer; the bridge asks for best effort.
    qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.Durability.Volatile, Policy.History.KeepLast(10))

    def writer(name, message):
        return DataWriter(participant, Topic(participant, f"rt/camera/{name}", message, qos=qos), qos=qos)

    images = writer("image", ros.Image if kind == "raw" else ros.CompressedImage)
    infos = writer("camera_info", ros.CameraInfo)
    arrays = writer("detections", ros.Detection3DArray)
    deadline = time.monotonic() + 60
    while not all(w.get_matched_subscriptions() for w in (images, infos, arrays)):
        if time.monotonic() > deadline:
            print("the camera node was not found within 60 s", file=sys.stderr)
            return 1
        time.sleep(0.02)
    time.sleep(1.0)
    for index in range(frames):
        started = time.monotonic()
        message = image(kind, ros.Header(ros.Time(0, 0), "camera_optical"), index)
        stamp = time.time_ns()
        header = ros.Header(ros.Time(stamp // 1_000_000_000, stamp % 1_000_000_000), "camera_optical")
        message.header = header
        # The small messages first: the image's arrival then completes the frame.
        infos.write(camera_info(header))
        arrays.write(detections(header))
        images.write(message)
        time.sleep(max(0.0, 1.0 / hz - (time.monotonic() - started)))
    time.sleep(2.0)
    return 0


sys.exit(main())
