"""The two verbs, from a case folder to a verdict and to predictions."""

import hashlib
import json
import shutil
from contextlib import redirect_stderr
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from support.criticised import change, change_meta, verdict_on
from support.departures import planted

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import file_digest, read_provenance
from slipstitch.cli.main import main
from slipstitch.criticise.inference import fit
from slipstitch.criticise.prediction import lock, predict_model, read_verdict, score

KEYS = {
    "case",
    "spec_version",
    "about",
    "verdict",
    "causes",
    "alternatives",
    "separate_by",
    "parameters",
    "null",
    "residual_tests",
    "gain",
    "excluded_rows",
    "ranking",
    "seed",
    "code_version",
}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    root = tmp_path_factory.mktemp("verbs")
    for repeat, name in enumerate(("case", "fresh")):
        planted(21, root / name, {"anisotropy": 0.2}, "incline", repeat=repeat)
    (root / "case" / "peel.csv").write_text("force_mN\n3\n")
    arguments = ["criticise", str(root / "case"), "--out", str(root / "verdict.json")]
    with (root / "messages").open("w") as messages, redirect_stderr(messages):
        code = main([*arguments, "--report", str(root / "page.html")])
    assert not code
    return root


def test_the_verdict_has_the_layout_of_the_format(written):
    verdict = json.loads((written / "verdict.json").read_text())
    assert set(verdict) >= KEYS
    assert verdict["verdict"] == "cause" and verdict["causes"] == ["anisotropy"]
    assert verdict["ranking"][0] == {"model": ["anisotropy"], "delta_bic": 0.0}
    low, high = verdict["gain"]["ci95"]
    assert low <= verdict["gain"]["estimate"] <= high
    assert verdict["gain"]["rmse_extended"] < verdict["gain"]["rmse_null"]


def test_a_table_of_no_protocol_is_mentioned_and_written_down(written):
    assert "peel.csv" in (written / "messages").read_text()
    assert json.loads((written / "verdict.json").read_text())["ignored_files"] == ["peel.csv"]


def test_prediction_of_fresh_specimens_is_calibrated_and_gains(written):
    out = written / "predictions.csv"
    assert not main(
        ["predict", str(written / "verdict.json"), str(written / "fresh"), "--out", str(out)]
    )
    rows = pd.read_csv(out)
    assert list(rows) == ["run_id", "quantity", "null_mean", "null_sd", "ext_mean", "ext_sd"]
    found = rows.merge(pd.read_csv(written / "fresh" / "incline.csv"), on="run_id")
    scores = {}
    for model in ("null", "ext"):
        z = (found["angle_deg"] - found[f"{model}_mean"]) / found[f"{model}_sd"]
        scores[model] = (-np.log(found[f"{model}_sd"]) - 0.5 * z**2).median()
    assert 0.5 < z.abs().median() / 0.674 < 1.6
    assert scores["ext"] > scores["null"]


def test_a_prediction_is_locked_before_and_scored_after(written, tmp_path, capsys):
    def criticise(case):
        words = ["criticise", str(written / "case"), "--out", str(tmp_path / "v.json")]
        return main([*words, "--validate", str(case)])

    design = tmp_path / "design"
    shutil.copytree(written / "fresh", design)
    unmeasured(design)
    assert criticise(design) == 0
    assert not (tmp_path / "v.validation.json").exists()
    locked = (tmp_path / "v.prediction.csv").read_bytes()
    # Then it was measured: the same prediction is scored, not a later one.
    assert criticise(written / "fresh") == 0
    assert (tmp_path / "v.prediction.csv").read_bytes() == locked
    found = json.loads((tmp_path / "v.validation.json").read_text())
    assert found["prediction_sha256"] == hashlib.sha256(locked).hexdigest()
    assert found["gain"]["ci95"][0] > 0
    assert found["extended"]["within_95"] > 0.85
    assert found["extended"]["error"]["angle_deg"] < found["null"]["error"]["angle_deg"]
    assert "the extended model predicts better" in capsys.readouterr().out
    # A prediction that was touched is no prediction.
    (tmp_path / "v.prediction.csv").write_bytes(locked.replace(b"1", b"2", 5))
    assert criticise(written / "fresh") == 2
    assert "not the prediction that v.prediction.lock.json locks" in capsys.readouterr().err


@pytest.fixture(scope="module")
def predicted(written, tmp_path_factory):
    """A prediction and its lock, of a campaign whose humidity is not known yet."""
    folder = tmp_path_factory.mktemp("predicted")
    shutil.copytree(written / "fresh", folder / "design")
    unmeasured(folder / "design", rh_pct="")
    lock(read_verdict(written / "verdict.json"), folder / "design", folder / "p.csv")
    return folder


def test_what_was_empty_may_be_recorded_and_runs_may_fail(written, predicted, tmp_path):
    shutil.copytree(written / "fresh", tmp_path / "case")
    table = pd.read_csv(tmp_path / "case/incline.csv", dtype=object).assign(rh_pct=41.5)
    table.sample(frac=1.0, random_state=1).iloc[3:].to_csv(
        tmp_path / "case/incline.csv", index=False
    )
    verdict = read_verdict(written / "verdict.json")
    kept = lock(verdict, tmp_path / "case", predicted / "p.csv")
    found = score(tmp_path / "case", predicted / "p.csv", kept)
    assert 0 < found["readings"] <= len(table) - 3
    assert "runs" not in found


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda case: first_run(case, orientation_deg=17.0), "was predicted with orientation_deg"),
        (lambda case: first_run(case, specimen_id="S99"), "was predicted with specimen_id"),
        (lambda case: first_run(case, run_id="X1"), "run X1 of incline was not predicted"),
        (
            lambda case: change_meta(case, nominal={"rho_kg_m2": 0.123}),
            "its nominal values are others",
        ),
    ],
)
def test_a_prediction_of_one_campaign_is_not_scored_against_another(
    written, predicted, tmp_path, change, words
):
    shutil.copytree(written / "fresh", tmp_path / "case")
    change(tmp_path / "case")
    with pytest.raises(BadInput, match=words) as caught:
        lock(read_verdict(written / "verdict.json"), tmp_path / "case", predicted / "p.csv")
    assert str(caught.value).startswith(f"{predicted / 'p.csv'}: locked for another campaign than ")
    assert "\n" not in str(caught.value)


def test_a_lock_that_does_not_tell_its_campaign_is_refused(written, predicted, tmp_path):
    for name in ("p.csv", "p.lock.json"):
        shutil.copy(predicted / name, tmp_path / name)
    record = json.loads((tmp_path / "p.lock.json").read_text())
    (tmp_path / "p.lock.json").write_text(json.dumps(record | {"runs": None}))
    with pytest.raises(BadInput, match="does not say which campaign it was locked for"):
        lock(read_verdict(written / "verdict.json"), written / "fresh", tmp_path / "p.csv")


@pytest.mark.slow
def test_operators_with_dollars_in_their_names_are_drawn_as_they_are(tmp_path):
    shipped = Path(__file__).parents[2] / "data/cases/paper_on_paper"
    case = Path(shutil.copytree(shipped, tmp_path / "case"))
    change(case / "spring_slider_runs.csv", operator=lambda t: np.where(t.index % 2, "b", "$5_$6_"))
    words = ["--out", str(tmp_path / "v.json"), "--report", str(tmp_path / "v.html")]
    assert not main(["criticise", str(case), *words])
    assert "<!-- $5_$6_ -->" in (tmp_path / "v.html").read_text()


def unmeasured(case, **columns):
    """The design of a case, its cells as they were written."""
    table = pd.read_csv(case / "incline.csv", dtype=object).assign(**columns)
    table.drop(columns=["angle_deg", "censored"]).to_csv(case / "incline.csv", index=False)


def first_run(case, **cells):
    """Other cells in the first run."""
    table = pd.read_csv(case / "incline.csv", dtype=object)
    table.loc[0, list(cells)] = list(cells.values())
    table.to_csv(case / "incline.csv", index=False)


def test_a_fit_that_does_not_converge_gives_one_line_and_no_verdict(
    written, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(fit, "ITERATIONS_MAX", 1)
    assert main(["criticise", str(written / "case"), "--out", str(tmp_path / "v.json")]) == 1
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert "the fit of plain friction did not converge in 1 iterations" in error
    assert not list(tmp_path.iterdir())


def test_the_page_says_the_verdict_first(written):
    page = (written / "page.html").read_text()
    assert "<h1" in page and "warp differs" in page
    assert page.count("<svg") >= 4
    assert "against all covariates" in page
    assert "smallest size seen" in page and "named from" in page


def test_every_file_has_a_record_of_the_measured_data_that_it_was_made_from(written):
    for name in ("verdict.json", "page.html"):
        record = read_provenance(written / name)
        assert record["stage"] == "criticise"
        assert record["config"] == {"replicates": 300, "campaigns": 0}
        assert record["seed"] == 1
        read = {Path(path).name: digest for path, digest in record["inputs"].items()}
        assert read.keys() == {"meta.json", "incline.csv"}  # not the table of no protocol
        assert all(file_digest(written / "case" / name) == digest for name, digest in read.items())


def test_bad_input_is_one_line_and_exit_code_two(tmp_path, capsys):
    assert main(["criticise", str(tmp_path), "--out", str(tmp_path / "v.json")]) == 2
    error = capsys.readouterr().err.strip()
    assert "meta.json" in error and "\n" not in error


def test_a_seed_below_zero_is_refused(written, capsys):
    words = ["criticise", str(written / "case"), "--out", str(written / "v.json"), "--seed", "-1"]
    assert main(words) == 2
    assert "'--seed': -1 is not in the range x>=0" in capsys.readouterr().err


@pytest.mark.filterwarnings("error")
def test_bounds_alone_give_strict_json_without_warnings(written, tmp_path):
    case = tmp_path / "case"
    shutil.copytree(written / "case", case)
    change(case / "incline.csv", censored=1, angle_deg=60.0)
    page = tmp_path / "page.html"
    words = ["--out", str(tmp_path / "v.json"), "--report", str(page), "--replicates", "50"]
    assert not main(["criticise", str(case), *words])

    def refuse(name):
        raise AssertionError(name)

    verdict = json.loads((tmp_path / "v.json").read_text(), parse_constant=refuse)
    assert verdict["verdict"] == "insufficient"
    assert verdict["reason"] == "every reading is only a bound"
    assert verdict["gain"]["estimate"] is None


@pytest.mark.slow
def test_scores_of_left_out_specimens_are_near_those_of_the_models_written_down(tmp_path):
    # An effect far beyond the scatter: the null needs a scatter of its own to predict with.
    planted(21, tmp_path, {"humidity": 0.1, "time_lag": 0.3}, "incline", "drop_drag")
    verdict, analysis = verdict_on(tmp_path)
    measured = analysis.measurements
    assert "time_lag" in verdict["causes"]
    scores = []
    for name in ("null", "extended"):
        mean, sd = predict_model(verdict["models"][name], measured)
        z = (measured.y - mean) / sd
        scores.append(-0.5 * (np.log(2 * np.pi * sd**2) + z**2))
    null, extended = (score[~measured.lower_bound].mean() for score in scores)
    assert verdict["null"]["log_score_per_row"] == pytest.approx(null, abs=0.5)
    assert verdict["gain"]["estimate"] == pytest.approx(extended - null, abs=0.5)
