"""Waits with CycloneDDS for what a node in /left publishes for late comers, and for its subscription to /left/image_raw."""

import os
import sys
import time
from pathlib import Path

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsSubscription
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

sys.path.insert(0, str(Path(__file__).parent.parent / "interop"))
import cyclone_types as ros  # noqa: E402

QOS = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.Durability.TransientLocal, Policy.History.KeepLast(1))


def main():
    participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
    labels = DataReader(participant, Topic(participant, "rt/left/label_info", ros.LabelInfo, qos=QOS), qos=QOS)
    subscriptions = BuiltinDataReader(participant, BuiltinTopicDcpsSubscription)
    names, heard, end = set(), set(), time.monotonic() + 60
    while not (names and "rt/left/camera_info" in heard):
        assert time.monotonic() < end, f"nothing published below /left within 60 s; subscriptions {heard}"
        names.update(entry.class_name for sample in labels.take(N=10) for entry in sample.class_map)
        heard.update(sample.topic_name for sample in subscriptions.take(N=100))
        time.sleep(0.05)
    assert "cracker_box" in names, names
    print(f"/left/label_info names {len(names)} objects")


main()
