"""A campaign of drop-and-drag in the cloth simulator with a hidden effect, tracked and noisy.

    python tests/support/cloth_bench.py FOLDER --effect anisotropy 0.25

The shapes come from the full simulation of the cloth (membrane, bending, contact), not from any
forward model of the criticism. Noise, specimen and run scatter hide the effect.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from slipstitch.physics.experiments.tracked_drag import DragRun, Sheet, drag_tracked
from slipstitch.physics.friction_law import CONTACT_MECHANISMS, FrictionLaw

NOMINAL = {"rho_kg_m2": 0.2, "B_Nm": 6.0e-6, "cloth_length_m": 0.2}
HEIGHTS_MM = (75.0, 100.0, 125.0)


def make_campaign(
    folder,
    effects,
    seed=1,
    specimens=6,
    repeats=4,
    friction=0.45,
    rows=161,
    stroke_m=0.14,
    step_s=0.04,
    u_pos_mm=1.5,
):
    """Write a case folder; ``effects`` is mechanism -> parameters (tilt: degrees and azimuth)."""
    random = np.random.default_rng(seed)
    sheet = Sheet(
        NOMINAL["rho_kg_m2"],
        NOMINAL["B_Nm"] * (1 + effects.get("bending_error", {}).get("bending_error", 0.0)),
        NOMINAL["cloth_length_m"],
    )
    tilt = effects.get("tilt", {"tilt": 0.0, "azimuth": 0.0})
    mechanisms = {name: values for name, values in effects.items() if name in CONTACT_MECHANISMS}
    runs, frames = [], []
    for specimen in range(specimens):
        level = np.exp(0.02 * random.standard_normal())
        for repeat in range(repeats):
            number = len(runs)
            row = {
                "run_id": f"d{number:03d}",
                "specimen_id": f"D{specimen}",
                "clock_min": round(3.0 * number + random.uniform(0, 1), 2),
                "repeat_index": repeat,
                "orientation_deg": float(random.choice([0.0, 45.0, 90.0, 180.0])),
                "dwell_s": float(random.choice([1.0, 10.0, 100.0])),
                "rh_pct": round(random.uniform(44, 56), 1),
                "pos_x_mm": round(random.uniform(0, 200), 1),
                "operator": str(random.choice(["A", "B"])),
                "stage_azimuth_deg": float(random.choice([0.0, 90.0, 180.0, 270.0])),
                "height_mm": float(HEIGHTS_MM[number % len(HEIGHTS_MM)]),
                "speed_mm_s": 20.0,
                "u_pos_mm": u_pos_mm,
            }
            runs.append(row)
            scatter = level * np.exp(0.01 * random.standard_normal())
            slope = np.radians(tilt["tilt"]) * np.cos(
                np.radians(row["stage_azimuth_deg"] - tilt["azimuth"])
            )
            law = FrictionLaw(friction * scatter, mechanisms)
            way = row["height_mm"] * 1e-3, row["speed_mm_s"] * 1e-3, stroke_m
            at = row["dwell_s"], row["repeat_index"], row["rh_pct"], slope
            run = DragRun(*way, np.radians(row["orientation_deg"]), *at)
            seen = drag_tracked(law, replace(sheet), run, rows, step_s, frame_rate_hz=5.0)
            edge, contact = (
                1e3 * exact_m + u_pos_mm * random.standard_normal(len(seen.time_s))
                for exact_m in (seen.edge_m, seen.contact_m)
            )
            columns = {
                "run_id": row["run_id"],
                "frame": np.arange(len(edge)),
                "phase": "fwd",
                "t_s": seen.time_s.round(4),
                "x_stage_mm": (1e3 * seen.stage_m).round(4),
                "te_x_mm": edge.round(4),
                "contact_len_mm": contact.round(4),
            }
            frames.append(pd.DataFrame(columns))
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(runs).to_csv(folder / "drop_drag_runs.csv", index=False)
    pd.concat(frames, ignore_index=True).to_csv(folder / "drop_drag.csv", index=False)
    about = (
        "A surrogate: simulated with an effect that the criticism is not told; nothing measured."
    )
    meta = {"case": folder.name, "about": about, "nominal": NOMINAL, "protocols": ["drop_drag"]}
    (folder / "meta.json").write_text(json.dumps(meta, indent=1) + "\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder")
    parser.add_argument("--effect", nargs=2, action="append", default=[], metavar=("NAME", "SIZE"))
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    planted = {name: {name: float(size)} for name, size in chosen.effect}
    if "tilt" in planted:
        planted["tilt"]["azimuth"] = 30.0
    make_campaign(chosen.folder, planted, chosen.seed)
