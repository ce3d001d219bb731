"""A campaign's certificate: what it could have seen is what it sees."""

import json
from dataclasses import replace

import numpy as np
import pytest
from support.criticised import change_meta, judged, measured
from support.departures import planted
from support.departures.strength import SLIDE_MM, STROKE_MM, TRAVEL_MM

from slipstitch.base.errors import BadInput
from slipstitch.criticise.case import read_case
from slipstitch.criticise.criticism_files import false_alarms, power_to_file
from slipstitch.criticise.expected_traces import assumptions_of, expected
from slipstitch.criticise.inference.certificate import of_design, plain_model
from slipstitch.criticise.verdict import SIGNIFICANCE, analyse


def test_an_effect_well_above_the_smallest_detectable_is_seen_and_one_far_below_is_not(tmp_path):
    planted(93, tmp_path / "null", {}, "incline")
    null = judged(tmp_path / "null")
    assert null.verdict == "none"
    smallest = null.detectable["nap"].size
    assert 0.005 < smallest < 0.2
    assert smallest <= null.detectable["nap"].named < np.inf
    for factor, seen in ((2.0, True), (0.2, False)):
        folder = tmp_path / f"{factor}"
        planted(93, folder, {"nap": factor * smallest}, "incline")
        found = judged(folder)
        assert (found.null_outcome.global_p < SIGNIFICANCE) == seen


def power(folder, replicates=100):
    case = read_case(folder, with_measurements=False)
    assumed = assumptions_of(case)
    design = expected(case, assumed, 1)
    return of_design(plain_model(design, assumed), 1, replicates)


def test_more_trials_show_smaller_effects_and_none_shows_what_nothing_would(tmp_path):
    planted(93, tmp_path, {}, "incline")
    table = tmp_path / "incline.csv"
    lines = table.read_text().splitlines()
    table.write_text("\n".join(lines[:31]) + "\n")
    few = power(tmp_path)
    table.write_text("\n".join(lines) + "\n")
    all_ = power(tmp_path)
    assert all_["nap"].size < few["nap"].size
    for found in [*few.values(), *all_.values()]:
        assert np.isinf(found.size) or found.on_friction < np.log(10)
    assert np.isinf(all_["static_kinetic"].size)
    assert "backlash" not in all_


def told(plan):
    """What tables of runs do not tell of the bench of departures."""
    sd, length_mm = plan.grain
    return {
        "drag": {
            "drag_stroke_mm": STROKE_MM,
            "drag_step_mm": plan.sampling_mm,
            "drag_texture_sd": sd,
            "drag_texture_mm": length_mm,
        },
        "drop_drag": {"drop_drag_stroke_mm": TRAVEL_MM, "drop_drag_step_mm": plan.frame_mm},
        "spring_slider": {"slider_travel_mm": SLIDE_MM, "slider_texture_sd": 1e-6},
    }.get(plan.protocols[0], {})


@pytest.mark.parametrize(
    "seed, protocol",
    [(2118, "incline"), (2056, "strip"), (2055, "drag"), (2108, "drop_drag"),
     (2046, "spring_slider")],
)  # fmt: skip
def test_a_design_says_before_it_is_measured_what_its_campaign_says_after(tmp_path, seed, protocol):
    plan = planted(seed, tmp_path, {}, protocol)
    after = judged(tmp_path)
    # The same scatter: how large it is, no design tells.
    scatter = after.null_state.scatters[protocol]
    coefficient = "mu_edge" if protocol == "strip" else "mu_face"
    assumed = ("scatter_specimen", "scatter_run", "noise_factor")
    design = told(plan) | dict(zip(assumed, scatter, strict=True))
    change_meta(tmp_path, design=design | {coefficient: getattr(plan, coefficient)})
    before = power(tmp_path)
    assert set(before) == set(after.detectable)
    assert sum(np.isfinite(found.size) for found in before.values()) >= 6
    for name, found in after.detectable.items():
        if np.isfinite(found.size) or np.isfinite(before[name].size):
            assert 0.5 < before[name].size / found.size < 2.0, name


def test_power_says_what_it_assumed_and_refuses_what_is_no_assumption(tmp_path):
    planted(93, tmp_path, {}, "drag")
    (tmp_path / "drag.csv").unlink()

    def said(**design):
        change_meta(tmp_path, design=design)
        case = read_case(tmp_path, with_measurements=False)
        return power_to_file(case, 1, 50, tmp_path / "power.json")

    assert "drag_stroke_mm: 70 mm" in said(drag_stroke_mm=70)
    assumed = json.loads((tmp_path / "power.json").read_text())["assumed"]
    assert assumed["drag_stroke_mm"] == 70 and "drop_drag_stroke_mm" not in assumed
    for design, words in (
        ({"stroke": 70}, r"design\.stroke: unknown"),
        ({"mu_face": 30}, r"design\.mu_face: 30; must be between 0\.005 and 8"),
        ({"mu_face": True}, r"design\.mu_face: True; must be a positive number"),
    ):
        with pytest.raises(BadInput, match=words):
            said(**design)


@pytest.mark.slow
def test_false_alarms_are_counted_in_campaigns_that_hold_nothing(tmp_path):
    planted(93, tmp_path, {}, "incline")
    m = measured(tmp_path)
    null = analyse(m, replicates=50)
    state = replace(null.null_state, measurements=m)
    quiet = false_alarms(state, 8, 1, 50)
    assert quiet["campaigns"] == 8 and quiet["estimate"] <= 0.25
    # A null that is none: friction along the nap that the null does not know of.
    along = np.cos(np.radians(m.rows["orientation_deg"].to_numpy(float)))
    loud = replace(null.null, prediction=null.null.prediction * (1 + 0.2 * along))
    assert false_alarms(replace(state, fitted=loud), 3, 1, 50)["estimate"] == 1.0
    low, high = quiet["ci95"]
    assert 0 <= low <= quiet["estimate"] <= high < 0.7
