#!/usr/bin/env python3
"""Pose errors of pseudoflow-metrics against the same definitions in numpy and scipy: values and speed.

bop_toolkit is not on PyPI, so `reference` below states the published definitions with the same means that the
toolkit uses (one pair at a time, matrix products on all vertices, scipy's cKDTree for ADI). Needs numpy and scipy.

    python tests/compare/metrics_vs_numpy.py [--pairs 10000] [--reference-pairs 200] [--symmetries 1]
"""
import argparse
import json
import pathlib
import subprocess
import tempfile
import time

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

ROOT = pathlib.Path(__file__).resolve().parents[2]
K = np.array([[590.0, 0.0, 320.0], [0.0, 580.0, 240.0], [0.0, 0.0, 1.0]])


def lumpy_sphere(count):
    """Vertices of a closed surface about 15 cm wide, spread evenly (golden spiral)."""
    i = np.arange(count)
    z = 1 - (2 * i + 1) / count
    angle = i * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    direction = np.stack([r * np.cos(angle), r * np.sin(angle), z], 1)
    lumps = 1 + 0.3 * np.sin(5 * direction[:, 0]) * np.cos(4 * direction[:, 1]) + 0.1 * np.sin(9 * direction[:, 2])
    return direction * lumps[:, None] * 0.06


def random_pairs(rng, count):
    """True poses and estimates whose errors span what initial and refined poses show."""
    truth_r = Rotation.random(count, random_state=rng)
    size = 10 ** rng.uniform(-2.0, 0.0, (count, 1))
    est_r = Rotation.from_rotvec(0.5 * size * rng.normal(size=(count, 3))) * truth_r
    truth_t = rng.normal(size=(count, 3)) * 0.1 + [0.0, 0.0, 0.9]
    est_t = truth_t + 0.03 * size * rng.normal(size=(count, 3))
    return est_r.as_matrix(), est_t, truth_r.as_matrix(), truth_t


def project(points, r, t):
    p = (points @ r.T + t) @ K.T
    return p[:, :2] / p[:, 2:]


def add(points, re, te, rg, tg, _):
    return np.linalg.norm((points @ re.T + te) - (points @ rg.T + tg), axis=1).mean()


def adi(points, re, te, rg, tg, _):
    distances, _ = cKDTree(points @ re.T + te).query(points @ rg.T + tg, k=1)
    return distances.mean()


def mssd(points, re, te, rg, tg, symmetries):
    est = points @ re.T + te
    return min(np.linalg.norm(est - (points @ (rg @ rs).T + (rg @ ts + tg)), axis=1).max() for rs, ts in symmetries)


def mspd(points, re, te, rg, tg, symmetries):
    est = project(points, re, te)
    return min(np.linalg.norm(est - project(points, rg @ rs, rg @ ts + tg), axis=1).max() for rs, ts in symmetries)


def reference(points, pairs, symmetries):
    errors, seconds = {}, {}
    for function in (add, adi, mssd, mspd):
        start = time.perf_counter()
        errors[function.__name__] = np.array([function(points, *pair, symmetries) for pair in zip(*pairs)])
        seconds[function.__name__] = time.perf_counter() - start
    return errors, seconds


def ours(points, pairs, symmetries):
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        count = len(pairs[0])
        points.astype("<f8").tofile(folder / "points.bin")
        np.concatenate([a.reshape(count, -1) for a in pairs], 1).astype("<f8").tofile(folder / "pairs.bin")
        np.array([np.concatenate([r.ravel(), t]) for r, t in symmetries]).astype("<f8").tofile(folder / "symmetries.bin")
        K[[0, 1, 0, 1], [0, 1, 2, 2]].astype("<f8").tofile(folder / "k.bin")
        command = ["cargo", "run", "-q", "--release", "-p", "pseudoflow-metrics", "--example", "pose_pairs", "--", folder]
        printed = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout
        errors = np.fromfile(folder / "errors.bin", "<f8").reshape(count, 4)
    return dict(zip(("add", "adi", "mssd", "mspd"), errors.T)), json.loads(printed)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vertices", type=int, default=16384)
    parser.add_argument("--pairs", type=int, default=10000)
    parser.add_argument("--reference-pairs", type=int, default=200, help="the reference runs on the first so many")
    parser.add_argument("--symmetries", type=int, default=1, help="turns around z, as of a continuous symmetry")
    args = parser.parse_args()
    points = lumpy_sphere(args.vertices)
    pairs = random_pairs(np.random.default_rng(1), args.pairs)
    angles = np.arange(args.symmetries) * 2 * np.pi / args.symmetries
    symmetries = [(Rotation.from_euler("z", a).as_matrix(), np.zeros(3)) for a in angles]
    got, got_s = ours(points, pairs, symmetries)
    n = min(args.reference_pairs, args.pairs)
    want, want_s = reference(points, [a[:n] for a in pairs], symmetries)
    print(f"{args.vertices} vertices, {args.pairs} pairs, {len(symmetries)} symmetries; numpy timed on {n} pairs")
    failed = False
    for name in want:
        relative = np.max(np.abs(got[name][:n] - want[name]) / np.maximum(want[name], 1e-12))
        per_pair, per_pair_numpy = got_s[name] / args.pairs, want_s[name] / n
        failed |= not relative <= 1e-4
        print(f"{name:5} ours {per_pair * 1e6:9.1f} us/pair, numpy {per_pair_numpy * 1e6:10.1f} us/pair, "
              f"{per_pair_numpy / per_pair:7.1f} x, largest relative difference {relative:.1e}")
    if failed:
        raise SystemExit("errors differ by more than 1e-4 relative")


if __name__ == "__main__":
    main()
