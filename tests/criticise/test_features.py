"""Features on null data: unbiased, with the scatter that they claim."""

import numpy as np
import pandas as pd
import pytest
from support.criticised import measured
from support.departures import planted
from support.departures.campaign import PROTOCOLS, draw_plan, write

from slipstitch.criticise.case import read_case
from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.inference.fit import parameters_of
from slipstitch.criticise.measurements import assemble
from slipstitch.criticise.protocols import PROTOCOLS as READ

SEEDS = range(40, 52)
# Standard deviation of z by feature; that of features with a specimen's scatter in them is known to
# about 0.1. Two claim more uncertainty than they have.
SPREAD = (0.8, 1.15)
CAUTIOUS = {"first_motion_mm": (0.65, 0.85), "lost_motion_mm": (0.6, 0.8)}


def coefficients(plan):
    """Logarithms of the true ones."""
    return {"mu_face": np.log(plan.mu_face), "mu_edge": np.log(plan.mu_edge)}


@pytest.fixture(scope="module")
def z_scores(tmp_path_factory):
    found = []
    for seed in SEEDS:
        folder = tmp_path_factory.mktemp(f"case{seed}")
        plan = planted(seed, folder, {}, *PROTOCOLS[:4], outliers=0.0)
        m = measured(folder)
        scatter = np.array([np.hypot(*plan.scatter[protocol]) for protocol in m.protocol])
        scatter = m.sensitivity(coefficients(plan)) * scatter
        z = (m.y - m.predict(coefficients(plan), ())) / np.hypot(m.u * plan.understated, scatter)
        found.append(pd.DataFrame({"quantity": m.rows["quantity"], "z": z})[~m.lower_bound])
    return pd.concat(found).groupby("quantity")["z"]


@pytest.mark.slow
def test_z_scores_of_every_feature_have_mean_zero_and_the_spread_that_they_should(z_scores):
    assert set(z_scores.groups) == {q.name for name in PROTOCOLS[:4] for q in READ[name].quantities}
    spread, limits = z_scores.std(), {name: CAUTIOUS.get(name, SPREAD) for name in z_scores.groups}
    outside = {
        n: round(found, 2) for n, found in spread.items() if not limits[n][0] < found < limits[n][1]
    }
    assert not outside
    # Runs of a specimen share its scatter, so the mean of some hundred z is known to about 0.15.
    assert (z_scores.mean().abs() < 0.3).all(), z_scores.mean().round(2).to_dict()


def z_of(m, plan, quantity, **zeros):
    """Of one quantity beside the null that is true."""
    z = (m.y - m.predict(coefficients(plan), (), zeros)) / (m.u * plan.understated)
    own = z[(m.rows["quantity"] == quantity).to_numpy()]
    assert len(own) >= 5
    return own


@pytest.fixture
def drag(tmp_path):
    """The plan and the case of drags without effects, with faults."""

    def made(*faults):
        plan = draw_plan(2, "null", False, ("drag",))
        plan.faults = faults
        write(plan, tmp_path)
        return plan, read_case(tmp_path)

    return made


@pytest.mark.parametrize("late_s", [0.12, 0.0])
def test_a_late_force_cell_moves_the_start_and_spoils_nothing_else(late_s, drag):
    delay = {"protocol": "drag", "quantity": "force_mN", "kind": "delay", "size": late_s}
    plan, case = drag(delay)
    m = assemble(case)
    for quantity in ("relaxed_mN", "stiffness"):
        own = z_of(m, plan, quantity, force_delay_s=late_s)
        assert np.abs(own).max() < 4.5, quantity
        assert abs(own.mean()) < 0.7, quantity
        assert own.std() < 1.35, quantity


def test_remembered_predictions_are_those_that_would_be_made_anew(tmp_path):
    # A block that reads more of the bench than its READS say would be answered from memory.
    planted(7, tmp_path, {}, *PROTOCOLS)
    remembering, changed = measured(tmp_path), set()
    for name in MECHANISMS:
        parameters = parameters_of(remembering, (name,))
        values = {p.name: p.null for p in parameters}
        first = remembering.predict(values, ())
        values |= {p.name: p.null + p.scale for p in MECHANISMS[name].parameters}
        found = remembering.predict(values, (name,))
        remembering.remembered.clear()
        anew = remembering.predict(values, (name,))
        assert np.array_equal(found, anew), name
        if not np.array_equal(found, first):
            changed.add(name)
        remembering.predict({p.name: p.null for p in parameters}, ())
    assert changed == set(MECHANISMS)


@pytest.mark.parametrize("lost", ["turn", "fall"])
def test_what_happened_while_no_reading_was_taken_is_not_guessed(lost, drag):
    plan, case = drag()
    trace = case.tables["drag"]
    turn = trace["x_stage_mm"].max()
    near = trace["run_id"].isin(pd.unique(trace["run_id"])[::3])
    if lost == "turn":
        near &= trace["x_stage_mm"] > turn - 2.0
    else:  # all of the fall
        off = trace["force_mN"] > trace.groupby("run_id")["force_mN"].transform("min") * 0.8
        near &= (trace["stroke"] == 1) & off & (trace["x_stage_mm"] < turn - 0.2)
    case.tables["drag"] = trace[~near]
    assert np.abs(z_of(assemble(case), plan, "lost_motion_mm")).max() < 4.5


def test_a_first_reading_far_off_moves_no_ramp(drag):
    plan, case = drag()
    trace = case.tables["drag"]
    first = ~trace.duplicated("run_id")
    # A late stage: the force rests before it rises, but for one reading that is far off.
    trace.loc[trace["stroke"] == 0, "x_stage_mm"] += 2.0
    rest = [
        trace[first].assign(x_stage_mm=x, force_mN=-9 * plan.noise["drag"] if x == 0 else 0.0)
        for x in np.arange(0, 2.0, 0.25)
    ]
    whole = pd.concat([*rest, trace], ignore_index=True)
    case.tables["drag"] = whole.sort_values(["run_id", "stroke"], kind="stable")
    own = z_of(assemble(case), plan, "relaxed_mN", stage_zero_m=2e-3)
    assert np.abs(own).max() < 4.5


def null_of(seed, protocol, folder, **changes):
    """(measurements, residuals of the true null over their uncertainties) of one protocol."""
    plan = planted(seed, folder, {}, protocol, outliers=0.0, understated=1.0, **changes)
    m = measured(folder)
    zeros = {"damping": plan.damping} if protocol == "spring_slider" else {}
    return m, m.y - m.predict(coefficients(plan), (), zeros)


@pytest.mark.parametrize("seed", [20012, 20022])
def test_contact_is_not_read_as_stuck_once_the_cloth_may_slide(seed, tmp_path):
    # A camera with 1 mm of noise sees the first motion several millimetres late.
    m, residual = null_of(seed, "drop_drag", tmp_path, noise={"drop_drag": 1.0})
    stuck = (m.rows["quantity"] == "stuck_contact_mm").to_numpy()
    z = (residual / m.u)[stuck]
    assert len(z) >= 15
    assert abs(z.mean()) < 0.5
    assert z.std() < 1.5


def test_slips_that_are_seen_late_are_read_where_the_line_was(tmp_path):
    m, residual = null_of(20002, "drag", tmp_path)
    table = m.rows.assign(residual=residual, u=m.u)
    table = table.pivot(index="run_id", columns="quantity", values=["residual", "u"]).dropna()
    for slip, level in (
        ("force_first_slip_mN", "force_plateau_mN"),
        ("force_reversal_slip_mN", "force_back_plateau_mN"),
    ):
        # The run's own coefficient is in both.
        gap = table["residual"][slip] - table["residual"][level]
        z = gap / np.hypot(table["u"][slip], table["u"][level])
        assert len(z) >= 20
        assert abs(z.mean()) < 0.5, slip
        assert 0.7 < z.std() < 1.3, slip


def test_a_damped_slider_on_an_even_track_has_the_features_of_its_model(tmp_path):
    even = {"damping": 0.03, "scatter": {"spring_slider": (0.0, 0.0)}}
    m, residual = null_of(20052, "spring_slider", tmp_path, **even)
    for quantity in ("slider_level_mN", "slider_swing_mN", "slider_first_swing_mN"):
        z = (residual / m.u)[(m.rows["quantity"] == quantity).to_numpy()]
        assert len(z) >= 5, quantity
        assert abs(z.mean()) < 0.5, quantity
    level = m.y[(m.rows["quantity"] == "slider_level_mN").to_numpy()].mean()
    assert m.blocks[0].track_drop_mN.max() < 0.01 * level
