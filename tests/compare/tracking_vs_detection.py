"""Tracking beside detecting every frame, on a BOP scene: frames per second (start and end of the processes counted), drift, and
what happens when the camera goes black.

    python3 tests/compare/tracking_vs_detection.py --scene data/tabletop/test/000001 --objects data/tabletop/models \\
        --initializer my_initializer.safetensors --flow config/weights/nano_tabletop.safetensors [--compare] [--size 256]

Runs config/graphs/track.yaml three times: searching every frame, tracking, and tracking with black frames in the middle. Needs
PyYAML and Pillow. The truth is read by the evaluator node and by this script alone.
"""

import argparse
import json
import shutil
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import yaml
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]


def scene_with_black(scene, out, black):
    """A copy of the scene with `black` black frames in the middle, their numbers behind those of the others."""
    shutil.copytree(scene, out)
    folder = out / "rgb"
    files = {int(file.stem): file for file in folder.iterdir()}
    numbers = sorted(files)
    half = len(numbers) // 2
    cameras = json.loads((scene / "scene_camera.json").read_text())
    truth = json.loads((scene / "scene_gt.json").read_text())
    info = json.loads((scene / "scene_gt_info.json").read_text())
    with Image.open(files[numbers[0]]) as first:
        size = first.size
    moved = {n: n + black if i >= half else n for i, n in enumerate(numbers)}
    for number in reversed(numbers):
        file = files[number]
        file.rename(file.with_stem(f"{moved[number]:06d}"))
    pick = lambda table: {str(moved[int(key)]): value for key, value in table.items()}
    cameras, truth, info = pick(cameras), pick(truth), pick(info)
    suffix = files[numbers[0]].suffix
    for i in range(black):
        number = numbers[half] + i
        Image.new("RGB", size).save(folder / f"{number:06d}{suffix}")
        cameras[str(number)] = cameras[str(numbers[0])]
    for name, table in (("scene_camera", cameras), ("scene_gt", truth), ("scene_gt_info", info)):
        (out / f"{name}.json").write_text(json.dumps(table))
    return half


def graph(args, scene, track, out):
    graph = yaml.safe_load((ROOT / "config/graphs/track.yaml").read_text())
    nodes = graph["nodes"]
    del graph["params"]  # all settings are given below
    objects = str(args.objects)
    nodes["player"]["config"] = {"source": str(scene), "objects": objects}
    config = {"model": str(args.initializer), "objects": objects}
    if args.compare:
        config["compare"] = {"model": str(args.flow)}
    if track:
        config["track"] = {}
    nodes["initializer"]["config"] = config
    nodes["renderer"]["config"] = {"objects": objects, "size_px": args.size}
    nodes["flow"]["config"] = {"model": str(args.flow), "size_px": args.size}
    del nodes["recorder"]
    nodes["evaluator"] = {
        "kind": "evaluator",
        "inputs": {"frame": "player/frame", "initial_poses": "initializer/initial_poses", "poses": "pnp/poses"},
        "config": {"truth": str(scene), "objects": objects, "out": str(out)},
    }
    return graph


def run(args, scene, track, out):
    out.mkdir(parents=True)
    file = out / "graph.yaml"
    file.write_text(yaml.safe_dump(graph(args, scene, track, out)))
    begin = time.perf_counter()
    done = subprocess.run(
        [args.binary, "run", file, "--out", out / "run"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    seconds = time.perf_counter() - begin
    if done.returncode != 0:
        raise SystemExit(done.stderr[-3000:])
    frames = [json.loads(line) for line in (out / "poses.jsonl").read_text().splitlines() if line]
    return len(frames) / seconds, {frame["index"]: frame for frame in frames}, json.loads((out / "report.json").read_text())


def summary(name, rate, report):
    for poses in ("init", "refined"):
        scores = report["overall"][poses]
        found = scores.get("detection_recall")
        print(
            f"{name:24} {poses:8} {rate:7.3f} frames/s  ADD(-S)-0.1d {scores['add_s_recall_0.1d']:.3f}"
            f"  found {found if found is None else round(found, 3)}"
        )


def drift(name, report):
    """Median ADD(-S) (diameters) of what was found in the last tenth over that in the first. Searching has no memory: its ratio
    says how much harder the scene becomes."""
    instances = [i for i in report["instances"]["refined"] if i["add_s_of_diameter"] is not None]
    numbers = sorted({i["image_id"] for i in report["instances"]["refined"]})
    tenth = max(len(numbers) // 10, 1)

    def median(images):
        errors = [i["add_s_of_diameter"] for i in instances if i["image_id"] in images]
        return statistics.median_high(errors) if errors else float("nan")

    first, last = median(set(numbers[:tenth])), median(set(numbers[-tenth:]))
    ratio = last / first if first else float("nan")
    print(f"{name:24} median ADD(-S) of the first tenth {first:.4f} diameters, of the last {last:.4f}, ratio {ratio:.2f}")


def recovery(frames, half, black):
    """Frames after the black ones until a pose of each object is published again, and how many were while all was black."""
    published = lambda frame: [pose["object_id"] for pose in frame["refined"] if pose["status"] == 0]
    ordered = [frames[index] for index in sorted(frames)]
    dark, after = ordered[half : half + black], ordered[half + black :]
    known = {number for frame in ordered[:half] for number in published(frame)}
    back = {}
    for count, frame in enumerate(after, 1):
        for number in published(frame):
            back.setdefault(number, count)
    tail = sum(len(published(frame)) for frame in dark)
    print(f"{tail} poses published in {len(dark)} black frames; published again after frames: {back}; of {sorted(known)}")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--scene", type=Path, required=True)
    parser.add_argument("--objects", type=Path, required=True)
    parser.add_argument("--initializer", type=Path, required=True)
    parser.add_argument("--flow", type=Path, required=True)
    parser.add_argument("--compare", action="store_true", help="first poses by render and compare")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--black", type=int, default=30)
    parser.add_argument("--binary", type=Path, default=ROOT / "target/release/pseudoflow")
    args = parser.parse_args()
    for name in ("scene", "objects", "initializer", "flow", "binary"):
        setattr(args, name, getattr(args, name).resolve())
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        rates = {}
        for name, track in (("searching every frame", False), ("tracking", True)):
            rates[track], _, report = run(args, args.scene, track, folder / f"out{track}")
            summary(name, rates[track], report)
            drift(name, report)
        print(f"tracking runs at {rates[True] / rates[False]:.2f} times the frame rate")
        dark = folder / "000001"
        half = scene_with_black(args.scene, dark, args.black)
        rate, frames, report = run(args, dark, True, folder / "black")
        summary("tracking, black between", rate, report)
        recovery(frames, half, args.black)


if __name__ == "__main__":
    main()
