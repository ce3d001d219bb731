"""Readings in another unit are flagged with the likely one, and not judged."""

import json
import shutil

import numpy as np
import pytest
from support.criticised import change, change_meta, verdict_on
from support.departures import planted

from slipstitch.cli.main import main
from slipstitch.criticise.case import read_case
from slipstitch.criticise.plausibility import implausible
from slipstitch.criticise.statement import sentence

MIXED = ["incline", "strip", "drag", "drop_drag"]


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    planted(4, folder, {}, *MIXED)
    return folder


def spoilt(good, folder, table, **columns):
    """A copy of the case with columns of a table changed."""
    shutil.copytree(good, folder)
    change(folder / f"{table}.csv", **columns)
    return folder


def test_a_good_case_is_plausible(good):
    assert implausible(read_case(good)) == []


SPOILT = [
    ("incline", {"angle_deg": lambda t: np.radians(t["angle_deg"])}, "angles in radians"),
    ("incline", {"angle_deg": 0.0}, "nothing but zeros"),
    ("incline", {"angle_deg": lambda t: 90 - 0.15 * t["angle_deg"]}, "angles to the vertical"),
    ("incline", {"angle_deg": -5.0}, "signs the other way round"),
    ("drag", {"force_mN": lambda t: 1e-3 * t["force_mN"]}, "forces in N, not mN"),
    ("drag", {"force_mN": lambda t: -t["force_mN"]}, "signs the other way round"),
    ("drag", {"force_mN": 0.0}, "nothing but zeros"),
    ("drag_runs", {"added_mass_g": 1.2e3}, "ten times too large"),
    ("strip", {"eps_slip": 0.0}, "nothing but zeros"),
    ("strip", {"length_mm": lambda t: 10 * t["length_mm"]}, "length_mm in another unit"),
    (
        "drop_drag",
        {"contact_len_mm": lambda t: 1e-3 * t["contact_len_mm"]},
        "lengths in another unit",
    ),
]


@pytest.mark.default_cases(4)
@pytest.mark.parametrize("table, columns, likely", SPOILT)
def test_a_wrong_unit_is_named(good, tmp_path, table, columns, likely):
    found = implausible(read_case(spoilt(good, tmp_path / "case", table, **columns)))
    assert len(found) == 1
    assert likely in found[0] and "\n" not in found[0]


@pytest.mark.parametrize(
    "key, factor, words",
    [
        ("rho_kg_m2", 1000.0, "in g/m²"),
        ("thickness_m", 1000.0, "another unit or ten times off"),
        ("thickness_m", 0.1, "another unit or ten times off"),
        ("cloth_length_m", 10.0, "another unit or ten times off"),
        ("cloth_length_m", 0.1, "another unit or ten times off"),
        ("k_tether_N_m", 10.0, "another unit or ten times off"),
        ("k_tether_N_m", 0.1, "another unit or ten times off"),
    ],
)
def test_a_nominal_size_of_another_unit_is_named(good, tmp_path, key, factor, words):
    folder = spoilt(good, tmp_path / "case", "incline")
    change_meta(folder, nominal={key: factor * read_case(folder).nominal[key]})
    found = implausible(read_case(folder))
    assert any(key in line and words in line for line in found)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_tether_half_or_twice_as_stiff_is_none_of_another_unit(good, factor):
    case = read_case(good)
    case.nominal["k_tether_N_m"] *= factor
    assert implausible(case) == []


@pytest.mark.slow
def test_a_stiffness_ten_times_off_is_named_with_the_likely_slip(tmp_path):
    planted(4, tmp_path, {}, "drop_drag")
    change_meta(tmp_path, nominal={"B_Nm": 10 * read_case(tmp_path).nominal["B_Nm"]})
    verdict, _ = verdict_on(tmp_path, 50)
    assert "bending_error" in verdict["causes"]
    assert "A power of ten in B_Nm or B_strip_Nm?" in sentence(verdict)


@pytest.mark.parametrize(
    "name, estimate, interval, where",
    [
        ("bending_error", 5.3, [2.2, 11.6], "B_Nm"),
        ("bending_error", 0.9, [0.5, 1.4], None),
        ("mass_error", 2.0, [0.9, 3.6], "rho_kg_m2"),  # 9 is beyond its bound
        ("mass_error", 0.35, [0.3, 0.4], None),
        ("force_gain", -0.6, [-0.65, -0.55], "the force"),
        ("force_gain", -0.5, [-0.55, -0.45], None),
    ],
)
def test_an_error_that_may_be_a_power_of_ten_is_said_to_be(name, estimate, interval, where):
    entry = {"estimate": estimate, "ci95": interval, "unit": "1"}
    verdict = {"verdict": "cause", "causes": [name], "parameters": {name: entry}}
    said = sentence(verdict | {"residual_tests": [], "not_exported": {}})
    assert ("A power of ten in" in said) == (where is not None)
    assert (where or "") in said


@pytest.mark.parametrize("table, columns, likely", [SPOILT[0], SPOILT[4], SPOILT[5]])
def test_it_is_insufficient_or_refused_not_none(tmp_path, capsys, table, columns, likely):
    planted(4, tmp_path, {}, table)
    change(tmp_path / f"{table}.csv", **columns)
    words = ["criticise", str(tmp_path), "--out", str(tmp_path / "v.json"), "--replicates", "50"]
    status = main(words)
    said = capsys.readouterr()
    if status == 0:
        assert json.loads((tmp_path / "v.json").read_text())["verdict"] == "insufficient"
    assert likely in (said.out if status == 0 else said.err)
