"""Cost of the simulator, compared with SolverVBD of Newton physics.

    python benchmarks/solver_cost.py [--only mesh side-by-side]

Writes results/published/benchmark/benchmark.json with its provenance. Parts that are not run keep
what the file already holds. CPU seconds of the parts
count the simulation alone, without starting Python and loading kernels; one process at a time.
"""

import argparse
import importlib.metadata
import importlib.util
import json
import math
import os
import resource
import sys
import time
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np

ROOT = Path(__file__).parents[1]
OUT = ROOT / "results" / "published" / "benchmark" / "benchmark.json"
GRID = ROOT / "results" / "published" / "benchmark" / "simulations.csv"
PARTS = ("mesh", "side-by-side", "steady")
DEAREST = ("white-dots-on-blk", 1.4)  # simulation of the published grid
STEADY_FRICTIONS = (0.1, 0.3, 0.5, 0.7, 0.9, 1.1, 1.3, 1.5, 0.2, 0.6)  # of the ten fabrics
SIDES = (21, 41, 61, 81, 121, 161)
MESH_WINDOW_S = 0.4
STEP_S, SHORT_S, SETTLE_S = 1 / 12, 0.5, 1.0
CREEP_STEP_S = 0.02
SHEET = {"density_kg_m2": 0.2, "membrane_N_m": 200.0, "poisson_ratio": 0.3, "hinge_N_m": 5e-5}
# Steps and iterations of SolverVBD: 20 ms at two efforts, and those of its own cloth examples.
DESCENTS = ((0.02, 10), (0.02, 100), (1 / 600, 10))
CREEP_DESCENTS = ((10, 1e-2), (100, 1e-2), (100, 1e-4))
SLOPE_OF_FRICTION = 0.98


def simulate(material, friction, window_s, **settings):
    """One run in a process of its own; its cost and the solver's counts per step."""
    with get_context("spawn").Pool(1) as pool:
        return pool.apply(_simulate, (material, friction, window_s, settings))


def _simulate(material, friction, window_s, changes):
    from slipstitch.config.simulation import SimulationSettings
    from slipstitch.physics.simulation.drop_and_drag import DropAndDrag, simulate_drop_and_drag

    warm = SimulationSettings(vertices_per_side=5, frames=2, settle_s=0.0)
    simulate_drop_and_drag(DropAndDrag(material, friction, 0), warm)
    settings = SimulationSettings(**changes)
    frames = min(settings.frames, math.floor(window_s * settings.frame_rate_hz) + 1)
    settings = settings.model_copy(update={"frames": frames})
    simulated_s = settings.settle_s + (frames - 1) / settings.frame_rate_hz
    began = time.process_time()
    run, columns = simulate_drop_and_drag(DropAndDrag(material, friction, 0), settings)
    cpu_s = time.process_time() - began
    solver = run.metadata["solver"]
    return {
        "material": material,
        "friction": friction,
        "vertices_per_side": settings.vertices_per_side,
        "simulated_s": simulated_s,
        "cpu_s": cpu_s,
        "cpu_s_per_s": cpu_s / simulated_s,
        "steps": solver["steps"],
        "iterations_per_step": solver["newton_iterations"] / solver["steps"],
        "factorisations_per_step": solver["factorisations"] / solver["steps"],
        "halvings": solver["halvings"],
        "largest_residual": float(columns["residual"].max()),
        "memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def mesh_part():
    """Cost against mesh size where the cloth touches down, and the exponent of the vertices."""
    rows = []
    for sides in SIDES:
        rows.append(
            simulate(
                "royal-target", 0.5, MESH_WINDOW_S, stage={"start_height_m": 0.2},
                vertices_per_side=sides, frame_rate_hz=10, settle_s=0.0,
            )
        )  # fmt: skip
        print(_line(rows[-1]), file=sys.stderr, flush=True)
    vertices = [row["vertices_per_side"] ** 2 for row in rows]
    slope, intercept = np.polyfit(np.log(vertices), np.log([row["cpu_s_per_s"] for row in rows]), 1)
    yield {"rows": rows, "exponent": float(slope), "cpu_s_per_s_at_1": float(np.exp(intercept))}


def steady_part():
    """The dearest simulation and ten others, without long steps and with them."""
    from slipstitch.config.simulation import ConvergenceSettings

    rows = []
    pairs = zip(ConvergenceSettings().materials, STEADY_FRICTIONS, strict=True)
    for material, friction in [DEAREST, *pairs]:
        with get_context("spawn").Pool(1) as pool:
            rows.append(pool.apply(_steady, (material, friction)))
        before, after = rows[-1]["before"], rows[-1]["after"]
        print(
            f"{material:<20} friction {friction:<4g} {before['cpu_s']:6.1f} -> "
            f"{after['cpu_s']:6.1f} CPU s, {before['steps']} -> {after['steps']} steps, apart "
            f"{1e3 * rows[-1]['mean_m']:.3f} mm",
            file=sys.stderr,
            flush=True,
        )
        yield {"rows": rows}


def _steady(material, friction):
    from slipstitch.config import load_config
    from slipstitch.physics.convergence.study import compare
    from slipstitch.physics.simulation.drop_and_drag import DropAndDrag, simulate_drop_and_drag

    grid = load_config(ROOT / "config.yaml", ROOT / "config" / "paper.yaml").simulation
    warm = grid.model_copy(update={"vertices_per_side": 5, "frames": 2, "settle_s": 0.0})
    simulate_drop_and_drag(DropAndDrag(material, friction, 0), warm)
    found = {"material": material, "friction": friction, "simulated_s": grid.recorded_s}
    runs = []
    for name, longest_s in (("before", grid.time_step_s), ("after", grid.steady_step_s)):
        settings = grid.model_copy(update={"steady_step_s": longest_s})
        began = time.process_time()
        run, columns = simulate_drop_and_drag(DropAndDrag(material, friction, 0), settings)
        solver = run.metadata["solver"]
        found[name] = {
            "cpu_s": time.process_time() - began,
            "largest_residual": float(columns["residual"].max()),
            **{key: solver[key] for key in ("steps", "newton_iterations", "factorisations")},
        }
        runs.append(run)
    apart = compare(runs[1], runs[0], (grid.vertices_per_side,))
    kept = ("mean_m", "mean_largest_m", "shifted_largest_m", "steady_largest_m")
    return found | {name: apart[name] for name in kept}


def _line(row):
    return (
        f"{row['material']:<16} friction {row['friction']:<4g} "
        f"{row['vertices_per_side']:>4} a side: {row['cpu_s_per_s']:7.2f} CPU s per second; "
        f"a step {row['iterations_per_step']:.1f} "
        f"iterations, {row['factorisations_per_step']:.2f} factorisations; "
        f"{row['memory_mib']:.0f} MiB"
    )


def side_by_side_part():
    """The same sheet on the same mesh, hung, lowered and laid on the floor, by both solvers."""
    if importlib.util.find_spec("newton") is None:
        print("newton is not installed (pip install 'slipstitch[benchmark]')", file=sys.stderr)
        return
    with get_context("spawn").Pool(1) as pool:
        yield pool.apply(_side_by_side)


def _scene():
    from slipstitch.physics.cloth import rectangle

    mesh = rectangle(41, 41, 0.2, 0.2)
    u, v = mesh.rest_uv_m.T
    fixed = (v == 0) & ((u <= 0.0101) | (u >= 0.1899))
    # Bent out of its plane by a millimetre, so that both start from the same side.
    hung_m = np.column_stack([1e-3 * np.sin(np.pi * v / 0.2), u - 0.1, 0.2005 - v])
    return mesh, fixed, hung_m


def _lowered(hung_m, time_s):
    return hung_m - np.array([0.0, 0.0, 0.5 * 0.010 * time_s**2])


def _side_by_side():
    from vertex_block_descent import VertexBlockDescent

    from slipstitch.config.simulation import SimulationSettings
    from slipstitch.physics.cloth import ClothSolver, SolverSettings, StepRecord
    from slipstitch.physics.fabric import isotropic_tables

    mesh, fixed, hung_m = _scene()
    cloth = ClothSolver(
        mesh,
        isotropic_tables(*(SHEET[k] for k in ("density_kg_m2", "membrane_N_m", "hinge_N_m")), 0.3),
        hung_m,
        friction=0.5,
        fixed=np.repeat(fixed[:, None], 3, axis=1),
        settings=replace(
            SolverSettings.of(SimulationSettings()), damping_s=0.0, self_contact=False
        ),
    )
    cloth.start()
    for _ in range(round(SETTLE_S / STEP_S)):
        cloth.advance(STEP_S, lambda time_s: hung_m)
    start_m = cloth.positions_m.copy()  # both start from here, at rest
    cloth.time_s, cloth.velocities_m_s[:] = 0.0, 0.0
    cloth.record = StepRecord()
    began = time.process_time()
    for _ in range(round(SHORT_S / STEP_S)):
        cloth.advance(STEP_S, lambda time_s: _lowered(hung_m, time_s))
    ours = {
        "cpu_s_per_s": (time.process_time() - began) / SHORT_S,
        "residual": cloth.record.largest_residual,
        "step_s": SHORT_S / cloth.record.steps,
        "iterations_per_step": cloth.record.newton_iterations / cloth.record.steps,
        "lowest_m": float(cloth.positions_m[:, 2].min()),
    }
    weight_N = 0.5 * cloth.nodal_force_N  # friction coefficient times the weight of a vertex
    rows = []
    for step_s, iterations in DESCENTS:
        other = VertexBlockDescent(
            mesh, start_m, fixed, SHEET, friction=0.5,
            contact_N_m=float(np.median(cloth.contact_stiffness_N_m)), iterations=iterations,
        )  # fmt: skip
        other.advance(1e-6, hung_m)  # kernels are loaded
        count = round(SHORT_S / step_s)
        began = time.process_time()
        for k in range(count):
            speeds = other.before.particle_qd.numpy().astype(float)
            moved_m = other.positions_m + step_s * speeds
            other.advance(step_s, _lowered(hung_m, (k + 1) * step_s))
        x = other.positions_m
        rows.append(
            {
                "step_s": step_s,
                "iterations": iterations,
                "cpu_s_per_s": (time.process_time() - began) / SHORT_S,
                "residual": _largest(other.out_of_balance(moved_m, x, step_s), x) / weight_N,
                "lowest_m": float(x[:, 2].min()),
                "mean_distance_m": float(np.linalg.norm(x - cloth.positions_m, axis=1).mean()),
            }
        )
        print(f"SolverVBD {rows[-1]}", file=sys.stderr, flush=True)
    # What rounding our converged positions to SolverVBD's single precision does to the forces.
    exact, rounded = (
        other.out_of_balance(cloth.positions_m, positions_m, STEP_S)
        for positions_m in (cloth.positions_m, cloth.positions_m.astype(np.float32).astype(float))
    )
    floor = float(np.linalg.norm(rounded - exact, axis=1).max()) / weight_N
    return {
        "ours": ours,
        "descent": rows,
        "single_precision_residual": floor,
        "creep": _creep(),
        "newton": importlib.metadata.version("newton"),
    }


def _largest(force_N, positions_m):
    """Of the particles that touch nothing."""
    return float(np.linalg.norm(force_N, axis=1)[positions_m[:, 2] > 1e-5].max())


def _creep(friction=0.5):
    """How far a square of cloth moves in a second on a plane of 0.98 times the friction."""
    from vertex_block_descent import GRAVITY_M_S2, VertexBlockDescent

    from slipstitch.physics.cloth import rectangle
    from slipstitch.physics.experiments.registry import run_protocol

    slope = np.arctan(SLOPE_OF_FRICTION * friction)
    options = {"friction": friction, "slope_deg": float(np.degrees(slope))}
    rows = [{"solver": "ours", "creep_m": run_protocol("incline", options)["creep_m"]}]
    mesh = rectangle(5, 5, 0.02, 0.02)
    mass_kg = SHEET["density_kg_m2"] * mesh.vertex_areas_m2()
    contact_N_m = GRAVITY_M_S2 * np.median(mass_kg) / 5e-7
    flat_m = np.column_stack(
        [mesh.rest_uv_m, -mass_kg * GRAVITY_M_S2 * np.cos(slope) / contact_N_m]
    )
    for iterations, epsilon in CREEP_DESCENTS:
        other = VertexBlockDescent(
            mesh, flat_m, np.zeros(25, bool), SHEET, friction=friction,
            contact_N_m=contact_N_m, iterations=iterations, friction_epsilon=epsilon,
            gravity=(GRAVITY_M_S2 * np.sin(slope), 0.0, -GRAVITY_M_S2 * np.cos(slope)),
        )  # fmt: skip
        for _ in range(50):
            other.advance(CREEP_STEP_S)
        moved_m = (other.positions_m - flat_m)[:, :2].mean(axis=0)
        rows.append(
            {
                "solver": "SolverVBD",
                "iterations": iterations,
                "friction_epsilon_m_s": epsilon,
                "creep_m": float(np.linalg.norm(moved_m)),
            }
        )
        print(f"creep {rows[-1]}", file=sys.stderr, flush=True)
    return rows


def main():
    """Run the parts asked for, and write the result."""
    from slipstitch.base.provenance import (
        atomic_path,
        provenance_record,
        start_clock,
        write_sidecar,
    )

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", choices=PARTS, default=PARTS)
    arguments = parser.parse_args()
    started = start_clock()
    result = json.loads(OUT.read_text()) if OUT.is_file() else {}
    run = {"mesh": mesh_part, "side-by-side": side_by_side_part, "steady": steady_part}
    for part in arguments.only:
        for found in run[part]():
            result[part] = {**found, "load_average": round(os.getloadavg()[0], 1)}
            with atomic_path(OUT) as temporary:
                temporary.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    record = provenance_record(
        "simulate", inputs=[GRID], config={"parts": arguments.only}, started=started
    )
    result["host"], result["commit"] = record["host_kind"], record["git_commit"]
    with atomic_path(OUT) as temporary:
        temporary.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    write_sidecar(OUT, record)
    print(OUT)


if __name__ == "__main__":
    main()
