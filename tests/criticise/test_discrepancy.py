"""Where no mechanism explains the data, the smooth factor that they ask for is found."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import yaml
from support.criticised import measured
from support.departures import planted

from slipstitch.base.errors import BadInput
from slipstitch.criticise.case import read_case
from slipstitch.criticise.criticism_files import criticise_to_files
from slipstitch.criticise.inference.discrepancy import discrepancy_words, embedded_discrepancy
from slipstitch.criticise.inference.faulty_data import robust_fit
from slipstitch.criticise.inference.gain import plain_scatters
from slipstitch.criticise.inference.smooth_factor import Problem
from slipstitch.criticise.prediction import predict_model, read_verdict
from slipstitch.criticise.resimulation import law_of_run
from slipstitch.physics.friction_law import Contact
from slipstitch.physics.friction_law.extended_model import model_of, read_extended_model

SEED = 101


def bump(centre, width, size, scale=lambda c: c):
    return lambda c: 1 + size * np.exp(-0.5 * ((scale(c) - centre) / width) ** 2)


# Covariate, law along it, protocols.
PLANTED = {
    "a patch": ("pos_x_mm", bump(100.0, 18.0, 0.3), ["incline", "strip"]),
    "a slow wave": (
        "clock_min",
        lambda c: 1 + 0.15 * np.sin(2 * np.pi * c / 110),
        ["incline", "strip"],
    ),
    "a dip at one speed": ("speed_mm_s", bump(1.1, 0.7, -0.25, np.log), ["drag"]),
    "a bump in the load": ("load_ratio", bump(-0.2, 0.35, 0.25, np.log10), ["incline", "drag"]),
}
STRIBECK = PLANTED["a dip at one speed"]


def along(covariate, law):
    """A law along a covariate, as the bench asks for it."""
    places = {"pos_x_mm": "place_mm"}

    def factor(contact, moving):
        if covariate == "load_ratio":
            return law(contact["load_N"] / contact["area_m2"] / 50.0)
        acts = moving or covariate != "speed_mm_s"
        return law(contact[places.get(covariate, covariate)]) if acts else 1.0

    return factor


def measured_with(folder, seed, covariate, law, protocols, repeat=0):
    effects = {"smooth": along(covariate, law)} if covariate else {}
    # Specimens follow each other in time: their scatter hides a slow change unless it is small.
    even = dict.fromkeys(protocols, (0.01, 0.03)) if covariate == "clock_min" else {}
    planted(seed, folder, effects, *protocols, repeat=repeat, scatter=even)
    return measured(folder)


def discrepancy(folder, seed, along):
    m = measured_with(folder, seed, *along)
    state = robust_fit(m)
    return m, state, embedded_discrepancy(m, state)


@pytest.mark.parametrize("name", PLANTED)
def test_a_law_outside_the_library_is_found_with_its_curve_in_its_band(name, tmp_path):
    covariate, law, _ = PLANTED[name]
    inside = []
    for seed in (SEED, SEED + 1):  # knots of one curve are right or wrong together
        m, state, found = discrepancy(tmp_path / str(seed), seed, PLANTED[name])
        assert found["covariate"] == covariate
        assert found["tried"][covariate] < 0.01
        assert found["misfit_share"] > 0.3
        at = m.rows[covariate].to_numpy(float)
        mean = np.log(law(at[np.isfinite(at) & state.measurements.usual])).mean()
        true = np.log(law(np.array(found["knots"]))) - mean
        low, high = np.log(found["ci95"]).T
        inside.append(np.mean((low <= true) & (true <= high)))
        slack = 0.25 * (high - low)
        assert ((low - slack <= true) & (true <= high + slack)).all()
        assert np.ptp(true) > 2 * np.median(high - low)  # and a band that says something
    assert np.mean(inside) > 0.85  # of pointwise 95 % bands


@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
def test_where_nothing_is_hidden_no_factor_is_found(seed, tmp_path):
    _, _, found = discrepancy(tmp_path, seed, (None, None, ["incline", "drag"]))
    assert found["covariate"] is None
    assert set(found["tried"]) == {"pos_x_mm", "clock_min", "speed_mm_s", "load_ratio"}
    words = discrepancy_words(found)
    assert words.startswith("No smooth factor on the coefficient along position")


def test_a_fit_that_did_not_converge_says_so_and_is_not_used(tmp_path, monkeypatch):
    monkeypatch.setattr("slipstitch.criticise.inference.smooth_factor.ROUNDS", 1)
    *_, found = discrepancy(tmp_path, SEED, PLANTED["a patch"])
    assert (found["covariate"], found["not_converged"]) == (None, list(found["tried"]))
    assert "not known. The fit along position" in discrepancy_words(found)
    assert discrepancy_words(found).endswith("did not converge and is not used.")


def test_a_short_formula_whose_fit_did_not_converge_is_not_said_to_fit_worse(tmp_path, monkeypatch):
    fit = Problem.fit

    def without_short_formulas(problem, form):
        found = fit(problem, form)
        curve = form is None or form.roots is not None
        return replace(found, converged=found.converged and curve)

    monkeypatch.setattr(Problem, "fit", without_short_formulas)
    *_, found = discrepancy(tmp_path, SEED, PLANTED["a patch"])
    assert (found["covariate"], found["formula"]) == ("pos_x_mm", None)
    assert found["shapes_not_converged"] == ["line", "exponential", "step"]
    assert "(not known of line, exponential, step: the fit" in discrepancy_words(found)


def test_coefficients_and_scatter_that_go_to_and_fro_are_damped(tmp_path):
    """With whole steps alone, the curve along the speed alternates between two states here."""
    dip = bump(-0.2, 0.35, -0.5, np.log10)
    *_, found = discrepancy(tmp_path, SEED, ("load_ratio", dip, ["drag"]))
    assert "not_converged" not in found


def test_an_effect_of_no_covariate_is_no_factor(tmp_path):
    planted(7, tmp_path, {"operator_habit": 0.3}, "incline")
    m = measured(tmp_path)
    state = robust_fit(m)
    assert embedded_discrepancy(m, state)["covariate"] is None


@pytest.mark.parametrize(
    "shape, covariate, law, protocols, true",
    [
        ("line", "pos_x_mm", lambda c: 1 + 0.004 * (c - 100), ["incline"], 0.004),
        ("step", "clock_min", lambda c: np.where(c > 60, 1.3, 1.0), ["incline"], 1.3),
        ("power law", "speed_mm_s", lambda c: (c / 10) ** -0.4, ["drag"], -0.4),
    ],
)
def test_a_short_formula_is_proposed_where_it_fits_as_well(
    shape, covariate, law, protocols, true, tmp_path
):
    _, _, found = discrepancy(tmp_path, SEED, (covariate, law, protocols))
    assert found["formula"]["shape"] == shape
    low, high = found["formula"]["ci95"]
    slack = 0.25 * (high - low)
    assert low - slack < true < high + slack
    assert found["formula"]["text"] in discrepancy_words(found)


def test_no_formula_is_proposed_for_a_patch(tmp_path):
    _, _, found = discrepancy(tmp_path, SEED, PLANTED["a patch"])
    assert found["formula"] is None
    assert "no short formula fits as well" in discrepancy_words(found)


def test_verdict_page_and_model_hold_the_factor_and_a_simulation_reads_it(tmp_path):
    paths = {"verdict": "v.json", "page": "p.html", "model": "m.yaml"}
    paths = {kind: tmp_path / name for kind, name in paths.items()}
    measured_with(tmp_path / "case", SEED, *STRIBECK)
    words = criticise_to_files(read_case(tmp_path / "case"), 1, 200, paths)
    assert "no known mechanism explains" in words
    verdict = json.loads((tmp_path / "v.json").read_text())
    assert verdict["verdict"] == "unknown"
    found = verdict["discrepancy"]
    page = (tmp_path / "p.html").read_text()
    assert "takes away" in page and "The factor and its band" in page
    written = yaml.safe_load((tmp_path / "m.yaml").read_text())
    assert written["discrepancy"]["factors"] == found["factors"]
    law = read_extended_model(tmp_path / "m.yaml").law
    for speed_mm_s, factor in zip(found["knots"], found["factors"], strict=True):
        contact = Contact(normal_force_N=1.0, speed_m_s=1e-3 * speed_mm_s)
        expected = found["coefficients"]["mu_face"]
        assert law.force_limit(contact, static=True) == pytest.approx(expected)
        assert law.force_limit(contact, static=False) == pytest.approx(expected * factor)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a dip at one speed", "a patch"])
def test_a_fresh_campaign_is_predicted_better_with_the_factor(name, tmp_path):
    m = measured_with(tmp_path / "first", SEED, *PLANTED[name])
    state = robust_fit(m)
    found, null = embedded_discrepancy(m, state), state.fitted
    model = {
        "causes": [],
        "parameters": [p.name for p in null.parameters],
        "values": null.values,
        "covariance": null.covariance,
        "scatter": plain_scatters(SimpleNamespace(measurements=m, state=state), null),
    }
    scores, within = {None: [], "factor": []}, []
    for draw in (1, 2, 3):
        fresh = measured_with(tmp_path / str(draw), SEED, *PLANTED[name], repeat=draw)
        for key, table in ((None, None), ("factor", found)):
            mean, sd = (x[~fresh.lower_bound] for x in predict_model(model, fresh, table))
            z = (fresh.y[~fresh.lower_bound] - mean) / sd
            scores[key] += list(-0.5 * z**2 - np.log(sd))
            within += list(np.abs(z) < 1.96) if table else []
    assert np.mean(scores["factor"]) > np.mean(scores[None]) + 0.2
    assert np.mean(within) > 0.87  # of 95 % intervals, by the scatter of a dozen specimens


def test_a_factor_by_place_is_that_of_the_whole_run_when_it_is_simulated_again():
    table = {"covariate": "pos_x_mm", "knots": [0.0, 100.0], "factors": [0.8, 1.25]}
    plain = {"face": {"coefficient": 0.4, "mechanisms": {}}}
    model = model_of({"friction_law": plain, "discrepancy": table})
    for place_mm, expected in ((0.0, 0.32), (50.0, 0.4), (400.0, 0.5), (np.nan, 0.4)):
        law = law_of_run(pd.Series({"pos_x_mm": place_mm}), model, table)
        assert law.curve is None
        assert law.coefficient == pytest.approx(expected)


@pytest.mark.parametrize(
    "change", [{"knots": [1.0]}, {"covariate": "smell"}, {"ci95": 3}, {"scatter": {"drag": [1]}}]
)
def test_a_damaged_factor_in_a_verdict_is_one_line(change, tmp_path):
    found = {
        "covariate": "speed_mm_s",
        "knots": [1.0, 10.0],
        "factors": [0.8, 1.2],
        "ci95": [[0.7, 0.9], [1.1, 1.3]],
        "coefficients": {"mu_face": 0.3},
        "scatter": {"drag": [0.03, 0.02, 1.1]},
    }
    path = tmp_path / "verdict.json"
    path.write_text(json.dumps({"models": {}, "discrepancy": found}))
    with pytest.raises(BadInput, match="models: missing"):
        read_verdict(path)
    path.write_text(json.dumps({"models": {}, "discrepancy": found | change}))
    with pytest.raises(BadInput, match=r"verdict\.json: discrepancy: must contain covariate"):
        read_verdict(path)
