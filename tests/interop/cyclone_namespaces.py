"""Looks with CycloneDDS at what two graphs in /left and /right publish and hear.

Their topics must differ but for those that all nodes of ROS 2 share; the left one's camera and QoS must be as its arguments say.
"""

import os
import sys
import time

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription
from cyclonedds.core import Policy
from cyclonedds.domain import DomainParticipant

SHARED = {"rt/tf", "rt/rosout", "rt/parameter_events", "ros_discovery_info"}
OUT = ["object_pose", "object_poses", "object_poses/refused", "object_status", "diagnostics", "vision_info", "label_info",
       "object_description", "objects/cracker_box/pose"]


def main():
    participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
    readers = {
        "out": BuiltinDataReader(participant, BuiltinTopicDcpsPublication),
        "in": BuiltinDataReader(participant, BuiltinTopicDcpsSubscription),
    }
    wanted = {f"rt/{side}/{topic}" for side in ("left", "right") for topic in OUT}
    seen = {"out": {}, "in": {}}
    infos = {"rt/camera/camera_info", "rt/right/camera_info"}
    end = time.monotonic() + 90
    while not (wanted <= set(seen["out"]) and infos <= set(seen["in"])):
        assert time.monotonic() < end, f"missing: {wanted - set(seen['out'])}, {infos - set(seen['in'])}"
        for way, reader in readers.items():
            for sample in reader.take(N=100):
                if sample.topic_name:
                    seen[way].setdefault(sample.topic_name, sample)
        time.sleep(0.05)
    topics = set(seen["out"]) | set(seen["in"])
    strange = {t for t in topics if not t.startswith(("rt/left/", "rt/right/", "rt/camera/", "DCPS"))} - SHARED
    assert not strange, f"outside of the namespaces: {strange}"
    qos = seen["out"]["rt/left/object_pose"].qos
    assert Policy.Reliability.BestEffort in qos, qos
    assert Policy.Reliability.BestEffort not in seen["out"]["rt/right/object_pose"].qos
    print(f"{len(topics)} topics, none in both namespaces")
    return 0


sys.exit(main())
