"""Time of one training step of nano beside PyTorch's on this machine.

    train_step_vs_pytorch.py BENCH [--batch 4] [--steps 20]

BENCH is the example `step_bench` of pseudoflow-network. The PyTorch network is torchvision's raft_small with the same
size, iterations, loss and AdamW; both run three warm-up steps and take turns, so that other load hits both alike.
Prints both medians, the CPU time of both and the ratios; ends with 1 if the ratio of the medians is over 1.5.
Needs: pip install torch torchvision.
"""

import argparse
import re
import resource
import subprocess
import sys
import time

import torch
from torchvision.models.optical_flow import raft_small

SIZE, ITERATIONS, LIMIT, ROUNDS = 128, 6, 1.5, 3


def pytorch_steps(batch, steps):
    """Wall times and mean CPU time of training steps, ms."""
    torch.manual_seed(0)
    network = raft_small(weights=None).train()
    optimizer = torch.optim.AdamW(network.parameters(), lr=1e-5, weight_decay=1e-4)
    reference, real = (torch.rand(batch, 3, SIZE, SIZE) * 2 - 1 for _ in range(2))
    flow = torch.rand(batch, 2, SIZE, SIZE) * 2 - 1
    mask = torch.ones(batch, 1, SIZE, SIZE)
    times, cpu = [], 0.0
    for step in range(3 + steps):
        if step == 3:
            cpu = time.process_time()
        start = time.perf_counter()
        optimizer.zero_grad()
        flows = network(reference, real, num_flow_updates=ITERATIONS)
        weights = [0.8 ** (ITERATIONS - 1 - k) for k in range(ITERATIONS)]
        loss = sum(w * (mask * (f - flow).abs()).sum() / mask.sum() for w, f in zip(weights, flows))
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        times.append(1e3 * (time.perf_counter() - start))
    return times[3:], 1e3 * (time.process_time() - cpu) / steps


def our_steps(bench, config, batch, steps):
    """Median wall time and mean CPU time (warm-up included), ms."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    text = subprocess.run([bench, config, str(batch), str(steps)], check=True, capture_output=True, text=True).stdout
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = (after.ru_utime + after.ru_stime) - (before.ru_utime + before.ru_stime)
    return float(re.search(r"median ([\d.]+) ms", text)[1]), 1e3 * cpu / (steps + 3)


def median(values):
    return sorted(values)[len(values) // 2]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("bench")
    parser.add_argument("--config", default=f"{__file__.rsplit('/', 3)[0]}/config/networks/nano.yaml")
    parser.add_argument("--batch", type=int, default=4)
    parser.add_argument("--steps", type=int, default=20)
    args = parser.parse_args()
    ours, theirs, our_cpu, their_cpu = [], [], [], []
    for _ in range(ROUNDS):
        wall, cpu = our_steps(args.bench, args.config, args.batch, args.steps)
        ours.append(wall)
        our_cpu.append(cpu)
        walls, cpu = pytorch_steps(args.batch, args.steps)
        theirs.append(median(walls))
        their_cpu.append(cpu)
    ratio = median(ours) / median(theirs)
    print(f"ours {median(ours):.0f} ms (CPU {median(our_cpu):.0f}), PyTorch {torch.__version__} on "
          f"{torch.get_num_threads()} threads {median(theirs):.0f} ms (CPU {median(their_cpu):.0f}), "
          f"ratio {ratio:.2f}, of CPU time {median(our_cpu) / median(their_cpu):.2f}")
    sys.exit(ratio > LIMIT)


if __name__ == "__main__":
    main()
