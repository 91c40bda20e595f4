"""Plays a recording as camera and detector with CycloneDDS and receives what the live graph makes of it.

    cyclone_live.py BAG FRAMES HZ [DELAY [rectangles]]

The detector takes DELAY seconds for an answer and then takes up the newest image; with `rectangles` it says where an object is in the image,
not how it is turned. Every pose must carry the stamp of an image that was
sent and that image's optical frame, and lie where an object can; object_pose must stay with one object until that has been lost for
5 s (`switch_after_s`). At least as many frames must come back as there were answers, less a tenth and the first two, and every object
must have its name. Of rectangles, whose search takes seconds, thirty frames must come back; FRAMES is then the most that is played.
"""

import os
import sys
import time
from itertools import pairwise

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
NAMES = ["cracker_box", "mustard_bottle", "power_drill", "tomato_soup_can", "foam_brick"]
FRAMES_OF_RECTANGLES = 30
SWITCH_AFTER_NS = 5 * 10**9  # the bridge's switch_after_s
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


def rectangles(array, info):
    """What a detector of rectangles would say of the poses: squares of 0.2 m around the objects."""
    fx, cx, fy, cy = info.k[0], info.k[2], info.k[4], info.k[5]
    found = []
    for detection in array.detections:
        at = detection.results[0].pose.pose.position
        center = ros.Pose2D(ros.Point2D(fx * at.x / at.z + cx, fy * at.y / at.z + cy), 0.0)
        box = ros.BoundingBox2D(center, 0.2 * fx / at.z, 0.2 * fy / at.z)
        found.append(ros.Detection2D(array.header, detection.results, box, ""))
    return ros.Detection2DArray(array.header, found)


def main():
    frames, hz = int(sys.argv[2]), float(sys.argv[3])
    delay = float(sys.argv[4]) if len(sys.argv) > 4 else 0.5
    flat = sys.argv[5:] == ["rectangles"]
    played = recorded(sys.argv[1])
    participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))

    def topic(name, kind):
        return Topic(participant, f"rt/{name}", kind, qos=QOS)

    poses = DataReader(participant, topic("object_pose", ros.PoseStamped), qos=QOS)
    arrays = DataReader(participant, topic("object_poses", ros.Detection3DArray), qos=QOS)
    own = {
        name: DataReader(participant, topic(f"objects/{name}/pose", ros.PoseWithCovarianceStamped), qos=QOS)
        for name in NAMES
    }
    last = {}
    wanted = {"camera/camera_info": ros.CameraInfo, "detections": ros.Detection2DArray if flat else ros.Detection3DArray}
    wanted["camera/image_raw/compressed"] = ros.CompressedImage
    writers = [DataWriter(participant, topic(name, kind), qos=QOS) for name, kind in wanted.items()]
    deadline = time.monotonic() + 90
    while not all(writer.get_matched_subscriptions() for writer in writers):
        assert time.monotonic() < deadline, "the live graph was not found within 90 s"
        time.sleep(0.05)
    time.sleep(1.0)
    sent, got, objects, followed = set(), [], set(), {}
    answers, busy = 0, None

    def receive():
        for sample in ros.taken(poses):
            assert sample.header.frame_id == FRAME, sample.header
            assert 0.1 < sample.pose.position.z < 5.0, sample.pose
            got.append(sample.header.stamp.ns)
            last[sample.header.stamp.ns] = sample.pose.position.x
        for sample in ros.taken(arrays):
            objects.update(d.results[0].hypothesis.class_id for d in sample.detections)
        for name, reader in own.items():
            at = {(s.header.stamp.ns, s.pose.pose.position.x) for s in ros.taken(reader)}
            followed.update((stamp, name) for stamp, x in at if last.get(stamp) == x)

    for index in range(frames):
        if flat and len(got) >= FRAMES_OF_RECTANGLES:
            break
        begun, stamp = time.monotonic(), time.time_ns()
        header = ros.Header(ros.Time(stamp // 10**9, stamp % 10**9), FRAME)
        sent.add(stamp)
        info, array, image = messages(*played[index % len(played)], header)
        writers[0].write(info)
        writers[2].write(image)
        # A detector that looks at one image at a time.
        if busy is None:
            busy = (begun + delay, rectangles(array, info) if flat else array)
        elif begun >= busy[0]:
            writers[1].write(busy[1])
            answers, busy = answers + 1, None
        while time.monotonic() - begun < 1.0 / hz:
            receive()
            time.sleep(0.005)
    end = time.monotonic() + 10
    while time.monotonic() < end:
        receive()
        time.sleep(0.005)
    print(f"{len(sent)} frames sent, {answers} answers, {len(got)} poses received, objects {sorted(objects)}, one pose: {sorted(set(followed.values()))}")
    assert set(got) <= sent, "a pose has the stamp of no image"
    assert got == sorted(got), "poses out of order"
    assert len(set(got)) >= (FRAMES_OF_RECTANGLES if flat else 0.9 * (answers - 2)), "fewer frames came back than there were answers"
    assert objects and not any(name.isdigit() for name in objects), objects
    for (before, left), (stamp, taken_up) in pairwise(sorted(followed.items())):
        lost_ns = stamp - before
        assert left == taken_up or lost_ns >= SWITCH_AFTER_NS, f"object_pose went from {left} to {taken_up} after {lost_ns / 1e9} s"
    return 0


if __name__ == "__main__":
    sys.exit(main())
