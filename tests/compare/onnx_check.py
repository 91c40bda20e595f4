"""The exported network: passes onnx.checker and equals burn in ONNX Runtime.

    onnx_check.py EXPORTER [--size 128] [--iterations 6] [--batch 1] [--config small] [--weights FILE] [--time]

EXPORTER is the example `export_onnx` of pseudoflow-network. Ends with 1 if the graph is invalid or a flow differs by
more than 1e-4 px + 1e-4 of its length. Needs: pip install onnx onnxruntime==1.31.1 numpy.
"""

import argparse
import pathlib
import subprocess
import sys
import tempfile
import time

import numpy as np
import onnx
import onnxruntime

ROOT = pathlib.Path(__file__).resolve().parents[2]
TOLERANCE = 1e-4


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("exporter")
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--iterations", type=int, default=6)
    parser.add_argument("--batch", type=int, default=1, help="0 leaves the batch open")
    parser.add_argument("--config", default="small")
    parser.add_argument("--weights", default=str(ROOT / "config/weights/raft_small.safetensors"))
    parser.add_argument("--time", action="store_true", help="also print the median run time")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder)
        config = ROOT / f"config/networks/{args.config}.yaml"
        numbers = [str(v) for v in (args.size, args.iterations, args.batch)]
        subprocess.run([args.exporter, config, args.weights, *numbers, folder], check=True)
        sys.exit(compare(out, args))


def compare(out, args):
    model = onnx.load(str(out / "flow.onnx"))
    onnx.checker.check_model(model, full_check=True)
    n = args.batch or 2

    def read(name, channels):
        return np.fromfile(out / f"{name}.bin", "<f4").reshape(n, channels, args.size, args.size)

    inputs = {"reference": read("reference", 3), "real": read("real", 3)}
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 2
    session = onnxruntime.InferenceSession(str(out / "flow.onnx"), options, providers=["CPUExecutionProvider"])
    flow = session.run(["flow"], inputs)[0]
    burn = read("flow", 2)
    worst = float(np.abs(flow - burn).max())
    bound = float(np.max(np.abs(flow - burn) - TOLERANCE * np.abs(burn)))
    print(
        f"opset {model.opset_import[0].version}, {len(model.graph.node)} nodes, flow up to {np.abs(burn).max():.2f} px, "
        f"largest difference {worst:.2e} px"
    )
    if args.time:
        wall, cpu = [], []
        for _ in range(20):
            start, start_cpu = time.perf_counter(), time.process_time()
            session.run(["flow"], inputs)
            wall.append(1e3 * (time.perf_counter() - start))
            cpu.append(1e3 * (time.process_time() - start_cpu))
        print(f"wall median {sorted(wall)[10]:.1f} best {min(wall):.1f} ms, cpu median {sorted(cpu)[10]:.1f} ms")
    return 0 if bound <= TOLERANCE else 1


if __name__ == "__main__":
    main()
