"""Plays a recording as camera and detector with CycloneDDS, frame by frame, and holds the poses that the live graph publishes against
those that `refine.yaml` recorded of the same recording:

    cyclone_bent.py BAG REPLAYED

They must be equal to the bit, so that what was measured in replay was measured live.
"""

import sys
from pathlib import Path

from rosbags.highlevel import AnyReader

import cyclone_live as live
import cyclone_types as ros
from cyclone_hostile import Listener, Speaker, numbers, until

KINDS = {
    "/camera/camera_info": ros.CameraInfo,
    "/detections": ros.Detection3DArray,
    "/camera/image_raw/compressed": ros.CompressedImage,
}


def ns(header):
    return header.stamp.sec * 10**9 + header.stamp.nanosec


def replayed(bag):
    """As the listener has them: poses that stand and refused ones, by stamp."""
    topics = ["/object_poses", "/object_poses/refused"]
    came = [{}, {}]
    with AnyReader([Path(bag)]) as reader:
        for connection, _, raw in reader.messages():
            if connection.topic in topics:
                message = reader.deserialize(raw, connection.msgtype)
                came[topics.index(connection.topic)][ns(message.header)] = [numbers(d) for d in message.detections]
    return came


def main():
    played = live.recorded(sys.argv[1])
    listener, camera = Listener(), Speaker(KINDS)
    camera.meet()
    until("the graph's answers", lambda: all(r.get_matched_publications() for r in listener.poses))
    lenses = set()
    for frame in played:
        stamp = frame[0].header.stamp
        header = ros.Header(ros.Time(stamp.sec, stamp.nanosec), frame[0].header.frame_id)
        for name, message in zip(KINDS, live.messages(*frame, header), strict=True):
            camera.say(name, message)
        lenses.add((frame[1].distortion_model, any(frame[1].d)))
        until(f"poses of {header}", lambda stamp=header.stamp: listener.has(stamp.ns))
    expected = replayed(sys.argv[2])
    same = sum(listener.came[i].get(stamp) == poses for i in (0, 1) for stamp, poses in expected[i].items())
    poses = sum(len(of) for came in listener.came for of in came.values())
    print(f"{lenses}: {len(played)} frames, {poses} poses live, {same} of {2 * len(played)} messages equal to the bit")
    assert poses > 0 and listener.came == expected, "live and replay differ"
    return 0


sys.exit(main())
