"""(f) A pushed block: steps in time and the features agree; an impact is no static excess."""

from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from support.criticised import change_meta, measured, write_runs

from slipstitch.base.errors import BadInput
from slipstitch.criticise.case import read_case
from slipstitch.criticise.causes import Bench
from slipstitch.criticise.measurements import assemble
from slipstitch.criticise.protocols.push import LEVEL, PEAK
from slipstitch.physics.friction_law import FrictionLaw

CASES = Path(__file__).parents[2] / "data" / "cases"
MASS_KG, STIFFNESS_N_M, SPEED_M_S, MU = 1.5, 2.0e4, 2.5e-3, 0.3
WEIGHT_N = MASS_KG * 9.80665


@cache
def pushed(static, time_s=5.0, quiet_s=0.5, step_s=2e-5):
    """Force on the finger every 10 ms: a mass behind a damped spring, stepped in time."""
    x = v = 0.0
    force = []
    for i in range(int(time_s / step_s)):
        pressed = max(SPEED_M_S * (i * step_s - quiet_s) - x, 0.0)
        contact = STIFFNESS_N_M * pressed + (20.0 * (SPEED_M_S - v) if pressed > 0 else 0.0)
        if v == 0 and contact <= WEIGHT_N * MU * (1 + static):
            pass
        else:
            v = max(v + step_s * (contact - WEIGHT_N * MU) / MASS_KG, 0.0)
            x += step_s * v
        if i % round(0.01 / step_s) == 0:
            force.append(contact)
    return 1e3 * np.array(force)


def write_case(folder, static, one_file_a_run, runs=6):
    random = np.random.default_rng(2)
    force = pushed(static)
    time = 0.01 * np.arange(len(force))
    folder.mkdir()
    columns = {"push_azimuth_deg": 60.0 * np.arange(runs), "added_mass_g": 1e3 * MASS_KG}
    columns |= {"speed_mm_s": 2.5, "quiet_s": 0.4, "u_force_mN": 5.0}
    columns |= dict.fromkeys(("area_cm2", "support", "turned_deg", "moved_mm"), np.nan)
    table = write_runs(folder, "push", runs, {}, **columns)
    change_meta(folder, protocols=["f"])
    parts = {}
    for i, run in enumerate(table["run_id"]):
        along = np.radians(60.0 * i)
        readings = np.outer(force, [np.cos(along), np.sin(along)]) + np.array(
            [800.0, -300.0]
        )  # a zero
        readings += random.normal(0, 5.0, readings.shape)
        parts[run] = pd.DataFrame(
            {"t_s": time, "force_x_mN": readings[:, 0], "force_y_mN": readings[:, 1]}
        )
    if one_file_a_run:
        (folder / "push").mkdir()
        for i, (run, part) in enumerate(parts.items()):
            if i % 2:
                part.to_parquet(folder / "push" / f"{run}.parquet")
            else:
                part.to_csv(folder / "push" / f"{run}.csv", index=False)
    else:
        whole = pd.concat([part.assign(run_id=run) for run, part in parts.items()])
        whole.to_csv(folder / "push.csv", index=False)
    return folder


@pytest.fixture(scope="module", params=[0.0, 0.35])
def campaign(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("push") / "case"
    return request.param, write_case(folder, request.param, one_file_a_run=True)


def test_level_and_first_peak_are_those_of_the_steps_in_time(campaign):
    static, folder = campaign
    found = measured(folder)
    quantity = found.rows["quantity"].to_numpy()
    assert (quantity == LEVEL).sum() == (quantity == PEAK).sum() == 6
    law = FrictionLaw(MU, {"static_kinetic": {"static_kinetic": static}} if static else {})
    expected = found.blocks[0].predict(law, Bench())
    level = quantity == LEVEL
    assert found.y[level] == pytest.approx(expected[level], rel=0.03)  # stick-slip: a mean in time
    assert found.y[~level] == pytest.approx(expected[~level], rel=0.3)
    assert np.all(np.abs(found.y - expected)[~level] < found.u[~level])


def test_an_impact_does_not_pass_for_a_static_excess(tmp_path):
    """The peak of a block that slips at its kinetic friction is told by the finger's stiffness."""
    peaks = {}
    for static in (0.0, 0.35):
        found = measured(write_case(tmp_path / str(static), static, False))
        plain = found.blocks[0].predict(FrictionLaw(MU), Bench())
        own = (found.rows["quantity"] == PEAK).to_numpy()
        assert found.y[own].mean() > 300.0  # a peak there is, in both
        peaks[static] = ((found.y - plain) / found.u)[own].mean()
    assert abs(peaks[0.0]) < 0.5 and peaks[0.35] > 1.5


def test_one_file_a_run_is_read_as_one_table(tmp_path):
    tables = [
        read_case(write_case(tmp_path / str(i), 0.0, one_file_a_run)).tables["push"]
        for i, one_file_a_run in enumerate((True, False))
    ]
    first, second = (t.sort_values(["run_id", "t_s"], ignore_index=True) for t in tables)
    pd.testing.assert_frame_equal(first, second)


def test_files_that_belong_to_no_run_are_named(tmp_path):
    folder = write_case(tmp_path / "case", 0.0, one_file_a_run=True)
    (folder / "push" / "r0.csv").rename(folder / "push" / "q7.csv")
    with pytest.raises(BadInput, match=r"push: 'q7' is not in push_runs\.csv"):
        read_case(folder)
    (folder / "push" / "q7.csv").rename(folder / "push" / "r1.csv")
    with pytest.raises(BadInput, match="a run as CSV and as Parquet"):
        read_case(folder)
    (folder / "push.csv").write_text("run_id\n")
    with pytest.raises(BadInput, match=r"both push\.csv and push; only one"):
        read_case(folder)


@pytest.mark.parametrize("board, straight", [("wood", 81), ("other", 67)])
def test_the_pushes_of_the_published_data_are_near_translations(board, straight):
    case = read_case(CASES / f"block_on_{board}_board")
    assert len(case.tables["push_runs"]) == 250
    measured = assemble(case)
    levels = measured.rows[measured.rows["quantity"] == LEVEL]
    assert len(levels) == straight
    assert set(levels["support"]) == {"whole face", "three points"}
    ratio = levels["y"] / (1e3 * 1.518 * 9.80665)
    assert 0.25 < ratio.median() < 0.36
