#!/usr/bin/env python3
"""Kills and stops nodes at random times: replays and trainings must leave the same bytes, live graphs must be back.

    tests/random_faults.py --faults 12            part of tests/run
    tests/random_faults.py --faults 300 --seed 2  the long one

Needs the release binary (target/release/pseudoflow) and nothing else. Prints a line for each run and ends with 1 if any
result differs, a live node does not come back, or a run leaves something in /dev/shm or the temporary folder.
"""

import argparse
import hashlib
import json
import os
import pathlib
import random
import signal
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
BINARY = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "release/pseudoflow"
# Restarts are what is tested; a busy machine must not meet a deadline.
COMMON = ["restarts=10000"]
REPLAY = ["window=4", "flow.size_px=64", "renderer.size_px=64", "flow.iterations=4"]
TRAINING = [
    "trainer.steps=12", "trainer.frames_per_step=2", "trainer.publish_every=1", "trainer.size_px=64",
    "player.sampling.samples=24", "player.sampling.partners=1", "look.size_px=64", "look_flow.size_px=64",
    "look_flow.iterations=4", "look_flow.lockstep={frames_per_step: 2, publish_every: 1}", "renderer.size_px=64",
    "flow.size_px=64", "flow.iterations=4", "flow.lockstep={frames_per_step: 2, publish_every: 1}",
    "consistency.tau_px_at_256=16", "window=6",
]
LIVE = ["mode=live", "flow.size_px=64", "renderer.size_px=64", "flow.iterations=2"]


def settings(kind, out):
    own = {"replay": REPLAY, "training": TRAINING, "live": LIVE}[kind]
    places = {
        "training": [f"trainer.out={out}/training"],
    }.get(kind, [f"recorder.path={out}/recording", f"recorder.overlay.pictures={out}/overlays", f"evaluator.out={out}"])
    return [word for text in COMMON + own + places for word in ("--set", text)]


def start(kind, out):
    graph = "adapt.yaml" if kind == "training" else "refine.yaml"
    out.mkdir(parents=True)
    words = [BINARY, "run", ROOT / "config/graphs" / graph, "--out", out / "run", *settings(kind, out)]
    log = open(out / "log.txt", "w")
    environment = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}
    return subprocess.Popen(words, cwd=ROOT, stdout=log, stderr=log, env=environment)


def children(run):
    """Node processes of a run by name."""
    found = {}
    try:
        pids = pathlib.Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()
    except OSError:
        return found
    # Nodes are started from the supervisor's main thread.
    for pid in pids:
        try:
            words = pathlib.Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if len(words) > 2 and words[1] == b"node":
            found[words[2].decode()] = int(pid)
    return found


def digest(kind, out):
    """What the run is for: the weights, or the poses of every frame."""
    names = ["training/teacher.safetensors"] if kind == "training" else ["poses.jsonl"]
    return [hashlib.sha256((out / name).read_bytes()).hexdigest() for name in names if (out / name).exists()]


def territory(run, out):
    """What a run occupies outside its folder, as soon as it says so."""
    while run.poll() is None:
        try:
            return json.loads((out / "run/.run/ipc.json").read_text())
        except (OSError, json.JSONDecodeError):
            time.sleep(0.01)
    return None


def left_behind(taken):
    """Segments and folders of a run that has ended."""
    if taken is None:
        return []
    memory = [name for name in os.listdir("/dev/shm") if name.startswith(taken["prefix"])]
    return memory + [path for path in [taken["root"]] if os.path.exists(path)]


def disturb(run, chance, faults):
    """Faults until the run ends or so many were made; gives how many."""
    made = 0
    while run.poll() is None and made < faults:
        time.sleep(chance.uniform(0.05, 0.6))
        nodes = children(run)
        if not nodes:
            continue
        name = chance.choice(sorted(nodes))
        how = chance.choice([signal.SIGKILL, signal.SIGKILL, signal.SIGSTOP])
        try:
            os.kill(nodes[name], how)
            made += 1
        except ProcessLookupError:
            pass
    return made


def round_of(kind, number, faults, chance, folder, calm):
    out = folder / f"{kind}_{number}"
    run = start(kind, out)
    taken = territory(run, out)
    made = disturb(run, chance, faults)
    code = run.wait()
    problems = [] if code == 0 else [f"exit code {code}: {out}/log.txt"]
    if kind != "live" and code == 0 and digest(kind, out) != calm:
        problems.append("other results")
    problems += [f"left behind: {name}" for name in left_behind(taken)]
    well = "ended in order" if kind == "live" else "as undisturbed"
    print(f"{kind} {number}: {made} faults, {'; '.join(problems) or well}", flush=True)
    return made, bool(problems)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--faults", type=int, default=12, help="of each kind of graph")
    parser.add_argument("--each", type=int, default=6, help="most of one run")
    parser.add_argument("--kinds", default="replay,training,live")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    chance, failed, total = random.Random(given.seed), False, 0
    with tempfile.TemporaryDirectory(prefix="faults_") as name:
        folder = pathlib.Path(name)
        for kind in given.kinds.split(","):
            calm_out = folder / f"{kind}_calm"
            if start(kind, calm_out).wait() != 0:
                sys.exit((calm_out / "log.txt").read_text())
            calm, made, number = digest(kind, calm_out), 0, 0
            while made < given.faults and not failed:
                more, failed = round_of(kind, number, min(given.each, given.faults - made), chance, folder, calm)
                made, number = made + more, number + 1
            total += made
            if failed:
                log = (folder / f"{kind}_{number - 1}" / "log.txt").read_text()
                print("\n".join(log.splitlines()[-40:]))
                break
    print(f"{total} faults with seed {given.seed}: {'FAILED' if failed else 'nothing lost'}")
    sys.exit(failed)


if __name__ == "__main__":
    main()
