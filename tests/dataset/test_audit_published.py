"""Published folders audited: as published, altered, and with what their images were made from."""

import json
import shutil
from pathlib import Path

import pytest
from support.refusal import refused, run

from slipstitch.base.provenance import file_digest, read_metadata, write_json
from slipstitch.dataset.audit.published import audit_published
from slipstitch.dataset.manifest import read_manifest, write_manifest
from slipstitch.film.measure import SHIPPED
from slipstitch.report.publishing import INDEX, SCORES

PUBLISHED = Path(__file__).parents[2] / "results/published/instrument"
MODELS = "models/by_simulation/instrument"
AVERAGE = f"{MODELS}/ensemble/instrument.safetensors"
LINEAGE, DIGESTS = "dataset/lineage.json", "dataset/digests.json"
WEIGHTS = f"{MODELS}/seed0/instrument.safetensors"


@pytest.fixture
def folder(tmp_path):
    return shutil.copytree(PUBLISHED, tmp_path / "published")


def content(folder, name):
    return json.loads((folder / name).read_text())


def listed(folder):
    """The folder with an index of the files that it holds now, as a forger would write it."""
    index = content(folder, INDEX)
    names = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    names -= {INDEX, f"{INDEX}.provenance.json"}
    index["files"] = {name: file_digest(folder / name) for name in sorted(names)}
    write_json(folder / INDEX, index, {"stage": "publish"})
    return folder


def audited(folder, code):
    assert run(f"audit {folder} --json {folder.parent}/audit.json") == code
    return content(folder.parent, "audit.json")


def with_lineage(folder, change=lambda lineage: None):
    """The folder with a record of every file of images, render and simulation."""
    lineage = {}
    for name in content(folder, DIGESTS)["files"]:
        render = f"results/render/{name}"
        lineage[f"results/sample/{name}"] = {render: "a" * 64}
        lineage[render] = {f"results/simulate/{name}": "b" * 64}
    change(lineage)
    write_json(folder / LINEAGE, lineage)
    return listed(folder)


def test_a_model_is_followed_to_the_digests_of_its_simulations(folder, capsys):
    told = audited(with_lineage(folder), 0)
    assert (told["verdict"], told["findings"]) == ("intact", [])
    shipped, member, *_ = told["models"]
    assert (shipped["weights"], shipped["shipped"]) == (AVERAGE, True)
    assert (member["weights"], member["shipped"]) == (WEIGHTS, False)
    # An average is of what its members are of.
    assert member["shards"] == shipped["shards"]
    record = content(folder, f"{member['weights']}.provenance.json")
    trained_on = {Path(name).name for name in record["inputs"]} - {"manifest.parquet"}
    assert set(shipped["simulations"]) == {f"results/simulate/{name}" for name in trained_on}
    assert set(shipped["simulations"].values()) == {"b" * 64}
    said = capsys.readouterr().out
    for part in (
        f"from the digests of {len(trained_on)} simulations",
        "the instrument that ships",
        "they were compared with each other, not with files",
        "the audit finds accidents, not whoever made all files agree",
        "what stretches the intervals was read of videos that are not published",
    ):
        assert part in said


@pytest.mark.parametrize("name", ["instrument", "paper"])
def test_what_is_published_is_intact(name):
    """Also networks that another one tells the fabric."""
    audit = audit_published(PUBLISHED.with_name(name))
    assert (audit.verdict, audit.findings) == ("intact", [])
    assert all(len(chain.shards) >= 144 for chain in audit.chains)


def test_a_score_that_its_predictions_do_not_give_is_found(folder, capsys):
    audited(folder, 0)
    assert "scores not compared with the predictions" in capsys.readouterr().out  # earlier ones
    scores = content(folder, "metrics.json")
    assert audit_published(folder, recompute=lambda path: scores).verdict == "intact"
    (split, rows), *_ = scores.items()
    model = next(iter(rows))
    changed = scores | {split: rows | {model: rows[model] | {"mean_absolute_error": 0.001}}}
    (folder / "metrics.json.provenance.json").unlink()
    write_json(folder / "metrics.json", changed)
    (found,) = audit_published(listed(folder), recompute=lambda path: scores).findings
    assert (found.kind.value, found.where) == ("broken chain", "metrics.json")
    given = f"its predictions give {rows[model]['mean_absolute_error']}"
    assert found.what == f"{split} {model} mean_absolute_error is 0.001, {given}"


def test_models_hold_where_the_same_images_were_filmed_again(folder):
    """Networks, and what calibrates their average; the scores are to be updated."""
    rows, _ = read_manifest(folder / "dataset")
    write_manifest(rows, folder / "dataset", {"stage": "sample", "wall_s": 1.0})
    digests = content(folder, DIGESTS)
    files = dict.fromkeys(digests["files"], "0" * 64)
    write_json(folder / DIGESTS, digests | {"files": files}, {"stage": "publish"})
    found = audit_published(listed(folder)).findings
    assert sorted(one.where for one in found) == sorted(SCORES)


def test_without_its_lineage_the_chain_ends_at_the_images(folder, capsys):
    (folder / LINEAGE).unlink(missing_ok=True)
    told = audited(listed(folder), 0)
    assert told["models"][0]["shards"] and not told["models"][0]["simulations"]
    assert "the chain ends at the files of images" in capsys.readouterr().out


def notes_of(folder, start):
    return [note for note in audited(folder, 0)["notes"] if note.startswith(start)]


def test_what_the_run_lacks_and_what_was_added_is_said_and_no_damage(folder):
    index = content(folder, INDEX) | {"missing": ["train/a", "train/b", "scores of models/a"]}
    write_json(folder / INDEX, index, {"stage": "publish"})
    for name in (".DS_Store", "more.txt"):
        (folder / name).write_text("theirs")
    lacks = "partial: 3 parts of the run are missing: train/a and 2 more"
    added = "not part of what was published, not looked at: .DS_Store, more.txt"
    assert [*notes_of(folder, "partial"), *notes_of(folder, "not part")] == [lacks, added]


def test_commits_and_stages_of_other_code_are_said_and_no_damage(folder, monkeypatch):
    """Of published files, and of those that only origin.json tells of."""
    (said,) = notes_of(folder, "made by the code of commit")
    assert "1f0c485aa741 (calibrate.calibration, simulate), " in said
    assert "b869f46e348f (evaluate, instrument), " in said
    assert "e13b32064db0 (instrument, render, sample)" in said

    def recorded(stage, *_):
        records = [json.loads(path.read_text()) for path in PUBLISHED.rglob("*.provenance.json")]
        records += content(PUBLISHED, "origin.json").values()
        records += [read_metadata(PUBLISHED / "dataset/manifest.parquet")["provenance"]]
        return next(one["code_digest"] for one in records if one["stage"] == stage)

    monkeypatch.setattr("slipstitch.dataset.release.currency.current_digest", recorded)
    # The trainings are older than their average: one of the two is always of other code.
    other = "made by other code or libraries than those that audit: instrument"
    assert notes_of(folder, "made by other code") == [other]
    origin = content(folder, "origin.json")
    origin["simulate/m00_f0000_r00.parquet"]["code_digest"] = "0" * 64
    write_json(folder / "origin.json", origin | {"other": [], "odd": {"stage": "../simulate"}})
    assert notes_of(listed(folder), "made by other code") == [f"{other}, simulate"]


def edited(name, old, new):
    """A function that replaces a text in a file of the folder once."""

    return lambda one: (one / name).write_text((one / name).read_text().replace(old, new, 1))


def rewritten(name, change):
    """A function that changes the content of a JSON file of the folder."""

    def edit(folder):
        whole = content(folder, name)
        change(whole)
        write_json(folder / name, whole)

    return edit


def copied(source, name):
    return lambda folder: shutil.copy(source, folder / name)


def _swap_model(folder):
    """A model, with its card and records, for one that was not evaluated."""
    for path in (folder / MODELS / "seed1").iterdir():
        shutil.copy(path, folder / MODELS / "seed0" / path.name)


def without_a_shard(lineage):
    del lineage[max(name for name in lineage if "/sample/" in name)]


RECORD, DETAILS = f"{WEIGHTS}.provenance.json", "details.json"
OTHER = {"results/sample/manifest.parquet": "0" * 64}
#: What is changed, whether the index is renewed, and what is found: kind, place, words.
CHANGED = [
    (lambda folder: (folder / "metrics.json").unlink(), False,
     "missing", "metrics.json", "listed in published.json"),
    (edited("config.json", "0", "1"), False,
     "altered", "config.json", "not the file listed in published.json"),
    (edited(DETAILS, "0.", "0.0"), True,
     "broken chain", DETAILS, "not the file that its record"),
    (copied(SHIPPED / "instrument.json", f"{MODELS}/seed0/instrument.json"), True,
     "broken chain", WEIGHTS, "not the weights that their card describes"),
    (rewritten(RECORD, lambda one: one.update(sha256=[1])), True,
     "broken chain", WEIGHTS, "not the weights that their card describes"),
    (_swap_model, True,
     "broken chain", "metrics.json", "another instrument.safetensors than the"),
    (_swap_model, True,
     "broken chain", AVERAGE, "another instrument.safetensors than the published"),
    (rewritten(f"{DETAILS}.provenance.json", lambda one: one["inputs"].update(OTHER)), True,
     "broken chain", DETAILS, "another manifest.parquet than the"),
    (copied(PUBLISHED.with_name("paper") / "predictions.parquet", "predictions.parquet"),
     True, "broken chain", "predictions.parquet", "another manifest"),
    (lambda folder: (folder / RECORD).unlink(), True,
     "broken chain", WEIGHTS, "has no record of what it was trained on"),
    (rewritten(DIGESTS, lambda one: one["files"].update({min(one["files"]): "0" * 64})), True,
     "broken chain", WEIGHTS, "made from another m0"),
    (rewritten(DIGESTS, lambda one: one.update(digest="0" * 64)), True,
     "broken chain", DIGESTS, "is of another dataset than"),
    (lambda folder: with_lineage(folder, without_a_shard), True,
     "broken chain", LINEAGE, "does not say what"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "renewed", "kind", "where", "what"), CHANGED)
def test_what_was_changed_is_named(folder, change, renewed, kind, where, what):
    change(folder)
    told = audited(listed(folder) if renewed else folder, 1)
    assert told["verdict"] == "damaged"
    found = [(one["kind"], one["where"], one["what"]) for one in told["findings"]]
    assert any(k == kind and w.endswith(where) and what in why for k, w, why in found), found


def test_an_index_whose_list_of_what_is_missing_is_none_stops_no_audit(folder):
    rewritten(INDEX, lambda one: one.update(missing=5))(folder)
    assert audited(listed(folder), 0)["verdict"] == "intact"


def test_an_index_that_is_none_and_options_of_a_release_are_refused_in_one_line(folder, capsys):
    for words in ("--explain clip", "--page audit.html"):
        said = refused(capsys, f"audit {folder} {words}")
        assert "cannot be combined with a published folder" in said
    for name, text in ((f"{INDEX}.provenance.json", "[]"), (INDEX, "{")):
        (folder / name).write_text(text)
        assert name in refused(capsys, f"audit {folder}")
