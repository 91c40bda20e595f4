#!/usr/bin/env python3
"""Kills and stops nodes at random times: replays and trainings must leave the same bytes, live graphs must be back.

    tests/random_faults.py --faults 12                        part of tests/run
    tests/random_faults.py --faults 100 --back-s 2 --seed 2   the long one: 300 in all

Needs the release binary (target/release/pseudoflow) and nothing else. Prints a line for each run and ends with 1 if any
result differs, a live node does not handle frames again within --back-s, or a run leaves something in /dev/shm or the temporary
folder. A live run ends every node once by SIGKILL and once by SIGSTOP, one after the other.
"""

import argparse
import hashlib
import json
import os
import pathlib
import random
import signal
import struct
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
# A camera that does not end: the run is stopped.
LIVE = [
    "mode=live", "flow.size_px=64", "renderer.size_px=64", "flow.iterations=2", "player.hz=15", "player.passes=100000",
    "recorder.max_bytes=16000000", "recorder.overlay=null",
]
# Layout of the run's board (nodes/shared/runtime/src/board.rs).
MAGIC, HEADER_WORDS, NODE_WORDS, PID, STATE, FRAMES = 0x7066626F61726405, 16, 704, 0, 1, 5
PATIENCE_S = 180


def settings(kind, out):
    own = {"replay": REPLAY, "training": TRAINING, "live": LIVE}[kind]
    places = {
        "training": [f"trainer.out={out}/training"],
        "live": [f"recorder.path={out}/recording", f"evaluator.out={out}"],
        "replay": [f"recorder.path={out}/recording", f"recorder.overlay.pictures={out}/overlays", f"evaluator.out={out}"],
    }[kind]
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


class Board:
    """What the run's processes know of each other."""

    def __init__(self, out):
        self.path = out / "run/.run/board"

    def words(self):
        data = self.path.read_bytes()
        words = struct.unpack(f"<{len(data) // 8}Q", data)
        assert words[0] == MAGIC, "the board has another layout: mend this script"
        return words

    def slot(self, pid):
        """The place of the node whose process this is, or None."""
        words = self.words()
        places = range(HEADER_WORDS, len(words), NODE_WORDS)
        return next((at for at in places if words[at + PID] == pid), None)

    def now(self, at):
        words = self.words()
        return words[at + PID], words[at + FRAMES]


def wait_for(what, step, patience_s=PATIENCE_S):
    deadline = time.monotonic() + patience_s
    while not (result := step()):
        if time.monotonic() > deadline:
            raise TimeoutError(f"{what}: not within {patience_s} s")
        time.sleep(0.01)
    return result


def moving(run, board):
    """All nodes by name with place and process, when each has handled a frame."""
    nodes = children(run)
    places = {name: (board.slot(pid), pid) for name, pid in nodes.items()}
    there = len(places) == 7 and all(at is not None for at, _ in places.values())
    return places if there and all(board.now(at)[1] > 0 for at, _ in places.values()) else None


def seconds_away(board, at, pid, how):
    """Ends a process and waits until its successor has handled a frame."""
    begin, frames = time.monotonic(), board.now(at)[1]
    os.kill(pid, how)

    def is_back():
        now = board.now(at)
        return now[0] != pid and now[1] > frames

    wait_for("a node that was ended", is_back)
    return time.monotonic() - begin


def live_round(number, faults, chance, folder, back_s):
    """Ends each node by both signals in turn; how long each was away is what counts."""
    out = folder / f"live_{number}"
    run = start("live", out)
    taken, board, away, problems = territory(run, out), Board(out), {}, []
    try:
        for how in [signal.SIGKILL, signal.SIGSTOP]:
            names = sorted(wait_for("a live graph in which all nodes handle frames", lambda: moving(run, board)))
            for name in chance.sample(names, len(names))[: faults - len(away)]:
                at, pid = wait_for("all nodes", lambda: moving(run, board))[name]
                away[name, how.name] = seconds_away(board, at, pid, how)
                time.sleep(chance.uniform(0.05, 0.6))
    except (TimeoutError, OSError) as problem:
        problems.append(str(problem))
    run.send_signal(signal.SIGINT)
    code = run.wait()
    problems += [] if code == 0 else [f"exit code {code}: {out}/log.txt"]
    problems += [f"{name} ({how}) away for {s:.2f} s" for (name, how), s in away.items() if s > back_s]
    problems += [f"left behind: {name}" for name in left_behind(taken)]
    longest = max(away, key=away.get) if away else ("nobody", "")
    told = f"back after {sorted(away.values())[len(away) // 2]:.2f} s at the median, {longest[0]} ({longest[1]}) after "
    told += f"{away[longest]:.2f} s" if away else ""
    print(f"live {number}: {len(away)} faults, {'; '.join(problems) or told}", flush=True)
    return len(away), bool(problems)


def round_of(kind, number, faults, chance, folder, calm):
    out = folder / f"{kind}_{number}"
    run = start(kind, out)
    taken = territory(run, out)
    made = disturb(run, chance, faults)
    code = run.wait()
    problems = [] if code == 0 else [f"exit code {code}: {out}/log.txt"]
    if code == 0 and digest(kind, out) != calm:
        problems.append("other results")
    problems += [f"left behind: {name}" for name in left_behind(taken)]
    print(f"{kind} {number}: {made} faults, {'; '.join(problems) or 'as undisturbed'}", flush=True)
    return made, bool(problems)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--faults", type=int, default=12, help="of each kind of graph")
    parser.add_argument("--each", type=int, default=6, help="most of one run")
    parser.add_argument("--kinds", default="replay,training,live")
    parser.add_argument("--back-s", type=float, default=PATIENCE_S, help="longest that a live node may be away")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    chance, failed, total = random.Random(given.seed), False, 0
    with tempfile.TemporaryDirectory(prefix="faults_") as name:
        folder = pathlib.Path(name)
        for kind in given.kinds.split(","):
            calm, made, number = None, 0, 0
            if kind != "live":
                calm_out = folder / f"{kind}_calm"
                if start(kind, calm_out).wait() != 0:
                    sys.exit((calm_out / "log.txt").read_text())
                calm = digest(kind, calm_out)
            while made < given.faults and not failed:
                left = given.faults - made
                if kind == "live":
                    more, failed = live_round(number, left, chance, folder, given.back_s)
                else:
                    more, failed = round_of(kind, number, min(given.each, left), chance, folder, calm)
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
