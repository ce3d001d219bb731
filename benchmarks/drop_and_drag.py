"""CPU time and memory of the whole 131 s protocol at 41 x 41 vertices, over the demo's grid.

    python benchmarks/drop_and_drag.py [--processes 2] [--replicates 1]

One process a simulation and one core each; prints a row a simulation, then the median. CPU
seconds count the simulation alone, without starting Python and loading kernels.
"""

import argparse
import resource
import statistics
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context

MATERIALS = ("gray-interlock", "navy-sparkle-sweat", "royal-target")
FRICTIONS = (0.1, 0.3, 0.6, 1.0)
FRAMES = 315  # the last at 130.8 s


def measure(material: str, friction: float, seed: int) -> dict:
    """Simulate once; CPU seconds, peak memory in MiB, counts of the solver."""
    from slipstitch.simulate.drop_and_drag import simulate_drop_and_drag
    from slipstitch.simulate.settings import SimulationSettings

    warm = SimulationSettings(vertices_per_side=5, frames=2, settle_s=0.0)
    simulate_drop_and_drag(material, friction, seed, warm)
    began = time.process_time()
    trajectory, columns = simulate_drop_and_drag(
        material, friction, seed, SimulationSettings(frames=FRAMES)
    )
    return {
        "material": material,
        "friction": friction,
        "cpu_s": time.process_time() - began,
        "memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "residual": float(columns["residual"].max()),
        **trajectory.metadata["solver"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--replicates", type=int, default=1)
    arguments = parser.parse_args()
    cases = [(m, f, s) for m in MATERIALS for f in FRICTIONS for s in range(arguments.replicates)]
    print("material           friction  CPU s   MiB  steps iterations factorisations halvings")
    rows = []
    # A fresh process a simulation, so that memory is that simulation's own.
    with ProcessPoolExecutor(
        arguments.processes, mp_context=get_context("spawn"), max_tasks_per_child=1
    ) as pool:
        for done in as_completed([pool.submit(measure, *case) for case in cases]):
            row = done.result()
            rows.append(row)
            print(
                f"{row['material']:<18} {row['friction']:8.1f} {row['cpu_s']:6.1f}"
                f" {row['memory_mib']:5.0f} {row['steps']:6d} {row['newton_iterations']:10d}"
                f" {row['factorisations']:14d} {row['halvings']:8d}",
                flush=True,
            )
    print(
        f"median {statistics.median(row['cpu_s'] for row in rows):.1f} CPU s, largest "
        f"{max(row['cpu_s'] for row in rows):.1f}; memory at most "
        f"{max(row['memory_mib'] for row in rows):.0f} MiB; largest accepted residual "
        f"{max(row['residual'] for row in rows):.2e}"
    )


if __name__ == "__main__":
    main()
