"""Time of the exported flow network beside torchvision's raft_small, both in ONNX Runtime on the CPU.

    flow_vs_torchvision.py PSEUDOFLOW [--size 256] [--iterations 12] [--rounds 9] [--threads 2]

PSEUDOFLOW is the binary. Same size, iterations, threads and provider; the two take turns, so that other load hits both
alike. Ends with 1 if the ratio of the medians is over 0.8. Values do not matter for the time: torchvision keeps its random
weights.
Needs: pip install torch torchvision onnx onnxscript onnxruntime==1.31.1.
"""

import argparse
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import numpy as np
import onnxruntime
import torch
from torchvision.models.optical_flow import raft_small

ROOT = pathlib.Path(__file__).resolve().parents[2]
WEIGHTS = ROOT / "config/weights/raft_small.safetensors"
LIMIT = 0.8


class LastFlow(torch.nn.Module):
    """torchvision's network with its last flow alone, as a robot needs it."""

    def __init__(self, iterations):
        super().__init__()
        self.network, self.iterations = raft_small(weights=None).eval(), iterations

    def forward(self, reference, real):
        return self.network(reference, real, num_flow_updates=self.iterations)[-1]


def session(path, threads):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def exported(folder, args):
    """Both networks as ONNX files."""
    ours, theirs = folder / "ours.onnx", folder / "torchvision.onnx"
    shape = ["--size", str(args.size), "--iterations", str(args.iterations)]
    command = [args.pseudoflow, "export", "--network", "small", "--weights", WEIGHTS, *shape, "--out", ours]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    pictures = tuple(torch.rand(1, 3, args.size, args.size) * 2 - 1 for _ in range(2))
    names = {"input_names": ["reference", "real"], "output_names": ["flow"]}
    torch.onnx.export(LastFlow(args.iterations).eval(), pictures, str(theirs), dynamo=args.dynamo, **names)
    return ours, theirs


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pseudoflow")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--iterations", type=int, default=12)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--dynamo", action="store_true", help="export torchvision's network by its newer exporter")
    args = parser.parse_args()
    torch.manual_seed(0)
    with tempfile.TemporaryDirectory() as folder:
        ours, theirs = (session(path, args.threads) for path in exported(pathlib.Path(folder), args))
    rng = np.random.default_rng(0)
    pair = {name: rng.uniform(-1, 1, (1, 3, args.size, args.size)).astype("f4") for name in ("reference", "real")}
    times = {"ours": [], "torchvision": []}
    for turn in range(args.rounds + 2):
        for name, run in (("ours", ours), ("torchvision", theirs)):
            start = time.perf_counter()
            run.run(None, pair)
            if turn >= 2:
                times[name].append((time.perf_counter() - start) * 1e3)
    medians = {name: statistics.median(values) for name, values in times.items()}
    ratio = medians["ours"] / medians["torchvision"]
    print(f"{args.size} px, {args.iterations} iterations, {args.threads} threads, median of {args.rounds}: "
          f"ours {medians['ours']:.1f} ms, torchvision {medians['torchvision']:.1f} ms, ratio {ratio:.2f}")
    sys.exit(ratio > LIMIT)


if __name__ == "__main__":
    main()
