"""Trained networks go through the tables: every number can be recomputed from the predictions."""

import contextlib
import io
import json
import shutil
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from support import synthetic_videos
from support.models import train_networks
from support.refusal import refused, run

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import file_digest, read_provenance
from slipstitch.config import write_config
from slipstitch.config.train import REFLECTIVE, TRAINED_ON
from slipstitch.dataset.dataset import write_dataset
from slipstitch.dataset.manifest import read_manifest, write_manifest
from slipstitch.dataset.videos import read_videos
from slipstitch.design.grid import friction_id
from slipstitch.film.measure import SHIPPED
from slipstitch.film.measure.measuring_bench import shipped_for
from slipstitch.learning.evaluation.evaluation import Table, write_evaluation
from slipstitch.learning.evaluation.metrics import FIELDS
from slipstitch.learning.evaluation.scores import network_of, recomputed
from slipstitch.learning.evaluation.test_sets import PREFIX, wrong_inputs
from slipstitch.learning.evaluation.trained import Trained
from slipstitch.learning.instrument.ensemble import combine_instruments, recalibrate_instrument
from slipstitch.learning.instrument.training import train_instrument
from slipstitch.learning.lrcn import load_model
from slipstitch.learning.trainer import Run

CONFIG = synthetic_videos.config(
    grid={"test_frictions": [0.35], "test_materials": ["royal-target"]},
    instrument={"channels": [8, 16], "epochs": 2, "plateau_margin": None, "draws": 1},
    render={
        "test_textures": ["chevron"],
        "test_viewpoints": ["calibrated_-15", "calibrated_+5"],
        "test_viewpoint_videos": 5,
        "reflective_floors": ["ceramic"],
    },
    train={"splits": list(TRAINED_ON), "epochs_per_cycle": 8, "plateau_margin": None},
)
KEPT = "by_video"
FINE_TUNED = ["lrcn_baseline_calibrated", "lrcn_conditional_calibrated"]


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """A dataset with test-only textures, views and floors, and all networks."""
    folder = tmp_path_factory.mktemp("chain")
    synthetic_videos.write_dataset(CONFIG, folder)
    for split in TRAINED_ON:
        # Of one split the networks before fine-tuning too; of another they are to learn something.
        changes = {"keep_all_views": split == KEPT}
        if split != "by_simulation":
            changes["epochs_per_cycle"] = 1
        train = CONFIG.train.model_copy(update=changes)
        train_networks(CONFIG.model_copy(update={"train": train}), folder, split)
        if split == REFLECTIVE:
            continue
        train_instrument(
            CONFIG.instrument,
            Run(folder / "sample", split, 0, folder / "instrument" / split / "seed0", 6),
            ["calibrated"],
        )
    return folder


@pytest.fixture(scope="module")
def evaluated(chain):
    """What the command writes, and what it says, in said.txt."""
    write_config(CONFIG, chain / "c.json")
    command = "evaluate --config c.json --dataset sample --models train --instruments instrument"
    out = "--out evaluate/metrics.json --predictions evaluate/predictions.parquet"
    with contextlib.chdir(chain), contextlib.redirect_stdout(io.StringIO()) as said:
        assert run(f"{command} {out}") == 0
    (chain / "said.txt").write_text(said.getvalue())
    return chain / "evaluate"


@pytest.fixture(scope="module")
def metrics(evaluated):
    return content(evaluated / "metrics.json")


@pytest.fixture(scope="module")
def details(evaluated):
    return content(evaluated / "details.json")


@pytest.fixture(scope="module")
def said(evaluated):
    """Predictions by test set, network and video."""
    found: dict = {}
    for row in predictions(evaluated / "predictions.parquet"):
        found.setdefault((row["split"], row["network"]), {})[row["video"]] = row
    return found


def with_seeds(config, seeds, *sections):
    """The configuration with other seeds in some sections."""
    changed = {name: getattr(config, name).model_copy(update={"seeds": seeds}) for name in sections}
    return config.model_copy(update=changed)


def evaluate(chain, trained, out, **options):
    names = ("metrics.json", "predictions.parquet", "details.json")
    outputs = tuple(out / name for name in names)
    return write_evaluation(chain / "sample", trained, outputs, **options)


def content(path):
    return json.loads(path.read_text())


def predictions(path):
    """Rows of the table but those of probes."""
    rows = pq.read_table(path).to_pylist()
    return [row for row in rows if not row["network"].startswith(PREFIX)]


def test_the_metrics_have_the_splits_models_and_fields_that_were_agreed(evaluated, metrics):
    told = (evaluated.parent / "said.txt").read_text()
    assert "by_simulation lrcn_conditional 8" in " ".join(told.split())
    for split, models in metrics.items():
        # Of the split by video, the instrument's viewpoint may have no test video.
        probed = {model for model in models if model.startswith(PREFIX)}
        assert bool(probed) == (split in TRAINED_ON)
        models = {model: row for model, row in models.items() if model not in probed}
        assert list(models)[:2] == ["lrcn_baseline", "lrcn_conditional"]
        others = [model for model in list(models)[2:] if model not in FINE_TUNED]
        assert others == ["instrument"] or split in ("by_video", "reflective_floors", REFLECTIVE)
        for model, row in models.items():
            assert tuple(row) == FIELDS
            known = "conditional" not in model and split != "unseen_fabric"
            assert (row["material_top1"] is not None) == known
            assert row["seeds"] == [0]
            assert (row["coverage_90"] is None) == (model != "instrument")
    # 8 simulations, 2 + 1 textures, 2 + 2 views; 32 trainable videos, 3 of them test by video;
    # by simulation 1 of the 2 held out of each friction tests: 2 simulations of 4 videos.
    assert [(split, models["lrcn_baseline"]["n"]) for split, models in metrics.items()] == [
        ("by_video", 3),
        ("by_simulation", 8),
        ("off_grid", 8),
        ("unseen_texture", 16),
        ("unseen_fabric", 8),
        ("view_-15", 5),  # drawn, as in the paper
        ("view_+5", 5),
        ("reflective_floors", 3),  # those of by_video on the other floor
        ("by_video_reflective", 3),
    ]


def test_fine_tuned_networks_count_in_the_calibrated_view_those_before_in_all(chain, metrics, said):
    """And both in views that are turned from the calibrated one, by predictions of their own."""
    for split, models in metrics.items():
        found = [model for model in models if model in FINE_TUNED]
        of_kept = split not in ("by_simulation", "off_grid", "unseen_fabric", REFLECTIVE)
        assert found == (FINE_TUNED if of_kept else [])
        for fine_tuned in found:
            network = network_of(fine_tuned)
            before = said[split, network.removesuffix("_calibrated")]
            views = {"calibrated", split.replace("view_", "calibrated_")}
            own = {video for video, row in before.items() if row["viewpoint"] in views}
            assert set(said.get((split, network), ())) == own
            assert models[fine_tuned]["n"] == len(own)
    # The conditional ones are told the material by the network before fine-tuning.
    folder = chain / "train" / KEPT
    material = load_model(folder / "material_baseline/seed0/all_views")
    videos = read_videos(chain / "sample", lambda row: row["viewpoint"] == "calibrated_+5")
    for ending, place in (("", "all_views"), ("_calibrated", ".")):
        model = load_model(folder / "friction_conditional/seed0" / place)
        shares = replace(model, material=material).probabilities(videos)
        of_video = dict(zip((row["video"] for row in videos.rows), shares, strict=True))
        for video, row in said["view_+5", f"friction_conditional{ending}"].items():
            assert row["probabilities"] == pytest.approx(of_video[video], abs=1e-6)


def test_the_tables_follow_from_the_predictions(evaluated, metrics, details, said):
    for kind, split in product(("baseline", "conditional"), metrics):
        model, network = f"lrcn_{kind}", f"friction_{kind}"
        chosen = list(said.get((split, network), {}).values())
        if not chosen:  # no such network on reflective floors
            assert (split, network) == (REFLECTIVE, "friction_baseline")
            continue
        error = np.array([row["predicted_value"] - row["true_value"] for row in chosen])
        right = np.mean(abs(error) < 0.05)
        assert metrics[split][model]["friction_lt_0.1"] == pytest.approx(right)
        assert metrics[split][model]["n"] == len(chosen)
        for view, scores in details[split][network]["viewpoints"].items():
            seen = np.array([row["viewpoint"] == view for row in chosen])
            mean = np.mean(abs(error[seen]) < 0.05)
            assert scores["mean"]["friction_lt_0.1"] == pytest.approx(mean)
            assert (scores["n"], scores["spread"]) == (seen.sum(), None)
        counts = details[split][network]["confusion"]
        assert (counts is None) == (split == "off_grid")
        if counts is not None:
            assert np.trace(counts) / np.sum(counts) == pytest.approx(right)
    for name in ("metrics.json", "details.json", "predictions.parquet"):
        record = read_provenance(evaluated / name)
        assert record["stage"] == "evaluate" and len(record["inputs"]) == 1 + 2 * (8 + 3) + 2
    for videos in said.values():
        for row in videos.values():
            shares = row["probabilities"]
            assert sum(shares) == pytest.approx(1.0, abs=5e-7 * len(shares))
            assert shares == np.round(shares, 6).tolist()
    assert recomputed(evaluated / "predictions.parquet") == metrics
    tested = said["by_simulation", "friction_baseline"].values()
    manifest = pq.read_table(evaluated.parent / "sample" / "manifest.parquet").to_pylist()
    trained = {row["simulation"] for row in manifest if row["split_by_simulation"] == "train"}
    assert not {row["simulation"] for row in tested} & trained
    # Networks beat chance on them.
    entry = details["by_simulation"]["friction_baseline"]
    assert entry["chance"]["uniform"] == entry["chance"]["majority"] == 0.5
    assert entry["mean"]["friction_lt_0.1"] > 0.5
    assert entry["mean"]["mean_absolute_error"] < entry["chance"]["mean_absolute_error"]


def test_the_instruments_rows_follow_from_its_predictions(metrics, details, said):
    entry = metrics["by_simulation"]["instrument"]
    rows = list(said["by_simulation", "instrument"].values())
    assert {row["viewpoint"] for row in rows} == {"calibrated"}
    assert entry["n"] == len(rows) == 4
    errors = [abs(row["predicted_value"] - row["true_value"]) for row in rows]
    assert entry["mean_absolute_error"] == pytest.approx(np.mean(errors))
    # True and predicted are ids of coefficients, as the networks' are; the fabric has a column.
    grid = {friction_id(friction): friction for friction in CONFIG.grid.frictions}
    for row in rows:
        assert row["true_value"] == pytest.approx(grid[row["true"]])
        nearest = min(grid, key=lambda name, row=row: abs(grid[name] - row["predicted_value"]))
        assert row["predicted"] == nearest
        assert row["likeliest_material"] in CONFIG.grid.materials
    covered = [row["low"] <= row["true_value"] <= row["high"] for row in rows]
    assert entry["coverage_90"] == pytest.approx(np.mean(covered))
    alarms = details["by_simulation"]["instrument"]["alarms"]["0"]
    assert alarms["good"] == np.mean([row["alarm"] != "" for row in rows])
    assert {"reversed", "protocol", "empty", "object", "viewpoint"} <= set(alarms)


def test_wrong_inputs_are_what_they_are_called():
    # Grey floor that grows brighter downwards, a red cloth that moves across it.
    videos = np.zeros((3, 8, 32, 32, 3), np.uint8)
    floor = (np.arange(32) * 4 + 40)[:, None, None]
    videos[:] = floor
    for frame in range(8):
        videos[:, frame, 8:20, 3 * frame : 3 * frame + 8] = (200, 30, 40)
    made = wrong_inputs(videos)
    assert np.array_equal(made["reversed"][:, 0], videos[:, -1])
    assert np.array_equal(made["protocol"][:, 7], videos[:, 3])
    assert np.array_equal(made["upside_down"][:, :, 0], videos[:, :, -1])
    assert abs(made["empty"].astype(int) - floor).max() <= 6
    changed = (made["object"] != made["empty"]).any(-1)
    assert changed[:, :, 14:18, 14:18].all() and not changed[:, :, :6].any()


def test_models_of_an_earlier_configuration_do_not_count(chain):
    def found(**changes):
        train = CONFIG.train.model_copy(update=changes)
        config = CONFIG.model_copy(update={"train": train})
        return {split for split, _, _ in Trained(config, chain / "train").load()}

    assert found() == set(TRAINED_ON)
    assert found(splits=["by_video"]) == {"by_video"}
    with pytest.raises(BadInput, match="no models found"):
        found(seeds=[7], splits=["by_video"])


def test_models_that_do_not_belong_together_or_to_the_dataset_are_refused(chain, tmp_path):
    source = chain / "train" / "by_video" / "friction_baseline" / "seed0"
    shutil.copytree(source, tmp_path / "moved" / "by_simulation" / "friction_baseline" / "seed0")
    shutil.copytree(chain / "train", tmp_path / "untold")
    shutil.rmtree(tmp_path / "untold" / "by_video" / "material_baseline")
    for folder, problem in (
        ("empty", "no models found"),
        ("moved", "does not match its folder"),
        ("untold", "has no matching material_baseline"),
    ):
        with pytest.raises(BadInput, match=problem):
            Trained(CONFIG, tmp_path / folder).load()
    sample = CONFIG.sample.model_copy(update={"test_fraction": 0.3})
    shards = sorted((chain / "render").glob("*.parquet"))
    write_dataset(CONFIG.model_copy(update={"sample": sample}), shards, tmp_path / "sample")
    with pytest.raises(BadInput, match="was not trained on"):
        evaluate(tmp_path, Trained(CONFIG, chain / "train"), tmp_path)


def test_the_shipped_instrument_predicts_for_the_calibrated_view_of_its_protocol(tmp_path):
    protocol = {"simulation": {"frames": 300}, "sample": {"frames": 30}}
    config = synthetic_videos.config(
        **protocol, render={"textures": ["stripes"]}, train={"splits": ["by_simulation"]}
    )
    assert shipped_for(config) == SHIPPED
    shards = synthetic_videos.write_shards(config, tmp_path / "render")
    write_dataset(config, shards, tmp_path / "sample")
    evaluate(tmp_path, Trained(config, shipped=shipped_for(config)), tmp_path)
    rows = predictions(tmp_path / "predictions.parquet")
    assert {row["network"] for row in rows} == {"instrument_shipped"}
    assert {row["viewpoint"] for row in rows} == {"calibrated"}
    assert all(row["alarm"] for row in rows)  # rectangles are no cloth
    metrics = content(tmp_path / "metrics.json")
    assert metrics["by_simulation"]["instrument_shipped"]["n"] == len(rows)
    for other in ({"simulation": {"frames": 200}}, {"render": {"viewpoints": ["side"]}}):
        assert shipped_for(synthetic_videos.config(sample={"frames": 30}, **other)) is None


@pytest.mark.slow
def test_instruments_alone_are_evaluated_by_camera_fabric_and_coefficient(tmp_path):
    config = synthetic_videos.config(
        instrument={"channels": [8, 16], "epochs": 2, "plateau_margin": None, "draws": 1},
        render={"viewpoints": ["calibrated", "bench_1"]},
        train={"splits": ["by_simulation"]},
    )
    synthetic_videos.write_dataset(config, tmp_path)
    trained = Path("instrument/by_simulation/seed0/instrument.safetensors")
    members = [tmp_path / f"instrument/by_simulation/seed{seed}" for seed in (0, 1)]
    for seed, member in enumerate(members):
        run = Run(tmp_path / "sample", "by_simulation", seed, member, 6)
        train_instrument(config.instrument, run, ["calibrated", "bench_1"])
    left_over = tmp_path / "instrument/by_simulation/seed7" / trained.name
    left_over.parent.mkdir()
    left_over.write_text("of an earlier configuration")
    table = tmp_path / "predictions.parquet"
    jsons = [tmp_path / name for name in ("metrics.json", "details.json")]

    def evaluated(seeds, **options):
        """Scores and details of the only split."""
        with contextlib.chdir(tmp_path):
            own = with_seeds(config, seeds, "instrument")
            instruments = Trained(own, None, tmp_path / "instrument")
            assert set(evaluate(tmp_path, instruments, tmp_path, **options)) == {"by_simulation"}
        return [content(path)["by_simulation"] for path in jsons]

    instrument = evaluated([0])[1]["instrument"]
    for path in (table, *jsons):
        assert set(read_provenance(path)["inputs"]) == {"sample/manifest.parquet", str(trained)}
    rows = predictions(table)
    assert {row["viewpoint"] for row in rows} == {"calibrated", "bench_1"}
    assert len(rows) == instrument["n"]
    poses = {"yaw_deg": 5, "pitch_deg": 4, "farther_percent": 10}
    assert set(instrument["by"]) == {"material", "friction", "floor", "texture", *poses}
    for kind, step in poses.items():
        assert "+0" in instrument["by"][kind]  # the calibrated view
        assert all(int(value) % step == 0 for value in instrument["by"][kind])
    for kind, parts in instrument["by"].items():
        assert sum(part["n"] for part in parts.values()) == instrument["n"], kind
    for mu, part in instrument["by"]["friction"].items():
        of_mu = [row for row in rows if f"{row['true_value']:g}" == mu]
        errors = [abs(row["predicted_value"] - row["true_value"]) for row in of_mu]
        assert part["mean_absolute_error"] == pytest.approx(np.mean(errors))

    # Averaged later, when the images of all but the test's simulations are gone.
    before = evaluated([0, 1])
    rows = predictions(table)
    with contextlib.chdir(tmp_path):
        combine_instruments(
            [member.relative_to(tmp_path) for member in members],
            tmp_path / "sample",
            "by_simulation",
            tmp_path / "instrument/by_simulation/ensemble",
        )
    tested = {f"{row['simulation']}.parquet" for row in rows}
    images = shutil.copytree(tmp_path / "sample", tmp_path / "images")
    for shard in (tmp_path / "sample").glob("m0*.parquet"):
        if shard.name not in tested:
            shard.unlink()
    after = evaluated([0, 1], update=True)
    scores, details = (one.pop("instrument_ensemble") for one in after)
    assert after == before
    assert scores["seeds"] == [0, 1]
    assert list(details["seeds"]) == list(details["alarms"]) == ["ensemble"]
    now = predictions(table)
    assert [row for row in now if row["network"] == "instrument"] == rows
    averaged = [row for row in now if row["network"] == "instrument_ensemble"]
    assert [row["video"] for row in averaged] == [row["video"] for row in rows if not row["seed"]]
    assert {row["seed"] for row in averaged} == {None}
    inputs = read_provenance(jsons[0])["inputs"]
    assert {Path(name).parent.name for name in inputs} == {"sample", "seed0", "seed1", "ensemble"}
    # Nothing to do.
    assert evaluated([0, 1], update=True)[0]["instrument_ensemble"] == scores

    # Stretched by what it reads of other benches, when all images are gone.
    ensemble = tmp_path / "instrument/by_simulation/ensemble"
    scored = {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    bench = synthetic_videos.config(seed=5, grid={"frictions": [0.3, 0.4, 0.7], "replicates": 4})
    synthetic_videos.write_dataset(bench, tmp_path / "bench")
    with contextlib.chdir(tmp_path):
        recalibrate_instrument(ensemble, tmp_path / "again", ["bench/sample"])
    shutil.copytree(tmp_path / "again", ensemble, dirs_exist_ok=True)
    shutil.copytree(images, tmp_path / "sample", dirs_exist_ok=True)
    with_images = evaluated([0, 1])
    whole = pq.read_table(table).to_pylist()
    for path, held in scored.items():
        path.write_bytes(held)
    for shard in (tmp_path / "sample").glob("m0*.parquet"):
        shard.unlink()
    assert evaluated([0, 1], update=True) == with_images
    assert with_images[0]["instrument_ensemble"] != scores
    assert pq.read_table(table).to_pylist() == whole
    inputs = read_provenance(jsons[0])["inputs"]
    assert file_digest(ensemble / "instrument.safetensors") in inputs.values()


def test_scores_of_models_whose_weights_are_on_another_machine_stay(chain, tmp_path):
    """As when splits are trained on two machines, each of which films the simulations itself."""
    for folder in (*chain.glob("train/*"), *chain.glob("instrument/*")):
        machine = tmp_path / ("one" if folder.name == KEPT else "other")
        shutil.copytree(folder, machine / folder.relative_to(chain))
    for machine in ("one", "other"):
        shutil.copytree(chain / "sample", tmp_path / machine / "sample")
    other = tmp_path / "other" / "sample"
    write_manifest(read_manifest(other)[0], other, {"wall_s": 1})
    whole, pieces = tmp_path / "whole", tmp_path / "pieces"
    trained = Trained(CONFIG, "train", "instrument")
    for machine, out in ((chain, whole), (tmp_path / "one", pieces)):
        with contextlib.chdir(machine):
            evaluate(Path(), trained, out)
    first = read_provenance(pieces / "metrics.json")["inputs"]
    with contextlib.chdir(tmp_path / "other"):
        evaluate(Path(), trained, pieces, update=True)
        # A seed that the configuration has no longer does not count.
        wanted = replace(trained, config=with_seeds(CONFIG, [5], "train", "instrument"))
        assert trained.elsewhere(first) and not wanted.elsewhere(first)
        again = shutil.copytree(pieces, tmp_path / "again")
        other_seed = replace(trained, config=with_seeds(CONFIG, [5], "instrument"))
        evaluate(Path(), other_seed, again, update=True)
        assert "instrument" not in content(again / "metrics.json")[KEPT]

    def in_order(folder):
        return sorted(map(json.dumps, predictions(folder / "predictions.parquet")))

    assert in_order(pieces) == in_order(whole)
    for name, compared in product(("metrics.json", "details.json"), TRAINED_ON):
        scored, expected = (content(folder / name)[compared] for folder in (pieces, whole))
        assert scored == expected and len(scored) > 1
    weights = {path for path in first if path.endswith(".safetensors")}
    assert weights <= set(read_provenance(pieces / "metrics.json")["inputs"])


def test_of_what_was_scored_before_the_alarms_of_the_rows_that_stay_are_kept():
    def table(**alarms):
        of_split = {"split": KEPT, "trained_on": KEPT, "network": "instrument"}
        rows = [of_split | {"seed": int(name[1:])} for name in alarms]
        rates = {name[1:]: {"good": rate} for name, rate in alarms.items()}
        return Table(rows, {KEPT: {"instrument": {}}}, {KEPT: {"instrument": rates}})

    now = table(_0=0.1)
    now.add(table(_0=0.2, _1=0.3, _2=0.4), lambda row: row["seed"] == 1)
    assert now == table(_0=0.1, _1=0.3)


def test_scores_of_another_dataset_are_not_updated(chain, evaluated, tmp_path, capsys):
    out = shutil.copytree(evaluated, tmp_path / "evaluate")
    before = {path: path.read_bytes() for path in out.iterdir()}
    other = shutil.copytree(chain / "sample", tmp_path / "other")
    rows, _ = read_manifest(other)
    write_manifest([row | {"floor": "ceramic"} for row in rows], other, {})
    update = f"evaluate --config {chain}/c.json --instruments {chain}/instrument --update "
    update += f"--predictions {out}/predictions.parquet --out {out}/metrics.json --dataset"
    assert "scores of another dataset" in refused(capsys, f"{update} {other}")
    assert {path: path.read_bytes() for path in out.iterdir()} == before
    for path in before:
        path.unlink()
    said = refused(capsys, f"{update} {chain}/sample")
    assert "no scores to update: run without --update" in said
