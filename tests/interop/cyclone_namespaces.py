"""Looks with CycloneDDS at what two graphs in /left and /right publish and hear.

Their topics, node names and frames must differ but for those that all nodes of ROS 2 share; the left one's camera and QoS must be as
its arguments say, and what its bridge warned of at its start is heard on /rosout by who comes later.
"""

import os
import sys
import time

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

import cyclone_types as ros

SHARED = {"rt/tf", "rt/rosout", "rt/parameter_events", "ros_discovery_info"}
OUT = ["object_pose", "object_poses", "object_poses/refused", "object_status", "diagnostics", "vision_info", "label_info",
       "object_description", "objects/cracker_box/pose"]
NODES = {"/left/eye", "/right/pseudoflow"}
# What the bridge says before anybody has found it.
SAID = {("left.eye", "remapping /left/never:=/left/ever matches no topic of this node"),
        ("right.pseudoflow", "ROS_DISCOVERY_SERVER is not honoured: RustDDS knows no discovery server")}


class Latecomer:
    """Hears what is kept for who comes later: the nodes of the graph, as `ros2 node list` reads them, and the log."""

    def __init__(self, participant):
        def reader(name, kind, *policies):
            qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.Durability.TransientLocal, *policies)
            return DataReader(participant, Topic(participant, name, kind, qos=qos), qos=qos)

        self.graph = reader("ros_discovery_info", ros.ParticipantEntitiesInfo, Policy.History.KeepLast(1000))
        self.log = reader("rt/rosout", ros.Log, Policy.History.KeepLast(1000))
        self.nodes, self.said = set(), set()

    def hear(self):
        for sample in ros.taken(self.graph):
            self.nodes.update(f"{node.node_namespace}/{node.node_name}" for node in sample.node_entities_info_seq)
        for sample in ros.taken(self.log):
            assert sample.level == 30 and abs(sample.stamp.sec - time.time()) < 600, sample
            self.said.add((sample.name, sample.msg))


def main():
    participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
    readers = {
        "out": BuiltinDataReader(participant, BuiltinTopicDcpsPublication),
        "in": BuiltinDataReader(participant, BuiltinTopicDcpsSubscription),
    }
    wanted = {f"rt/{side}/{topic}" for side in ("left", "right") for topic in OUT}
    seen = {"out": {}, "in": {}}
    late = Latecomer(participant)
    infos = {"rt/camera/camera_info", "rt/right/camera_info"}
    end = time.monotonic() + 90
    while not (wanted <= set(seen["out"]) and infos <= set(seen["in"]) and NODES <= late.nodes and SAID <= late.said):
        assert time.monotonic() < end, (
            f"missing: {wanted - set(seen['out'])}, {infos - set(seen['in'])}; nodes {late.nodes}; said {late.said}"
        )
        late.hear()
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
    assert late.nodes == NODES, late.nodes
    print(f"{len(topics)} topics, none in both namespaces; nodes {sorted(late.nodes)}; {len(late.said)} lines of /rosout")
    return 0


sys.exit(main())
