"""Simulations in one batch: cost per simulation on each device, and differences of the results.

    python benchmarks/batch.py [--batch 8] [--frames 4]

Simulates the beginning of drop-and-drag for ``batch`` pairs of fabric and friction at 41 x 41
vertices: one by one on the CPU, in one batch there, and in one batch on CUDA where that is present.
On the CPU the batch must have the same bits. On CUDA vertices must be within a micrometre as long
as the cloth hangs free; how far apart they come once it touches the floor is printed, too. Exit
code 1 if either fails. CPU seconds are the process's; kernels are loaded before the clock starts.
"""

from __future__ import annotations

import argparse
import itertools
import resource
import sys
import time

import numpy as np
import warp as wp

from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics.simulation.drop_and_drag import DropAndDrag, simulate_batch

MATERIALS = ("gray-interlock", "navy-sparkle-sweat", "royal-target", "11oz-black-denim")
FRICTIONS = (0.1, 0.3, 0.6, 1.0)
TOLERANCE_M = 1e-6  # while nothing touches the floor
TOUCH_M = 1e-3


def measured(runs, settings, device: str, together: bool):
    """Simulate; positions (B, T, V, 3), CPU and wall seconds a simulation."""
    groups = [runs] if together else [[one] for one in runs]
    warm = settings.model_copy(update={"vertices_per_side": 5, "frames": 2, "settle_s": 0.0})
    simulate_batch(runs[:1], warm, device=device)
    cpu, wall = time.process_time(), time.perf_counter()
    outcomes = [one for group in groups for one in simulate_batch(group, settings, device=device)]
    spent = (time.process_time() - cpu, time.perf_counter() - wall)
    for outcome in outcomes:
        if isinstance(outcome, Exception):
            raise outcome
    positions = np.array([trajectory.positions_m for trajectory, _ in outcomes])
    return positions, *(one / len(runs) for one in spent)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--frames", type=int, default=4, help="at 2.4 Hz, after 2 s of rest")
    parser.add_argument("--vertices", type=int, default=41)
    arguments = parser.parse_args()
    pairs = itertools.cycle(itertools.product(FRICTIONS, MATERIALS))
    runs = [
        DropAndDrag(m, f, k) for k, (f, m) in enumerate(itertools.islice(pairs, arguments.batch))
    ]
    settings = SimulationSettings(vertices_per_side=arguments.vertices, frames=arguments.frames)
    cases = [("cpu", False), ("cpu", True)]
    if wp.is_cuda_available():
        cases.append(("cuda", True))
    reference = None
    failed = False
    print("device  simulations at once  CPU s each  wall s each  largest difference to the CPU")
    for device, together in cases:
        positions, cpu_s, wall_s = measured(runs, settings, device, together)
        if reference is None:
            reference = positions
            free = positions[..., 2].min(axis=2) > TOUCH_M  # (B, T)
        apart = np.abs(positions - reference).max(axis=(2, 3))
        hanging = apart[free].max() if free.any() else 0.0
        failed |= bool(hanging > (TOLERANCE_M if device == "cuda" else 0.0))
        failed |= bool(device == "cpu" and apart.max() > 0)
        count = len(runs) if together else 1
        print(
            f"{device:<6}  {count:19d}  {cpu_s:10.2f}  {wall_s:11.2f}  "
            f"{hanging:.1e} m hanging, {apart.max():.1e} m in all",
            flush=True,
        )
    if len(cases) == 2:
        print("no CUDA device here: its cost and its difference to the CPU are not measured")
    print(f"memory at most {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
