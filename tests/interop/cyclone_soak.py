"""Sends frames to a live graph as fast as their poses come back, and looks what its processes hold meanwhile.

    cyclone_soak.py FRAMES PID RUN_DIR

PID is the supervisor's. File descriptors and shared memory must be the same from the first quarter of the frames to the last;
resident memory may grow by a twentieth and 8 MB (allocators keep what they had), whatever the number of frames.
"""

import itertools
import json
import os
import pathlib
import sys
import time

import cyclone_types as ros
from cyclone_hostile import BEGIN_S, PATIENCE_S, Listener, Speaker, until

WIDTH, HEIGHT, FRAME = 64, 48, "camera_optical"
# So many frames are on their way beside the one that is waited for: 0 has next to none passed over.
AHEAD = 0


def messages(index):
    stamp = ros.Time(BEGIN_S + index // 1000, index % 1000 * 10**6)
    header = ros.Header(stamp, FRAME)
    data = bytes([index % 256, 100, 200]) * (WIDTH * HEIGHT)
    image = ros.Image(header, HEIGHT, WIDTH, "rgb8", 0, WIDTH * 3, data)
    k = [60.0, 0.0, 31.5, 0.0, 60.0, 23.5, 0.0, 0.0, 1.0]
    roi = ros.RegionOfInterest(0, 0, 0, 0, False)
    info = ros.CameraInfo(header, HEIGHT, WIDTH, "plumb_bob", [0.0] * 5, k, [0.0] * 9, [0.0] * 12, 0, 0, roi)
    pose = ros.Pose(ros.Point(0.0, 0.0, 0.5 + index % 100 * 1e-3), ros.Quaternion(0.0, 0.0, 0.0, 1.0))
    result = ros.ObjectHypothesisWithPose(ros.ObjectHypothesis("5", 0.8), ros.PoseWithCovariance(pose, [0.0] * 36))
    found = ros.Detection3D(header, [result], ros.BoundingBox3D(pose, ros.Vector3(0.0, 0.0, 0.0)), "0")
    return stamp.ns, {"/camera/camera_info": info, "/camera/image_raw": image,
                      "/detections": ros.Detection3DArray(header, [found])}


def warm_up(listener, camera):
    """Sends frames, a second apart, until the graph answers one: between our finding the graph and the graph's finding us, what is
    sent may be lost for good, as topics are volatile. A camera sends on, and so must we before frames are sent one by one."""
    for index in itertools.count(-PATIENCE_S):
        stamp_ns, sent = messages(index)
        for name, message in sent.items():
            camera.say(name, message)
        patience = time.monotonic() + 1
        while time.monotonic() < patience:
            if newest(listener) > 0:
                return index + PATIENCE_S + 1
            time.sleep(0.005)
        assert index < 0, f"poses after {PATIENCE_S} frames in as many seconds: none"


def held(supervisor, prefix):
    """Resident kB and descriptors of each process, kB (touched or not) and number of the run's segments."""
    pids = pathlib.Path(f"/proc/{supervisor}/task/{supervisor}/children").read_text().split()
    found = {}
    for pid in [supervisor, *map(int, pids)]:
        words = pathlib.Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
        name = words[2].decode() if words[1] == b"node" else "supervisor"
        status = pathlib.Path(f"/proc/{pid}/status").read_text()
        rss = int(status.split("VmRSS:")[1].split()[0])
        # Memory that processes share is counted with the segments.
        shared = int(status.split("RssShmem:")[1].split()[0])
        found[f"{name} RSS kB"] = rss - shared
        found[f"{name} files"] = len(os.listdir(f"/proc/{pid}/fd"))
    sizes = [file.stat().st_size // 1024 for file in pathlib.Path("/dev/shm").iterdir() if file.name.startswith(prefix)]
    return {**found, "segments kB": sum(sizes), "segments": len(sizes)}


def judge(samples):
    """What has grown from the second quarter to the last."""
    quarter = len(samples) // 4
    early, late = samples[quarter : 2 * quarter], samples[-quarter:]
    grown = []
    for key in samples[-1]:
        before, after = (max(sample[key] for sample in part) for part in (early, late))
        slack = before / 20 + 8192 if key.endswith("RSS kB") else 2 if key.endswith("files") else 0
        print(f"{key:20} {samples[0][key]:9} {before:9} {after:9}{'   <-- grows' if after > before + slack else ''}")
        grown += [key] if after > before + slack else []
    return grown


def main():
    frames, supervisor, run_dir = int(sys.argv[1]), int(sys.argv[2]), pathlib.Path(sys.argv[3])
    kinds = {name: type(message) for name, message in messages(0)[1].items()}
    listener, camera = Listener(), Speaker(kinds)
    camera.meet()
    prefix = json.loads((run_dir / ".run/ipc.json").read_text())["prefix"]
    until("the graph's answers", lambda: all(r.get_matched_publications() for r in listener.poses))
    print(f"frame {warm_up(listener, camera)} was the first that was answered")
    samples, answered, begin, every = [], 0, time.monotonic(), max(1, frames // 200)
    for index in range(frames):
        stamp_ns, sent = messages(index)
        for name, message in sent.items():
            camera.say(name, message)
        if index >= AHEAD:
            due_ns = messages(index - AHEAD)[0]
            # Newest wins: a frame may be passed over, its successor answers for it.
            until(f"poses after frame {index}", lambda: listener.has(due_ns) or newest(listener) >= due_ns)
        if index % every == 0:
            samples.append(held(supervisor, prefix))
            answered += forget(listener)
    last_ns = messages(frames - 1)[0]
    until("the last poses", lambda: newest(listener) >= last_ns)
    answered += forget(listener)
    seconds = time.monotonic() - begin
    print(f"{frames} frames in {seconds:.0f} s, {frames / seconds:.0f} a second, {answered} answered")
    print(f"{'':20} {'first':>9} {'early':>9} {'late':>9}")
    grown = judge(samples)
    assert not grown, f"grows: {grown}"
    assert answered > 0.5 * frames, "most frames were passed over"


def newest(listener):
    listener.listen()
    return min(max(came, default=0) for came in listener.came)


def forget(listener):
    """Empties what has come, but for the newest; gives how many that were."""
    came = listener.came[0]
    count = max(0, len(came) - 1)
    for part in listener.came:
        for stamp in sorted(part)[:-1]:
            del part[stamp]
    return count


if __name__ == "__main__":
    sys.exit(main())
