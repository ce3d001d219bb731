"""A made-up run published: whole, unfinished, and refused."""

import contextlib
import csv
import json
import re
import shutil
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from support import synthetic_results
from support.refusal import refused

from slipstitch.base import provenance
from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import file_digest, write_json, write_sidecar
from slipstitch.cli.main import main
from slipstitch.config import load_config, write_config
from slipstitch.dataset.audit.published import audit_published
from slipstitch.dataset.manifest import read_manifest, write_manifest
from slipstitch.design.grid import simulations
from slipstitch.film.measure import SHIPPED
from slipstitch.physics.simulation.trajectory import read_trajectory
from slipstitch.report.publishing import INDEX, OPTIONAL, SCORES, finished_files, publish

CONFIG = synthetic_results.config(train={"keep_all_views": True})
SHIPS = "ensemble" if len(CONFIG.instrument.seeds) > 1 else "seed0"
SIMULATIONS = simulations(CONFIG)


def content(folder, name):
    return json.loads((folder / name).read_text())


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Every file that a finished run has; weights that are text, with cards and records."""
    folder = tmp_path_factory.mktemp("results")
    with contextlib.chdir(folder.parent):  # records name files by their path from there
        synthetic_results.write_all(CONFIG, folder)
        for render in sorted((folder / "render").glob("m*_v*.parquet")):
            simulated = f"{folder.name}/simulate/{render.stem.rpartition('_')[0]}.parquet"
            inputs = {simulated: file_digest(simulated)}
            write_sidecar(render, {"stage": "render", "inputs": inputs})
    for name in finished_files(CONFIG):
        if name.endswith(".safetensors"):
            train(folder / name)
    evaluate(folder)
    return folder


@pytest.fixture
def results(run, tmp_path):
    """A copy of the run that a test may alter."""
    return Path(shutil.copytree(run, tmp_path / "results"))


def train(weights, content=None):
    """Weights with their card, curve and records."""
    weights.parent.mkdir(parents=True, exist_ok=True)
    weights.write_text(content or f"{weights}\n")
    card, history = weights.with_suffix(".json"), weights.with_name("history.csv")
    write_json(card, {"weights_sha256": file_digest(weights)})
    if not history.exists():
        history.write_text("epoch\n")
    for path in (weights, card, history):
        write_sidecar(path, {"stage": "train"})


def test_a_finished_run_is_published_whole_without_its_images(run, tmp_path):
    out = tmp_path / "published" / "paper"
    with contextlib.chdir(run.parent):
        index = publish(CONFIG, run.name, out)
    assert not index["partial"] and index == content(out, INDEX)
    there = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    assert there - {INDEX, f"{INDEX}.provenance.json"} == set(index["files"])
    assert {*SCORES} < there and all(file_digest(out / n) == d for n, d in index["files"].items())
    calibrated = content(run, "calibrate/calibration.json")
    assert content(out, "calibration.json")["checks"] == calibrated["checks"]
    assert '"runs"' not in (out / "calibration.json").read_text()
    for name, to in finished_files(CONFIG).items():
        if to.endswith("predictions.parquet"):  # stored more compactly
            assert pq.read_table(out / to).equals(pq.read_table(run / name), check_metadata=True)
        elif to in there and to != "calibration.json":
            assert file_digest(out / to) == file_digest(run / name)
    # Of weights those of the model that ships; of the others card, record and training curve.
    assert {name for name in there if name.endswith(".safetensors")} == {
        f"models/{split}/instrument/{SHIPS}/instrument.safetensors" for split in CONFIG.train.splits
    }
    folder = "models/by_video/friction_conditional/seed0"
    assert {path.name for path in (out / folder).iterdir()} == {
        "all_views", "history.csv", "model.json", "model.safetensors.provenance.json",
    }  # fmt: skip
    assert f"{folder}/all_views/model.json" in there
    digests = content(out, "dataset/digests.json")
    rows, digest = read_manifest(run / "sample")
    assert (digests["digest"], digests["videos"]) == (digest, len(rows))
    shards = (run / "sample").glob("m0*.parquet")
    assert digests["files"] == {path.name: file_digest(path) for path in shards}
    lineage = content(out, "dataset/lineage.json")
    assert {f"{run.name}/sample/{name}" for name in digests["files"]} <= set(lineage)
    for name, inputs in lineage.items():
        assert inputs == provenance.read_provenance(run.parent / name)["inputs"]
    assert sum(name.startswith(f"{run.name}/simulate/") for name in lineage) == len(SIMULATIONS)
    assert not {name for name in there if name.startswith("render")}
    assert len(provenance.read_provenance(out / INDEX)["inputs"]) >= len(finished_files(CONFIG))
    cost = {row["stage"]: row for row in content(out, "cost.json")}
    assert cost["simulate"]["jobs"] == 12
    solved = table_of_simulations(out)
    total_s = sum(float(row["cpu_s"]) for row in solved.values())
    assert cost["simulate"]["cpu_s"] == pytest.approx(total_s)
    assert set(solved) == {one.id for one in SIMULATIONS}
    name, first = next(iter(solved.items()))
    one = read_trajectory(run / "simulate" / f"{name}.parquet")
    assert float(first["simulated_s"]) == round(float(one.time_s[-1]), 3)


def table_of_simulations(out):
    with (out / "simulations.csv").open() as file:
        return {row["simulation"]: row for row in csv.DictReader(file)}


def test_the_table_of_simulations_says_what_the_study_knows_of_each_now(run, tmp_path, monkeypatch):
    def known(material, friction, settings):
        assert settings == CONFIG.simulation
        return {"verdict": f"{material} {friction:g}"} if friction > 0.3 else None

    monkeypatch.setattr("slipstitch.report.publishing.measured_convergence", known)
    publish(CONFIG, run, tmp_path / "out")
    solved = table_of_simulations(tmp_path / "out")
    for one in SIMULATIONS:
        wanted = f"{one.material} {one.friction:g}" if one.friction > 0.3 else ""
        assert solved[one.id]["convergence"] == wanted


def test_an_unfinished_run_is_refused_and_marked_if_wanted(results, tmp_path, capsys):
    (results / "evaluate" / "details.json").unlink()
    write_config(CONFIG, tmp_path / "c.json")
    command = f"publish --config {tmp_path}/c.json --results {results} --out-dir {tmp_path}/out"
    said = refused(capsys, command)
    assert "not finished: evaluate/details.json is missing (1 of " in said and "--partial" in said
    assert not (tmp_path / "out").exists()
    assert main(f"{command} --partial".split()) == 0
    assert "partial: 1 lacking" in capsys.readouterr().out
    index = content(tmp_path / "out", INDEX)
    assert index["partial"] and index["missing"] == ["evaluate/details.json"]


def evaluate(results, without=()):
    """The records of an evaluation of all weights, or of all but some, and of the shipped ones."""
    weights = [path for path in results.rglob("*.safetensors") if path not in without]
    inputs = [path.relative_to(results.parent) for path in weights]
    inputs += [f"{results.name}/sample/manifest.parquet", SHIPPED / "instrument.safetensors"]
    with contextlib.chdir(results.parent):
        record = provenance.provenance_record("evaluate", inputs=inputs)
    for name in ("metrics.json", "details.json"):
        write_sidecar(results / "evaluate" / name, record)
    predictions = results / "evaluate" / "predictions.parquet"
    provenance.write_parquet(pq.read_table(predictions), predictions, {}, record)


WEIGHTS = "train/by_video/friction_conditional/seed0/model.safetensors"
CARD = WEIGHTS.replace(".safetensors", ".json")


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        (WEIGHTS, None, "does not match its record"),
        (WEIGHTS, b"no weights", "not the weights that its card model.json describes"),
        (CARD, b"no card", "damaged or not a JSON file"),
        (CARD, b"{}", "must be a mapping, and not empty"),
        (WEIGHTS.replace("model.safetensors", "history.csv"), None, "does not match its record"),
        ("evaluate/metrics.json", b"{}", "must be a mapping, and not empty"),
        ("evaluate/predictions.parquet", None, "not a Parquet file"),
        ("sample/manifest.parquet", None, "not a Parquet file"),
        ("calibrate/calibration.json", None, "does not match its record"),
    ],
)
def test_a_damaged_file_is_not_published(results, tmp_path, name, content, why):
    """One with a bit flipped (None), or with other content and no record."""
    path = results / name
    if content is None:
        whole = path.read_bytes()
        path.write_bytes(whole[:-2] + bytes([whole[-2] ^ 1]) + whole[-1:])
    else:
        path.with_name(f"{path.name}.provenance.json").unlink(missing_ok=True)
        path.write_bytes(content)
    with pytest.raises(BadInput, match=why) as problem:
        publish(CONFIG, results, tmp_path / "out")
    assert name in str(problem.value) and not (tmp_path / "out").exists()


OTHERS = {
    "metrics.json": WEIGHTS,
    "details.json": "instrument/by_video/seed0/instrument.safetensors",
    "predictions.parquet": "sample/manifest.parquet",
}


@pytest.mark.parametrize(("name", "other"), OTHERS.items())
def test_scores_of_another_model_or_dataset_are_refused(run, results, tmp_path, name, other):
    if other.endswith(".parquet"):
        table = pq.read_table(results / other)
        provenance.write_parquet(table, results / other, {"made": "again"})
    else:
        train(results / other, "trained again")
    evaluate(results)
    for older in (run / "evaluate").glob(f"{name}*"):
        shutil.copyfile(older, results / "evaluate" / older.name)
    why = f"{name}: scores of another [^ ]*{other} than is there; run slipstitch evaluate again"
    for partial in (False, True):
        with pytest.raises(BadInput, match=why):
            publish(CONFIG, results, tmp_path / "out", partial)


def test_scores_without_a_record_are_refused(results, tmp_path):
    path = results / "evaluate/predictions.parquet"
    pq.write_table(pq.read_table(path).replace_schema_metadata(None), path)
    for name in ("predictions.parquet", "metrics.json"):
        (results / f"evaluate/{name}.provenance.json").unlink(missing_ok=True)
        with pytest.raises(BadInput, match=f"{name}: has no record of what was evaluated"):
            publish(CONFIG, results, tmp_path / "out", partial=True)


def test_models_trained_after_the_evaluation_are_refused_or_have_no_scores(results, tmp_path):
    out = tmp_path / "out"
    evaluate(results, without=[results / WEIGHTS])
    model = WEIGHTS.replace("train/", "models/")
    with pytest.raises(BadInput, match=f"not include {model}; run slipstitch evaluate again"):
        publish(CONFIG, results, out)
    index = publish(CONFIG, results, out, partial=True)
    assert index["partial"] and index["missing"] == [f"scores of {model}"]
    assert not {one.where for one in audit_published(out).findings} & set(SCORES)


def _contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_only_a_folder_that_was_published_before_is_replaced(run, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    publish(CONFIG, run, out)
    (out / "metrics.json").write_text("older")
    publish(CONFIG, run, out)
    assert file_digest(out / "metrics.json") == file_digest(run / "evaluate" / "metrics.json")

    mine, books = tmp_path / "mine", tmp_path / "books"
    for path in (out / "notes.txt", mine / "letter.txt", books / INDEX):
        path.parent.mkdir(exist_ok=True)
        path.write_text('["Persuasion"]')
    with pytest.raises(BadInput, match="nothing of a run in it"):
        publish(CONFIG, mine, tmp_path / "new", partial=True)
    (tmp_path / "link").symlink_to(mine)
    before = _contents(tmp_path)
    for target, why in (
        (out, "also holds notes.txt"),
        (mine, "holds no published run"),
        (books, "holds no published run"),
        (mine / "letter.txt", "is not a folder"),
        (tmp_path / "link", "is not a folder"),
    ):
        with pytest.raises(BadInput, match=why):
            publish(CONFIG, run, target)
    assert _contents(tmp_path) == before


def test_nothing_is_published_in_the_place_of_results(results, tmp_path):
    """Not even where a stage has not run yet, or where somebody has put an index."""
    shutil.rmtree(results / "criticise")
    for folder in (tmp_path, results, results / "train"):
        (folder / INDEX).write_text('{"files": {}}')
    before = _contents(tmp_path)
    stages = ("train", "evaluate/published", "benchmarks", "criticise")
    for place in (".", "..", *stages):
        why = "part of the results" if place in stages else "contains the results"
        with pytest.raises(BadInput, match=why):
            publish(CONFIG, results, results / place)
    assert _contents(tmp_path) == before
    assert publish(CONFIG, results, results / "published" / "paper")["files"]


def test_the_workflow_publishes_again_when_an_optional_file_changes():
    rule = (Path(__file__).parents[2] / "rules" / "publish.smk").read_text()
    tracked = rule.partition("optional=digests_if_there(")[2].partition(")")[0]
    assert set(re.findall(r'"results/([a-z]+/[a-z.]+)"', tracked)) == set(OPTIONAL)


def test_an_update_keeps_what_the_results_have_no_longer(run, tmp_path):
    """As when something was evaluated again after the images had been deleted."""
    results, out = tmp_path / run.name, tmp_path / "out"
    with contextlib.chdir(run.parent):
        before = publish(CONFIG, run.name, out)
    kept = {name: (out / name).read_bytes() for name in before["files"]}
    found = audit_published(out).findings  # weights that are text have no dataset
    shutil.copytree(run, results)
    for stage in ("simulate", "render", "calibrate"):
        shutil.rmtree(results / stage)
    for shard in list((results / "sample").glob("m0*.parquet"))[1:]:
        shard.unlink()
    train(results / WEIGHTS, "trained again")
    evaluate(results)
    with contextlib.chdir(tmp_path):
        after = publish(CONFIG, results.name, out, update=True)
    assert set(after["files"]) == set(kept) and not after["partial"]
    changed = {name for name, content in kept.items() if (out / name).read_bytes() != content}
    model = WEIGHTS.replace("train/", "models/")
    assert {f"{model}.provenance.json", model.replace("safetensors", "json")} <= changed
    kept_whole = ("calibration.json", "simulations.csv", "cost.json", "dataset/")
    assert not [name for name in changed if name.startswith(kept_whole)]
    assert set(content(out, "origin.json")) == set(json.loads(kept["origin.json"]))
    assert audit_published(out).findings == found


@pytest.mark.parametrize("same", [True, False])
@pytest.mark.parametrize("rendered", [True, False])
def test_an_update_takes_the_same_images_in_other_files(run, tmp_path, same, rendered):
    """As when the simulations were filmed again where another network was trained.

    What the images were made from stays known when the renders have been deleted since.
    """
    results, out = tmp_path / run.name, tmp_path / "out"
    shutil.copytree(run, results)
    weights, manifest = results / WEIGHTS, f"{run.name}/sample/manifest.parquet"
    rows, digest = read_manifest(results / "sample")
    card = {"weights_sha256": file_digest(weights), "dataset_digest": digest if same else "another"}
    with contextlib.chdir(tmp_path):
        record = provenance.provenance_record("train", inputs=[manifest])
        write_json(weights.with_suffix(".json"), card, record)
        write_sidecar(weights, record)
        publish(CONFIG, run.name, out)
        found = audit_published(out).findings  # weights that are text have no dataset
        lineage = content(out, "dataset/lineage.json")
        before = file_digest(manifest)
        write_manifest(rows, results / "sample", {"stage": "sample", "wall_s": 1.0})
        assert file_digest(manifest) != before
        evaluate(results)
        shutil.rmtree(weights.parent)  # on the first machine
        if not rendered:
            shutil.rmtree(results / "render")
        assert not publish(CONFIG, run.name, out, update=True)["partial"]
    assert all(any(folder.iterdir()) for folder in out.rglob("*") if folder.is_dir())
    digests = content(out, "dataset/digests.json")
    shards = (results / "sample").glob("m0*.parquet")
    assert digests["digest"] == digest
    assert digests["files"] == {path.name: file_digest(path) for path in shards}
    assert content(out, "dataset/lineage.json") == lineage
    new = [one for one in audit_published(out).findings if one not in found]
    assert [(one.where, one.what) for one in new] == (
        []
        if same
        else [(f"models/{WEIGHTS.removeprefix('train/')}",
               "made from another manifest.parquet than the published")]
    )  # fmt: skip


def test_a_dataset_that_also_calibrates_is_published_beside_the_run_s_own(run, tmp_path):
    other = f"bench/{run.name}/sample"  # beside the run's results
    instrument = CONFIG.instrument.model_copy(update={"calibration_datasets": [other]})
    config = CONFIG.model_copy(update={"instrument": instrument})
    shutil.copytree(run, tmp_path / run.name)
    out, place = tmp_path / "out", tmp_path / "out" / "calibration_datasets" / "0"
    with contextlib.chdir(tmp_path):
        publish(CONFIG, run.name, out)
        with pytest.raises(BadInput, match=r"calibration_datasets/0/manifest\.parquet is missing"):
            publish(config, run.name, out, update=True)
        shutil.copytree(run, tmp_path / "bench" / run.name)
        # It may be added to what is published: all else stays as it was.
        index = publish(config, run.name, out, update=True)
    assert not index["partial"]
    assert load_config(out / "config.json").instrument.calibration_datasets == [other]
    own = content(out, "dataset/digests.json")
    assert content(place, "digests.json") == own
    assert file_digest(place / "manifest.parquet") == file_digest(run / "sample/manifest.parquet")
    lineage = content(place, "lineage.json")
    assert {f"{run.name}/sample/{name}" for name in own["files"]} <= set(lineage)
    # The scores are of the run's own dataset alone: here it has the same manifest, so another one.
    table = pq.read_table(place / "manifest.parquet")
    pq.write_table(table, place / "manifest.parquet", compression="none")
    assert not [one for one in audit_published(out).findings if one.where in SCORES]
    shutil.copy(run / "sample" / "manifest.parquet", place)
    shutil.rmtree(tmp_path / "bench")
    with contextlib.chdir(tmp_path):
        assert not publish(config, run.name, out, update=True)["partial"]
    assert (place / "manifest.parquet").is_file()


@pytest.mark.parametrize("filmed", ["before", "again", "as before"])
def test_scores_of_captures_stand_beside_the_settings_that_these_were_filmed_with(
    run, tmp_path, filmed
):
    """Not beside others, with which nothing was filmed yet; all else may be updated."""
    results, out = tmp_path / run.name, tmp_path / "out"
    shutil.copytree(run, results)
    scores = results / "captures" / "metrics.json"
    write_json(scores, {"before": {}}, {"stage": "evaluate"})
    publish(CONFIG, results, out)
    if filmed == "again":
        write_json(scores, {"again": {}}, {"stage": "evaluate"})
    else:
        shutil.rmtree(scores.parent)
    other = CONFIG.captures.model_copy(update={"repeats": CONFIG.captures.repeats + 1})
    update = {} if filmed == "as before" else {"captures": other}
    publish(CONFIG.model_copy(update=update), results, out, update=True)
    kept = {"before": [], "again": ["again"], "as before": ["before"]}[filmed]
    assert [*content(out, INDEX)["files"]].count("captures/metrics.json") == len(kept)
    assert not kept or [*content(out, "captures/metrics.json")] == kept
    assert (load_config(out / "config.json").captures == other) == (filmed != "as before")


def test_an_update_of_another_run_is_refused(run, results, tmp_path):
    out = tmp_path / "out"
    with pytest.raises(BadInput, match="nothing published there to update"):
        publish(CONFIG, run, out, update=True)
    publish(CONFIG, run, out)
    before = _contents(out)
    other = CONFIG.model_copy(update={"seed": CONFIG.seed + 1})
    with pytest.raises(BadInput, match="published with another configuration"):
        publish(other, run, out, update=True)
    rows, _ = read_manifest(results / "sample")
    write_manifest([row | {"floor": "ceramic"} for row in rows], results / "sample", {})
    with pytest.raises(BadInput, match="published of another dataset"):
        publish(CONFIG, results, out, update=True)
    assert _contents(out) == before
