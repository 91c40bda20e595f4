"""Plays a camera and a detector with CycloneDDS and, beside them, somebody who sends every message wrong in every way.

    cyclone_hostile.py BAG FRAMES raw|compressed calm|hostile OUT

Each frame is sent when the poses of the one before have come back, so that its outcome depends on nothing but itself. What came
back is written to OUT (JSON). Where there is somebody hostile, all that was wrong must be counted on /diagnostics under its topic
and kind, to the message, and the good frames' messages carry garbage in every field that nobody reads.
"""

import copy
import io
import json
import os
import sys
import time
from collections import Counter

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from PIL import Image as Picture

import cyclone_live as live
import cyclone_types as ros
from hostile_messages import HUGE, INF, NAN, WRONG

PATIENCE_S = 180
QOS = Qos(Policy.Reliability.Reliable(duration(seconds=60)), Policy.Durability.Volatile, Policy.History.KeepAll)
BEGIN_S = 1_700_000_000


def until(what, step):
    """Repeats a step until it gives something true."""
    deadline = time.monotonic() + PATIENCE_S
    while not (result := step()):
        assert time.monotonic() < deadline, f"{what}: not within {PATIENCE_S} s"
        time.sleep(0.005)
    return result


class Speaker:
    """A participant that publishes what the graph hears."""

    def __init__(self, kinds):
        self.participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
        self.writers = {name: self.writer(name, kind) for name, kind in kinds.items()}

    def writer(self, name, kind):
        return DataWriter(self.participant, Topic(self.participant, "rt" + name, kind, qos=QOS), qos=QOS)

    def meet(self):
        until("the live graph", lambda: all(w.get_matched_subscriptions() for w in self.writers.values()))

    def say(self, name, message):
        self.writers[name].write(message)

    def heard(self):
        """Waits until the graph has all that was said."""
        for name, writer in self.writers.items():
            assert writer.wait_for_acks(duration(seconds=PATIENCE_S)), f"{name}: not acknowledged"


class Listener:
    """Poses by stamp, and the newest account of what was dropped."""

    def __init__(self):
        self.participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
        self.poses = [self.reader(name, ros.Detection3DArray) for name in ("object_poses", "object_poses/refused")]
        self.diagnostics = self.reader("diagnostics", ros.DiagnosticArray)
        self.came, self.dropped, self.messages = [{}, {}], {}, {}

    def reader(self, name, kind):
        return DataReader(self.participant, Topic(self.participant, f"rt/{name}", kind, qos=QOS), qos=QOS)

    def listen(self):
        for came, reader in zip(self.came, self.poses):
            for sample in ros.taken(reader):
                came[sample.header.stamp.ns] = [numbers(d) for d in sample.detections]
        for sample in ros.taken(self.diagnostics):
            for status in sample.status:
                values = {value.key: value.value for value in status.values}
                self.dropped[status.name, values["kind"]] = int(values["dropped"])
                self.messages[status.name, values["kind"]] = status.message

    def has(self, stamp_ns):
        self.listen()
        return all(stamp_ns in came for came in self.came)


def numbers(detection):
    said, p, q = detection.results[0].hypothesis, *pose_of(detection)
    covariance = [float(v) for v in detection.results[0].pose.covariance]
    return [said.class_id, said.score, p.x, p.y, p.z, q.x, q.y, q.z, q.w, *covariance]


def pose_of(detection):
    pose = detection.results[0].pose.pose
    return pose.position, pose.orientation


def good(played, header, transport):
    """The messages of a frame by topic."""
    info, array, file = live.messages(*played, header)
    picture = Picture.open(io.BytesIO(bytes(file.data))).convert("RGB")
    raw = ros.Image(header, picture.height, picture.width, "rgb8", 0, picture.width * 3, picture.tobytes())
    middle = ros.Pose2D(ros.Point2D(100.0, 100.0), 0.0)
    boxes = [ros.Detection2D(header, d.results, ros.BoundingBox2D(middle, 50.0, 40.0), d.id) for d in array.detections]
    image = {"raw": ("/camera/image_raw", raw), "compressed": ("/camera/image_raw/compressed", file)}[transport]
    rectangles = ros.Detection2DArray(header, boxes)
    return dict([image, ("/camera/camera_info", info), ("/detections", array), ("/rectangles", rectangles)])


def garbage(messages):
    """Fields that nobody reads."""
    array, boxes = messages["/detections"], messages["/rectangles"]
    nowhere = ros.Header(ros.Time(-7, HUGE), "x" * 300)
    for detection in array.detections:
        detection.header = nowhere
        detection.bbox.center = ros.Pose(ros.Point(NAN, INF, -INF), ros.Quaternion(NAN, 0.0, 0.0, 0.0))
        detection.bbox.size = ros.Vector3(NAN, -1.0, INF)
    for box in boxes.detections:
        box.header, box.id, box.bbox.center.theta = nowhere, "y" * 5000, NAN
    messages["/camera/camera_info"].roi.do_rectify = True
    messages["/camera/camera_info"].header = ros.Header(messages["/camera/camera_info"].header.stamp, "z" * 1000)


class Hostile:
    """Sends what is wrong, some of it beside each frame, and knows what must be counted."""

    def __init__(self, kinds, frames):
        self.speaker = Speaker(kinds)
        # The same names with types that say something else.
        self.mumbler = Speaker({name: ros.garbled(kind) for name, kind in kinds.items()})
        self.mumbler.meet()
        self.speaker.meet()
        self.expected, self.frames = Counter(), frames
        self.plans = {name: WRONG[name]() for name in kinds}

    def send(self, names, index, messages):
        for name in names:
            plan = self.plans[name]
            for kind, spoil in plan[index :: self.frames]:
                bad = copy.deepcopy(messages[name])
                if name in ("/detections", "/rectangles"):
                    # One object: beside a good one the message is an answer.
                    bad.detections = bad.detections[:1]
                spoil(bad)
                self.speaker.say(name, bad)
                for one in kind if isinstance(kind, list) else [kind]:
                    self.expected[name, one] += 1
            self.mumbler.say(name, ros.garbled(type(messages[name]))(7))
            self.expected[name, "unreadable"] += 1
        self.speaker.heard()
        self.mumbler.heard()


def main():
    bag, frames, transport, mood, out = sys.argv[1], int(sys.argv[2]), *sys.argv[3:6]
    played = live.recorded(bag)
    header = ros.Header(ros.Time(BEGIN_S, 0), live.FRAME)
    kinds = {name: type(message) for name, message in good(played[0], header, transport).items()}
    listener, camera = Listener(), Speaker(kinds)
    camera.meet()
    enemy = Hostile(kinds, frames) if mood == "hostile" else None
    until("the graph's answers", lambda: all(r.get_matched_publications() for r in [*listener.poses, listener.diagnostics]))
    before, after = list(kinds)[:2], list(kinds)[2:]
    for index in range(frames):
        header = ros.Header(ros.Time(BEGIN_S + index // 10, index % 10 * 10**8), live.FRAME)
        messages = good(played[index % len(played)], header, transport)
        if enemy:
            enemy.send(before, index, messages)
            garbage(messages)
        for name in before:
            camera.say(name, messages[name])
        camera.heard()
        if enemy:
            enemy.send(after, index, messages)
        for name in reversed(after):
            camera.say(name, messages[name])
        until(f"poses of frame {index}", lambda: listener.has(header.stamp.ns))
    poses = [[came[stamp] for came in listener.came] for stamp in sorted(listener.came[0])]
    with open(out, "w") as file:
        json.dump(poses, file)
    print(f"{mood}: {frames} frames, {sum(len(p) for frame in poses for p in frame)} poses")
    if enemy:
        account(listener, dict(enemy.expected))


def account(listener, expected):
    def counted():
        listener.listen()
        return sum(listener.dropped.values()) >= sum(expected.values())

    try:
        until("the account of all that was wrong", counted)
    finally:
        for key in sorted(set(expected) | set(listener.dropped)):
            sent, dropped = expected.get(key, 0), listener.dropped.get(key, 0)
            mark = "" if sent == dropped else "   <-- differs"
            print(f"{key[0]:30} {key[1]:16} {sent:5} sent {dropped:5} counted{mark}")
    assert listener.dropped == expected, "what was counted is not what was sent"
    assert all(len(text) > 20 for text in listener.messages.values()), listener.messages
    print(f"{sum(expected.values())} wrong messages and detections, all counted and named")


if __name__ == "__main__":
    sys.exit(main())
