"""Cases of the benches, as the criticism reads and judges them."""

import json

import numpy as np
import pandas as pd

from slipstitch.criticise.case import read_case
from slipstitch.criticise.measurements import assemble
from slipstitch.criticise.verdict import analyse
from slipstitch.criticise.verdict_data import verdict_of


def measured(folder):
    """The features of a case."""
    return assemble(read_case(folder))


def judged(folder, replicates=100):
    """The analysis of a case."""
    return analyse(measured(folder), replicates=replicates)


def verdict_on(folder, replicates=100):
    """The verdict on a case as plain data, and the analysis behind the verdict."""
    case = read_case(folder)
    analysis = analyse(assemble(case), replicates=replicates)
    return verdict_of(case, analysis, 1, "test"), analysis


def change(path, **columns):
    """Other columns of a table, or functions of it that give them."""
    pd.read_csv(path).assign(**columns).to_csv(path, index=False)


def change_meta(folder, **values):
    """Other entries of meta.json; those of ``nominal`` beside what is there."""
    meta = json.loads((folder / "meta.json").read_text(encoding="utf-8-sig"))
    nominal = meta["nominal"] | values.pop("nominal", {})
    (folder / "meta.json").write_text(json.dumps(meta | {"nominal": nominal} | values))


def write_runs(folder, name, count, nominal, **columns):
    """The runs of a protocol and meta.json; what is not given was not recorded."""
    empty = ("orientation_deg", "dwell_s", "rh_pct", "pos_x_mm", "operator", "stage_azimuth_deg")
    runs = {
        "run_id": [f"r{i}" for i in range(count)],
        "specimen_id": [f"s{i // 3}" for i in range(count)],
        "clock_min": 3.0 * np.arange(count),
        "repeat_index": np.arange(count) % 3,
        "area_cm2": 1.0,
    }
    runs = pd.DataFrame(runs | dict.fromkeys(empty, np.nan) | columns)
    runs.to_csv(folder / f"{name}_runs.csv", index=False)
    (folder / "meta.json").write_text(json.dumps({"nominal": nominal}), encoding="utf-8-sig")
    return runs
