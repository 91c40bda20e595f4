"""Receives FRAMES of what examples/publish_poses.rs sends with CycloneDDS and compares every value; ends in 1 when one
is missing, doubled, out of order or different.

    cyclone_receive_poses.py FRAMES
"""

import math
import os
import sys
import time
from xml.etree import ElementTree

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from cyclone_types import (
    Detection3DArray,
    LabelInfo,
    PoseStamped,
    PoseWithCovarianceStamped,
    String,
    TFMessage,
    VisionInfo,
)

FIRST_STAMP_NS = 1_700_000_000_000_000_000
FRAME_NS = 33_333_333
SILENCE_S = 60.0


def expected_pose(index, object_id=5):
    right = 0.0 if object_id == 5 else 1.0
    half = 0.005 * index
    return (0.001 * index + right, -0.002 * index, 1.0 + 0.003 * index, 0.0, 0.0, math.sin(half), math.cos(half))


def close(a, b):
    return all(abs(x - y) <= 1e-15 * max(1.0, abs(y)) for x, y in zip(a, b, strict=True))


def numbers(position, orientation):
    return (position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w)


def check_header(header, index, what):
    expected = (FIRST_STAMP_NS + index * FRAME_NS, "camera_optical")
    assert (header.stamp.ns, header.frame_id) == expected, f"{what} {index}: {header} is not {expected}"


def check_pose(sample, index):
    check_header(sample.header, index, "object_pose")
    got = numbers(sample.pose.position, sample.pose.orientation)
    assert close(got, expected_pose(index)), f"object_pose {index}: {got}"


def check_poses(sample, index):
    check_header(sample.header, index, "object_poses")
    said = [(d.results[0].hypothesis.class_id, d.results[0].hypothesis.score, d.id) for d in sample.detections]
    assert said == [("mustard", 0.9, "mustard"), ("soup can", 0.5, "soup_can")], f"object_poses {index}: {said}"
    for detection, object_id in zip(sample.detections, (5, 7), strict=True):
        check_header(detection.header, index, "detection")
        pose = detection.results[0].pose
        got = numbers(pose.pose.position, pose.pose.orientation)
        assert close(got, expected_pose(index, object_id)), f"object_poses {index}: {got}"
        assert list(pose.covariance) == [float(e + index) for e in range(36)], f"object_poses {index}: covariance"


def check_refused(sample, index):
    check_header(sample.header, index, "object_poses/refused")
    said = [(d.results[0].hypothesis.class_id, d.results[0].hypothesis.score, d.id) for d in sample.detections]
    assert said == [("9", 0.95, "object_9")], f"object_poses/refused {index}: {said}"


def check_own(sample, index):
    check_header(sample.header, index, "objects/soup_can/pose")
    got = numbers(sample.pose.pose.position, sample.pose.pose.orientation)
    assert close(got, expected_pose(index, 7)), f"objects/soup_can/pose {index}: {got}"
    assert list(sample.pose.covariance) == [float(e + index) for e in range(36)], "objects/soup_can/pose: covariance"


def latched(participant):
    """What was said once, before we came."""
    qos = Qos(
        Policy.Reliability.Reliable(duration(seconds=1)), Policy.Durability.TransientLocal, Policy.History.KeepLast(1)
    )
    wanted = {"vision_info": VisionInfo, "label_info": LabelInfo, "object_description": String}
    return {n: DataReader(participant, Topic(participant, f"rt/{n}", k, qos=qos), qos=qos) for n, k in wanted.items()}


def check_latched(readers):
    end = time.monotonic() + 20
    said = {}
    while len(said) < len(readers) and time.monotonic() < end:
        for name, reader in readers.items():
            said.update({name: sample for sample in reader.take(N=1)})
        time.sleep(0.01)
    assert len(said) == len(readers), f"only {sorted(said)} of what is latched came"
    classes = [(c.class_id, c.class_name) for c in said["label_info"].class_map]
    assert classes == [(5, "mustard"), (7, "soup can")], classes
    assert said["vision_info"].method.startswith("pseudoflow")
    links = [link.attrib["name"] for link in ElementTree.fromstring(said["object_description"].data).findall("link")]
    assert links == ["camera_optical", "mustard", "soup_can"], links


def check_tf(sample, index):
    assert [t.child_frame_id for t in sample.transforms] == ["mustard", "soup_can"], f"tf {index}: {sample}"
    for transform, object_id in zip(sample.transforms, (5, 7), strict=True):
        check_header(transform.header, index, "tf")
        got = numbers(transform.transform.translation, transform.transform.rotation)
        assert close(got, expected_pose(index, object_id)), f"tf {index}: {got}"


def main():
    frames = int(sys.argv[1])
    participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
    qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.Durability.Volatile, Policy.History.KeepAll)
    once = latched(participant)
    wanted = {"object_poses": (Detection3DArray, check_poses), "tf": (TFMessage, check_tf)}
    wanted["object_poses/refused"] = (Detection3DArray, check_refused)
    wanted["objects/soup_can/pose"] = (PoseWithCovarianceStamped, check_own)
    # The publisher waits for the reader of object_pose: it comes last.
    wanted["object_pose"] = (PoseStamped, check_pose)
    readers = {
        name: DataReader(participant, Topic(participant, f"rt/{name}", kind, qos=qos), qos=qos)
        for name, (kind, _) in wanted.items()
    }
    received = dict.fromkeys(readers, 0)
    last = time.monotonic()
    while min(received.values()) < frames and time.monotonic() - last < SILENCE_S:
        for name, reader in readers.items():
            for sample in reader.take(N=100):
                wanted[name][1](sample, received[name])
                received[name] += 1
                last = time.monotonic()
        time.sleep(0.002)
    print(f"CycloneDDS received, of {frames}: {received}")
    check_latched(once)
    return 0 if all(count == frames for count in received.values()) else 1


sys.exit(main())
