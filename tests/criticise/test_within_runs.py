"""What single runs show: an uneven track in (e), the impact in (f)."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from support.criticised import measured
from support.departures import planted

from slipstitch.cli.main import main
from slipstitch.criticise import resimulation
from slipstitch.criticise.case import read_case
from slipstitch.criticise.measurements import assemble
from slipstitch.criticise.resimulation import compare
from slipstitch.criticise.statement import gain_words, sentence
from slipstitch.criticise.within_runs import departure, track_step, within_runs, words
from slipstitch.physics.experiments.tracked_drag import TrackedShape

CASES = Path(__file__).parents[2] / "data" / "cases"


@pytest.mark.parametrize("uneven", [0.0, 0.05])
def test_an_uneven_track_is_found_where_there_is_one(uneven, tmp_path):
    random = np.random.default_rng(1)
    waves, phases = random.uniform(4, 9, (4, 1)), random.uniform(0, 6.28, (4, 1))

    def track(place_mm):
        return 1 + uneven * np.sin(2 * np.pi * place_mm / waves + phases).sum(axis=0)

    even = {"outliers": 0.0, "noise": {"spring_slider": 2.0}, "tracks": {"spring_slider": track}}
    planted(6, tmp_path, {"static_kinetic": 0.1}, "spring_slider", **even)
    found = within_runs(read_case(tmp_path), measured(tmp_path))["spring_slider"]
    low, high = track_step(found, "track")["step_ci95"]
    if uneven:
        assert low > 0 and 0.03 < found["track_sd"] < 0.12
        assert 0.5 < found["track_length_mm"] < 6.0
        assert "uneven along the track" in " ".join(words({"spring_slider": found}))
    else:
        assert low <= 0 and high < 0.1
        assert words({"spring_slider": found}) == []
    assert track_step(found, "static")["step_ci95"][0] > 0


@pytest.mark.slow
def test_paper_on_paper_has_an_uneven_track_beside_its_static_excess():
    case = read_case(CASES / "paper_on_paper")
    found = within_runs(case, assemble(case))["spring_slider"]
    for model in ("run", "static", "inertia", "track"):
        assert track_step(found, model)["step_ci95"][0] > 0, model
    assert 0.05 < found["track_sd"] < 0.15 and abs(found["same_place_correlation"]) < 0.2


def test_the_first_peak_on_the_boards_is_that_of_the_impact():
    case = read_case(CASES / "block_on_other_board")
    found = within_runs(case, assemble(case))["push"]
    assert found["peak_over_level"] == pytest.approx(1.13, abs=0.02)
    assert found["impact_alone_over_level"] == pytest.approx(found["peak_over_level"], abs=0.04)
    assert found["excess_ci95"][0] < 0 < found["excess_ci95"][1]
    assert "no static excess shows" in " ".join(words({"push": found}))


def test_the_page_of_a_real_case_says_what_one_specimen_cannot_tell(tmp_path):
    text = tmp_path / "page.md"
    case = CASES / "block_on_other_board"
    words = ["criticise", str(case), "--out", str(tmp_path / "v.json"), "--replicates", "50"]
    assert not main([*words, "--report", str(text)])
    page = text.read_text()
    assert "“whole face” was measured with one specimen only" in page
    assert "not cloth" in page and "first peak" in page
    assert "adhesion (part of the friction" in page
    assert "## What this design could have seen" in page and "(a limit, not simulated)" in page
    assert "| push | 14 | 7.6 |" in page


def test_the_sentence_of_a_none_does_not_deny_what_is_within_the_runs():
    track = {"ladder": [{"model": "track", "step_ci95": [0.2, 0.3]}]}
    impact = {"excess_ci95": [-0.1, 0.1]}
    verdict = {"verdict": "none", "null": {"global_p": 0.5}, "scatter_findings": []}
    said = sentence(verdict | {"within_runs": {"spring_slider": track, "push": impact}})
    assert said.endswith("but within them friction changes along the track.")
    assert sentence(verdict | {"within_runs": {"push": impact}}).startswith("Nothing beyond plain")
    impact["excess_ci95"][0] = 0.05
    assert departure({"push": impact}) == "the first peak is more than the impact"


def test_a_headline_states_a_gain_only_where_it_is_certain():
    gain = {"estimate": 0.2, "ci95": [-0.1, 0.5], "rmse_null": 0.2, "rmse_extended": 0.03}
    assert "no gain is certain" in gain_words(gain | {"n_groups": 9})
    gain |= {"ci95": [0.1, 0.3], "n_groups": 9}
    assert "error falls from 20.0 to 3.0 %" in gain_words(gain)
    assert "error" not in gain_words(gain | {"rmse_null": 0.603, "rmse_extended": 0.574})


def test_the_fall_of_an_error_is_never_above_all_of_it():
    random = np.random.default_rng(4)
    specimens = np.repeat(list("abcd"), 50)
    size = np.repeat([1.0, 2.0, 6.0, 1.5], 50)
    frames = pd.DataFrame({"specimen_id": specimens, "te_x_mm": 0.0})
    frames["te_x_mm_null"] = size * random.normal(1, 0.1, 200)
    frames["te_x_mm_extended"] = 0.4 * random.normal(size=200)
    found = compare(frames, "te_x_mm")
    low, high = found["gain_ci95"]
    assert low < found["gain"] < high < 1
    ratio = np.mean(frames["te_x_mm_extended"] ** 2) / np.mean(frames["te_x_mm_null"] ** 2)
    assert found["gain"] == pytest.approx(1 - ratio, abs=1e-3)


def test_a_run_is_simulated_with_models_that_its_specimen_had_no_part_in(monkeypatch):
    case = read_case(CASES / "surrogate_anisotropic")
    every = case.tables["drop_drag_runs"]
    trained: list[set[str]] = []
    shown = []

    def judged(training, *_):
        trained.append(set(training.tables["drop_drag_runs"]["specimen_id"]))
        known = set(training.tables["drop_drag_runs"]["run_id"])
        assert set(training.tables["drop_drag"]["run_id"]) == known
        return {"verdict": "none", "models": {"null": {}, "extended": {"causes": []}}}

    def simulated(part, *_):
        runs = part.tables["drop_drag_runs"]
        assert not trained[-1] & set(runs["specimen_id"])
        shown.extend(runs["run_id"])
        frames = pd.DataFrame({"specimen_id": runs["specimen_id"]})
        for quantity in resimulation.QUANTITIES:
            frames[quantity] = 0.0
            frames[f"{quantity}_null"], frames[f"{quantity}_extended"] = 2.0, 1.0
        return resimulation.Resimulation(frames, {"simulations": {}})

    monkeypatch.setattr(resimulation, "analyse", lambda *_: None)
    monkeypatch.setattr(resimulation, "verdict_of", judged)
    monkeypatch.setattr(resimulation, "resimulate", simulated)
    found = resimulation.resimulate_left_out(case, 1, 100).summary
    assert sorted(shown) == sorted(every["run_id"])
    assert len(found["folds"]) == len(trained) == every["specimen_id"].nunique() == 6
    assert found["all"]["gain"] == pytest.approx(0.75)


def test_runs_without_a_specimen_s_name_are_specimens_of_their_own(monkeypatch):
    case = read_case(CASES / "surrogate_anisotropic")
    runs = case.tables["drop_drag_runs"]
    runs["specimen_id"] = ""
    line_m = np.array([0.0, 1.0])
    model = {"causes": [], "friction_law": {"face": {"coefficient": 0.3, "mechanisms": {}}}}
    shape = TrackedShape(line_m, line_m, line_m, line_m)
    monkeypatch.setattr(resimulation, "extended_model", lambda *_: model)
    monkeypatch.setattr(resimulation, "drag_tracked", lambda *_, **__: shape)
    verdict = {"verdict": "none", "models": {"null": {}, "extended": {"causes": []}}}
    found = resimulation.resimulate(case, verdict).summary
    assert found["all"]["specimens"] == len(runs)
