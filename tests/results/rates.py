"""Tables of tracking: frame by frame without middleware, and live at the camera's rate."""

import json
import re
import subprocess

from refinement import REFINER, head, row

# For frames a third of a second apart; chosen on tabletop's train split.
SPARSE = '{"budget_ms":150,"look_ms":30,"looks_at_once":5,"look_every_s":0.3,"look_again_s":0.1,"doubtful_looks":100}'


def tracking(run):
    """The tracker alone, from the rough poses of the first frame."""
    sparse = lambda hz: ["--looks", REFINER, "--hz", hz, "--delay", "1", "--look-score", "0.3", "--config", SPARSE]
    rows = {
        "dense": ("dense test sequence, 30 Hz, five objects", "dense/test/000001", "tabletop/models", ["--looks", REFINER]),
        "dense_alone": ("the same without any look of the network", "dense/test/000001", "tabletop/models", []),
        "tabletop_1": ("tabletop test/000001, 3 Hz", "tabletop/test/000001", "tabletop/models", sparse("3")),
        "tabletop_2": ("tabletop test/000002, 3 Hz", "tabletop/test/000002", "tabletop/models", sparse("3")),
        "cube": ("cube test/000001, every third frame of a video, 10 Hz", "cube/test/000001", "cube/models", sparse("10")),
    }
    text = "# Tracking, frame by frame\n\nThe tracker without search and middleware, from the rough poses of the first frame; ADD(-S).\n\n"
    text += head("", "instances", "0.1 d", "60 % visible, 0.1 d", "0.05 d", "CPU-ms a frame: tracker", "looks")
    for key, (name, scene, models, options) in rows.items():
        csv = run.out / f"track_{key}.csv"
        words = [run.data / scene, run.data / models, "--start", "rough", "--pnp", "{gate: null}", *options, "--csv", csv]
        run.once(csv, "track_sequence", *words)
        said = csv.with_suffix(".log").read_text()
        share = lambda what: re.search(rf"^ *{what}: 0.1d ([\d.]+) +0.05d ([\d.]+) +of (\d+)", said, re.MULTILINE)
        cost, looks = re.search(r"CPU ([\d.]+) ms a frame", said)[1], re.search(r"([\d.]+) a frame$", said, re.MULTILINE)
        every, seen = share("all"), share("60 % visible")
        text += row(name, every[3], every[1], seen[1], every[2], f"{float(cost):.0f}", f"{float(looks[1]):.0f}" if looks else "-")
    return text


def camera_rate(run):
    """Live graphs beside recordings that are played in real time."""
    text = "# At the camera's rate\n\nRecordings played at 30 Hz into live graphs; nothing waits, what is late is dropped.\n\n"
    text += head("", "poses/s of each object", "latency p50, p99", "on time", "0.1 d, all", "60 % visible, of what was answered", "0.05 d, all", "cores", "first right pose, s")
    demo = ["--source", "bags/tabletop_dense", "--objects", "config/objects/tabletop", "--truth", "bags/tabletop_dense_truth", "--passes", "3"]
    for go in (1, 2, 3):
        text += live(run, f"demo_{go}", f"dense sequence three times over, searched and followed (run {go})", "demo", demo)
    video = cube_video(run)
    reference = cube_reference(run, video)
    cube = ["--source", video, "--objects", run.data / "cube/models", "--reference", reference, "--sure", "0.8"]
    text += live(run, "cube_video", "photographs of the cube, 989 frames of a video, a detector's rough poses in 235 of them, against two passes at 256 px in each of these alone", "live", cube)
    return text


def live(run, key, name, graph, options):
    folder = run.out / key
    run.once(folder / "report.json", "pseudoflow", "bench", "--graph", f"config/graphs/{graph}.yaml", *options, "--report", folder)
    report = json.loads((folder / "report.json").read_text())
    rates = report["published_per_s"].values()
    first = [o["first_pose_s"]["right_s"] for o in report["objects"].values()]
    ten, five, latency = report["add_s_recall_0.1d"], report["add_s_recall_0.05d"], report["latency_ms"]
    return row(
        name,
        f"{min(rates):.1f} to {max(rates):.1f}",
        f"{latency['p50']:.0f} ms, {latency['p99']:.0f} ms",
        f"{report['on_time']:.3f}",
        f"{ten['all']:.3f} of {ten['n']}",
        f"{ten['answered_60_visible']:.3f}",
        f"{five['all']:.3f}",
        f"{report['cores_used']:.2f}",
        ", ".join("never" if s is None else f"{s:.1f}" for s in sorted(first, key=lambda s: (s is None, s))),
    )


def cube_video(run):
    """The whole video as a BOP scene: camera and rough poses are those of every third frame, of which `train` consists."""
    scene, train = run.out / "cube_video_scene/000001", run.data / "cube/train/000001"
    if not (scene / "init_poses.json").exists():
        (scene / "rgb").mkdir(parents=True, exist_ok=True)
        frames = ["ffmpeg", "-loglevel", "error", "-y", "-i", run.data / "cube/video.mp4", "-start_number", "0", scene / "rgb/%06d.png"]
        subprocess.run(frames, check=True)
        camera = next(iter(json.loads((train / "scene_camera.json").read_text()).values()))
        numbers = [str(int(file.stem)) for file in sorted((scene / "rgb").iterdir())]
        (scene / "scene_camera.json").write_text(json.dumps(dict.fromkeys(numbers, camera)))
        (scene / "init_poses.json").write_text((train / "init_poses.json").read_text())
    return scene


def cube_reference(run, video):
    """Each frame that has a rough pose, for itself: two passes at 256 px."""
    file = run.out / "reference_cube-test.csv"
    options = {"source": video, "objects": run.data / "cube/models", "csv": file}
    run.once(file, "pseudoflow", "run", "tests/results/reference.yaml", "--in-process", *(f"--set={k}={v}" for k, v in options.items()))
    return file
