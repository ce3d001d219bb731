"""The paper-on-paper traces as a case of the spring-slider protocol."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.ndimage import median_filter

from slipstitch.bench.gravity import GRAVITY_M_S2
from slipstitch.errors import BadInput

ABOUT = (
    "Measured: a paper-covered slider pulled over paper by a spring (Colas et al. 2019). No cloth."
)
SPIKE_SAMPLES = 5
KEPT_EVERY = 4  # of 2000 samples per second; the fastest swing has a period of 23 ms


def write_paper_case(data: Path, folder: Path) -> None:
    """Write ``folder`` as a case that ``slipstitch criticise`` reads.

    Each run has its own track and no repeat: it is its own specimen. What was not recorded (area,
    direction, rest, humidity, order) stays empty.

    Raises
    ------
    BadInput
        If a file of the data set is missing.
    """
    for path in (data / "runs.csv", data / "traces.npz"):
        if not path.exists():
            raise BadInput(f"{path}: missing; the stick-slip data set has runs.csv and traces.npz")
    arrays = np.load(data / "traces.npz")
    runs, traces = [], []
    for row in csv.DictReader((data / "runs.csv").open(encoding="utf-8")):
        mass, rate = float(row["slider_mass_kg"]), float(row["rate_Hz"])
        weight_mN = 1e3 * mass * GRAVITY_M_S2
        force = weight_mN * median_filter(arrays[row["array"]].astype(float), SPIKE_SAMPLES)
        runs.append(
            {
                "run_id": row["array"],
                "specimen_id": row["array"],
                "added_mass_g": 1e3 * mass,
                "spring_N_m": float(row["spring_N_per_m"]),
                "speed_mm_s": 1e-3 * float(row["drive_um_per_s"]),
                "u_force_mN": round(_noise(weight_mN * arrays[row["array"]].astype(float)), 4),
            }
        )
        kept = force[::KEPT_EVERY]
        traces.append(
            pd.DataFrame(
                {
                    "run_id": row["array"],
                    "t_s": np.arange(len(kept)) * KEPT_EVERY / rate,
                    "force_mN": kept,
                }
            )
        )
    empty = ("clock_min", "repeat_index", "orientation_deg", "dwell_s", "rh_pct", "pos_x_mm")
    table = pd.DataFrame(runs)
    for name in (*empty, "operator", "stage_azimuth_deg", "area_cm2"):
        table[name] = np.nan
    folder.mkdir(parents=True, exist_ok=True)
    table.to_csv(folder / "spring_slider_runs.csv", index=False)
    # A tenth of the size that the defaults give; the case is handed out with the workflow.
    pd.concat(traces, ignore_index=True).to_parquet(
        folder / "spring_slider.parquet",
        index=False,
        compression="zstd",
        compression_level=19,
        use_dictionary=["run_id", "force_mN"],
        column_encoding={"t_s": "BYTE_STREAM_SPLIT"},
    )
    meta = {"case": "paper on paper", "about": ABOUT, "nominal": {}, "protocols": ["spring_slider"]}
    (folder / "meta.json").write_text(json.dumps(meta, indent=1) + "\n", encoding="utf-8")


def _noise(force_mN: np.ndarray) -> float:
    """Noise and quantisation of a sample: from second differences, at least a step's uniform."""
    steps = np.diff(np.unique(force_mN))
    quantum = float(np.median(steps[steps > 1e-6 * np.ptp(force_mN)]))
    second = np.abs(np.diff(force_mN, 2))
    return max(1.4826 * float(np.median(second)) / np.sqrt(6.0), quantum / np.sqrt(12.0))
