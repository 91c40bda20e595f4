"""Plays a recording as camera and detector with CycloneDDS and receives what the live graph makes of it.

    cyclone_live.py BAG FRAMES HZ

Every pose must carry the stamp of an image that was sent and that image's optical frame, and lie where an object can.
Live drops frames when it is busy: at least half of them must come back, and every refined object must be known.
"""

import os
import sys
import time

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from rosbags.highlevel import AnyReader
from pathlib import Path

import cyclone_types as ros

FRAME = "camera_optical_live"
QOS = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.Durability.Volatile, Policy.History.KeepLast(10))


def recorded(bag):
    """Images, cameras and detections of a bag, by stamp."""
    kinds = {"CompressedImage": {}, "CameraInfo": {}, "Detection3DArray": {}}
    with AnyReader([Path(bag)]) as reader:
        for connection, _, raw in reader.messages():
            found = kinds.get(connection.msgtype.rsplit("/", 1)[-1])
            if found is not None:
                message = reader.deserialize(raw, connection.msgtype)
                found[message.header.stamp.sec * 10**9 + message.header.stamp.nanosec] = message
    stamps = sorted(set.intersection(*(set(k) for k in kinds.values())))
    assert stamps, f"{bag}: no image has camera and detections"
    return [[kind[stamp] for kind in kinds.values()] for stamp in stamps]


def pose(message):
    p, q = message.position, message.orientation
    return ros.Pose(ros.Point(p.x, p.y, p.z), ros.Quaternion(q.x, q.y, q.z, q.w))


def messages(image, info, array, header):
    roi = ros.RegionOfInterest(0, 0, 0, 0, False)
    k, r, p, d = (list(map(float, values)) for values in (info.k, info.r, info.p, info.d))
    camera = ros.CameraInfo(header, info.height, info.width, info.distortion_model, d, k, r, p, 0, 0, roi)
    detections = []
    for detection in array.detections:
        at = pose(detection.results[0].pose.pose)
        said = detection.results[0].hypothesis
        result = ros.ObjectHypothesisWithPose(
            ros.ObjectHypothesis(said.class_id, said.score), ros.PoseWithCovariance(at, [0.0] * 36)
        )
        box = ros.BoundingBox3D(at, ros.Vector3(0.0, 0.0, 0.0))
        detections.append(ros.Detection3D(header, [result], box, detection.id))
    picture = ros.CompressedImage(header, image.format, image.data.tobytes())
    return camera, ros.Detection3DArray(header, detections), picture


def main():
    frames, hz = int(sys.argv[2]), float(sys.argv[3])
    played = recorded(sys.argv[1])
    participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))

    def topic(name, kind):
        return Topic(participant, f"rt/{name}", kind, qos=QOS)

    poses = DataReader(participant, topic("object_pose", ros.PoseStamped), qos=QOS)
    arrays = DataReader(participant, topic("object_poses", ros.Detection3DArray), qos=QOS)
    wanted = {"camera/camera_info": ros.CameraInfo, "detections": ros.Detection3DArray}
    wanted["camera/image_raw/compressed"] = ros.CompressedImage
    writers = [DataWriter(participant, topic(name, kind), qos=QOS) for name, kind in wanted.items()]
    deadline = time.monotonic() + 90
    while not all(writer.get_matched_subscriptions() for writer in writers):
        assert time.monotonic() < deadline, "the live graph was not found within 90 s"
        time.sleep(0.05)
    time.sleep(1.0)
    sent, got, objects = set(), [], set()

    def receive():
        for sample in poses.take(N=100):
            assert sample.header.frame_id == FRAME, sample.header
            assert 0.1 < sample.pose.position.z < 5.0, sample.pose
            got.append(sample.header.stamp.ns)
        for sample in arrays.take(N=100):
            objects.update(d.results[0].hypothesis.class_id for d in sample.detections)

    for index in range(frames):
        begun, stamp = time.monotonic(), time.time_ns()
        header = ros.Header(ros.Time(stamp // 10**9, stamp % 10**9), FRAME)
        sent.add(stamp)
        for writer, message in zip(writers, messages(*played[index % len(played)], header), strict=True):
            writer.write(message)
        while time.monotonic() - begun < 1.0 / hz:
            receive()
            time.sleep(0.005)
    end = time.monotonic() + 10
    while len(got) < frames and time.monotonic() < end:
        receive()
        time.sleep(0.005)
    print(f"{frames} frames sent, {len(got)} poses received, objects {sorted(objects)}")
    assert set(got) <= sent, "a pose has the stamp of no image"
    assert got == sorted(got), "poses out of order"
    assert 2 * len(set(got)) >= frames and objects, "fewer than half of the frames came back"
    return 0


sys.exit(main())
