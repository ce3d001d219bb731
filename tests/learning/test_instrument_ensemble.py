"""Several trainings of the instrument, averaged, stored and calibrated as one."""

import contextlib
import json
import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from safetensors.torch import load_file
from support import synthetic_videos
from support.models import held_out
from support.refusal import refused, run

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import file_digest, read_metadata, read_parquet, read_sidecar
from slipstitch.config import write_config
from slipstitch.config.train import InstrumentSettings
from slipstitch.dataset.videos import read_videos
from slipstitch.learning.evaluation.metrics import covered
from slipstitch.learning.evaluation.trained import Trained
from slipstitch.learning.instrument.calibration import (
    ANSWERS,
    READINGS,
    groups_of,
    kept_readings,
    numbers,
)
from slipstitch.learning.instrument.distribution import (
    conformal_intervals,
    conformal_scales,
    grouped_quantile,
    spread,
)
from slipstitch.learning.instrument.ensemble import combine_instruments, recalibrate_instrument
from slipstitch.learning.instrument.measuring import CARD, WEIGHTS, load_instrument
from slipstitch.learning.instrument.poses import poses_of
from slipstitch.learning.instrument.training import train_instrument
from slipstitch.learning.trainer import Run

pytestmark = pytest.mark.slow

CONFIG = synthetic_videos.config(
    grid={"frictions": [0.2, 0.5, 0.8], "replicates": 6},
    render={"pixels": 24, "viewpoints": ["calibrated", "side"]},
    sample={"frames": 6, "validation_fraction": 0.34, "test_fraction": 0.16},
    instrument={
        "seeds": [0, 1, 2],
        "channels": [8, 16, 24],
        "features": 128,
        "epochs": 10,
        "rectification_error": 0.01,
        "precision": "float32",
        "points_weight": 1.0,
        "plateau_margin": None,
    },
)
SEEDS, MARKED = CONFIG.instrument.seeds, True


def train(dataset, folder, seed, **changes):
    settings = InstrumentSettings(**{**CONFIG.instrument.model_dump(), **changes})
    out = folder / "by_simulation" / f"seed{seed}"
    train_instrument(settings, Run(dataset, "by_simulation", seed, out, 6), ["calibrated"])
    return out


@pytest.fixture(scope="module")
def folder(dataset, tmp_path_factory):
    """Three trainings and their average."""
    folder = tmp_path_factory.mktemp("instrument")
    inside = [train(dataset, folder, seed).relative_to(folder) for seed in SEEDS]
    with contextlib.chdir(folder):  # records name files by their path from the working folder
        combine_instruments(inside, dataset, "by_simulation", folder / "by_simulation/ensemble")
    return folder


@pytest.fixture(scope="module")
def members(folder):
    return [folder / "by_simulation" / f"seed{seed}" for seed in SEEDS]


@pytest.fixture(scope="module")
def ensemble(folder):
    return folder / "by_simulation/ensemble"


@pytest.fixture(scope="module")
def average(ensemble):
    return load_instrument(ensemble)


def answers_of(instrument, videos):
    frames, generator = instrument.frames_of(videos).pixels, np.random.default_rng(0)
    return instrument.answers(frames, generator, poses_of(videos.rows))


def test_its_distribution_is_the_mixture_of_its_members(dataset, members, average):
    """To the rounding of the weights, of which a float16 keeps eleven bits."""
    videos = held_out(dataset)
    each = [answers_of(load_instrument(member), videos) for member in members]
    whole = answers_of(average, videos)
    for name in ("probabilities", "material_logits", "order", "attention_weights", "points_m"):
        mean = np.mean([getattr(one, name) for one in each], axis=0)
        assert getattr(whole, name) == pytest.approx(mean, abs=0.02 * np.abs(mean).max()), name
    assert not np.allclose(each[0].probabilities, each[1].probabilities, atol=1e-3)
    assert whole.embedding.shape == (len(videos), 3 * each[0].embedding.shape[1])


def test_its_card_and_its_records_name_its_members(members, average, ensemble):
    card = average.card
    assert (card["networks"], card["seeds"]) == (3, SEEDS)
    assert card["members_sha256"] == [file_digest(member / WEIGHTS) for member in members]
    assert card["calibration_simulations"] == 12
    inputs = read_sidecar(ensemble / WEIGHTS)["inputs"]
    assert {inputs[name] for name in inputs if name.endswith(WEIGHTS)} == {*card["members_sha256"]}
    assert len(inputs) == 3 + 1  # the manifest has the digests of all pixels
    assert read_metadata(ensemble / ANSWERS)["provenance"]["inputs"] == inputs
    size = (ensemble / WEIGHTS).stat().st_size
    assert size < 0.6 * sum((member / WEIGHTS).stat().st_size for member in members)


def test_the_interval_can_be_fitted_again_from_what_is_kept(average, ensemble):
    kept = read_parquet(ensemble / ANSWERS)
    groups = kept["simulation"].to_pylist()
    assert len({*groups}) == 12
    probabilities, friction = numbers(kept, "probabilities", "friction")
    wide = spread(probabilities, average.grid, average.error_bars.spread)
    scores = conformal_scales(conformal_intervals(wide, average.grid, 0.9, 1.0), friction)
    assert grouped_quantile(scores, groups, 0.9) == average.conformal_scale
    assert kept_readings(ensemble) == []


@pytest.fixture(scope="module")
def other_bench(tmp_path_factory):
    """Other simulations, between the coefficients that train; their pictures are noisier."""
    folder = tmp_path_factory.mktemp("other_bench")
    config = synthetic_videos.config(
        seed=5,
        grid={"frictions": [0.3, 0.4, 0.7], "replicates": 4},
        render={"pixels": 24, "viewpoints": ["calibrated", "side"]},
        sample={"frames": 6},
    )
    return synthetic_videos.write_dataset(config, folder, marked=True)


@pytest.fixture(scope="module")
def recalibrated(folder, other_bench, tmp_path_factory):
    out = tmp_path_factory.mktemp("recalibrated")
    with contextlib.chdir(folder):
        recalibrate_instrument("by_simulation/ensemble", out, [other_bench])
    return out


def test_further_datasets_calibrate_it_with_or_without_its_members(
    recalibrated, average, dataset, members, other_bench, folder, tmp_path
):
    """To the same bits: what it says of its own videos is kept."""
    with contextlib.chdir(folder):
        inside = [member.relative_to(folder) for member in members]
        combine_instruments(inside, dataset, "by_simulation", tmp_path, [other_bench])
    later, at_once = load_instrument(recalibrated), load_instrument(tmp_path)
    assert later.card["recalibrated_from"] == {
        "weights_sha256": average.card["weights_sha256"],
        "factor": average.conformal_scale,
    }
    own = ("weights_sha256", "recalibrated_from")
    cards = [{k: v for k, v in one.card.items() if k not in own} for one in (later, at_once)]
    assert cards[0] == cards[1]
    assert later.conformal_scale == at_once.conformal_scale
    for name in (ANSWERS, READINGS):
        tables = [pq.read_table(one / name) for one in (recalibrated, tmp_path)]
        assert tables[0].equals(tables[1]), name
    inputs = [read_sidecar(one / WEIGHTS)["inputs"] for one in (recalibrated, tmp_path)]
    assert inputs[0] == inputs[1]
    manifest = file_digest(other_bench / "manifest.parquet")
    assert inputs[0]["calibration_datasets/0/manifest.parquet"] == manifest


def seen_videos(dataset):
    return read_videos(dataset, lambda row: row["viewpoint"] == "calibrated")


def test_intervals_alone_change_and_hold_on_all_simulations_together(
    recalibrated, average, other_bench, ensemble
):
    videos = seen_videos(other_bench)
    again = load_instrument(recalibrated)
    (noted,) = again.card["calibration_readings"]
    simulations = len({row["simulation"] for row in videos.rows})
    assert noted == {"digest": videos.digest, "videos": len(videos), "simulations": simulations}
    assert again.card["calibration_simulations"] == 12 + simulations
    own, readings = read_parquet(recalibrated / ANSWERS), kept_readings(recalibrated)
    assert own.equals(read_parquet(ensemble / ANSWERS))
    probabilities, friction = numbers(own, "probabilities", "friction")
    told = again.intervals(again.distributions(probabilities))
    holds = (told[:, 1] <= friction) & (friction <= told[:, 2])
    stretch = np.array([row["stretch"] for row in readings])
    inside = np.concatenate([holds, stretch <= again.conformal_scale]).astype(float)
    share, _ = covered(np.zeros(len(inside)), inside, np.ones(len(inside)),
                       [*own["simulation"].to_pylist(), *groups_of(readings)])  # fmt: skip
    assert 0.9 <= share < 1
    # Networks and alarm stay, so medians do; both halves are longer by one factor.
    tensors, stay = (load_file(one / WEIGHTS) for one in (recalibrated, ensemble))
    assert all(torch.equal(tensors[name], stay[name]) for name in (*tensors, *stay))
    before, ratio = average.intervals(again.distributions(probabilities)), again.conformal_scale
    ratio /= average.conformal_scale
    assert ratio != 1
    whole = (before[:, 1] > 0) & (before[:, 2] < again.grid[-1])
    median = before[whole, :1]
    wider = np.clip(median + ratio * (before[whole] - median), 0, again.grid[-1])
    assert whole.any() and told[whole] == pytest.approx(wider)


def readings_file(instrument, videos, path, **entries):
    """As benchmarks publish them, with a reading by a single training among them."""
    rows, told = [], answers_of(instrument, videos)
    intervals = instrument.intervals(instrument.distributions(told.probabilities))
    for row, (reading, low, high) in zip(videos.rows, intervals.tolist(), strict=True):
        known = {"simulation": row["simulation"], "friction": row["friction"], "seed": None}
        rows.append({**known, "reading": reading, "low": low, "high": high})
    rows.append(rows[0] | {"seed": 0, "friction": 1.0, "reading": 0.1, "low": 0.1, "high": 0.1})
    weights = instrument.card["weights_sha256"]
    path.write_text(json.dumps({"weights_sha256": weights, "readings": rows} | entries))
    return path


def test_readings_calibrate_it_as_their_videos_do(
    recalibrated, average, other_bench, ensemble, tmp_path
):
    videos = seen_videos(other_bench)
    file = readings_file(average, videos, tmp_path / "readings.json", dataset=videos.digest)
    recalibrate = f"instrument --recalibrate {ensemble}"
    assert run(f"{recalibrate} --out-dir {tmp_path}/out --readings {file}") == 0
    found, wanted = load_instrument(tmp_path / "out"), load_instrument(recalibrated)
    # What an interval that the grid cuts off would have needed is not known, but held already.
    assert found.conformal_scale == pytest.approx(wanted.conformal_scale)
    (noted,) = found.card["calibration_readings"]
    assert noted["digest"] == file_digest(file)
    assert noted["videos"] == len(videos)  # not what the training read
    inputs = read_sidecar(tmp_path / "out" / WEIGHTS)["inputs"]
    assert inputs["calibration_readings/0/readings.json"] == file_digest(file)
    # The same videos do not count twice, as a dataset or in another file.
    some = videos.chosen(np.arange(len(videos)) % 2 == 0)
    again = readings_file(found, some, tmp_path / "b.json", dataset=videos.digest)
    for further in ({"further": [other_bench]}, {"files": [again]}):
        with pytest.raises(BadInput, match="trained or calibrates the instrument already"):
            recalibrate_instrument(tmp_path / "out", tmp_path / "twice", **further)
    # Once more on others: those of before stay.
    again = readings_file(found, some, tmp_path / "b.json")
    recalibrate_instrument(tmp_path / "out", tmp_path / "twice", files=[again])
    noted = load_instrument(tmp_path / "twice").card["calibration_readings"]
    assert [one["digest"] for one in noted] == [file_digest(file), file_digest(again)]
    inputs = read_sidecar(tmp_path / "twice" / WEIGHTS)["inputs"]
    assert {f"calibration_readings/{n}" for n in ("0/readings.json", "1/b.json")} <= set(inputs)


UNLIKE = "0 <= low < reading < high <= 1.5 is required"


@pytest.mark.parametrize(
    ("entries", "reading", "problem"),
    [
        ({"readings": None}, {}, "must be a mapping with readings, a list of mappings"),
        ({"readings": []}, {}, "has no reading of the instrument"),
        ({"readings": [{"simulation": "a"}]}, {}, "reading 0: simulation must be a text, friction"),
        ({"weights_sha256": "f" * 64}, {}, "names no readings of this instrument: its record, or"),
        ({}, {"low": 0.9, "reading": 0.5, "high": 0.6}, f"reading 1: {UNLIKE}"),
        ({}, {"low": 0.5, "reading": 0.5, "high": 0.6}, f"reading 1: {UNLIKE}"),
        ({}, {"low": 0.4, "reading": 0.5, "high": 1.6}, f"reading 1: {UNLIKE}"),
        ({}, {"high": 10**400}, "reading 1: simulation must be a text, friction, reading, low, hi"),
        ({}, {"friction": 9.0}, "reading 1: friction is 9; the instrument can say 0 to 1.5"),
        ({}, {"friction": float("nan")}, "reading 1: simulation must be a text, friction, readin"),
        ({}, {"simulation": 3}, "reading 1: simulation must be a text"),
    ],
)
def test_readings_that_cannot_be_of_it_are_refused(
    entries, reading, problem, average, other_bench, ensemble, tmp_path, capsys
):
    videos = seen_videos(other_bench)
    file = readings_file(average, videos, tmp_path / "readings.json", **entries)
    content = json.loads(file.read_text())
    if reading:
        content["readings"][1] |= reading
    file.write_text(json.dumps(content))
    recalibrate = f"instrument --recalibrate {ensemble}"
    said = refused(capsys, f"{recalibrate} --out-dir {tmp_path}/out --readings {file}")
    assert f"{file}: {problem}" in said
    assert not (tmp_path / "out").exists()


def test_what_cannot_calibrate_is_refused(
    ensemble, members, dataset, other_bench, recalibrated, tmp_path, capsys
):
    whole, out = ensemble, tmp_path / "out"
    unknown, unanswered = (shutil.copytree(whole, tmp_path / name) for name in "ab")
    (unknown / f"{WEIGHTS}.provenance.json").unlink()
    (unanswered / ANSWERS).unlink()
    config = synthetic_videos.config(
        grid={"frictions": [0.3, 1.75]}, render={"pixels": 24}, sample={"frames": 6}
    )
    slippery = synthetic_videos.write_dataset(config, tmp_path, marked=True)
    for one, further, problem in (
        (whole, dataset, "trained or calibrates the instrument already"),
        (recalibrated, other_bench, "trained or calibrates the instrument already"),
        (members[0], other_bench, "is a single training; averages alone keep"),
        (unknown, other_bench, "has no record of what trained it"),
        (unanswered, other_bench, r"calibration\.parquet: no such file"),
        (whole, slippery, r"friction 1\.75 is above the grid's end"),
    ):
        with pytest.raises(BadInput, match=problem):
            recalibrate_instrument(one, out, [further])
    command = f"instrument --recalibrate {whole} --out-dir {out}"
    needed = "--recalibrate requires --calibration-datasets, --readings or both"
    assert needed in refused(capsys, command)
    command += f" --calibration-datasets {other_bench}"
    said = refused(capsys, f"{command} --dataset {dataset}")
    assert "--dataset cannot be combined with --recalibrate" in said
    assert not out.exists()
    assert run(command) == 0
    assert "average of seeds 0, 1, 2; calibrated on 36 simulations" in capsys.readouterr().out


def test_members_that_nothing_calibrates_give_an_average_without_error_bars(other_bench, tmp_path):
    config = synthetic_videos.config(
        grid={"replicates": 1}, sample={"frames": 6, "validation_fraction": 0.0}
    )
    synthetic_videos.write_dataset(config, tmp_path, marked=True)
    members = [train(tmp_path / "sample", tmp_path, seed, epochs=1) for seed in (0, 1)]
    assert all(load_instrument(member).error_bars is None for member in members)
    card = combine_instruments(members, tmp_path / "sample", "by_simulation", tmp_path / "out")
    assert card["error_bars"] is None
    with pytest.raises(BadInput, match="has no alarm, as nothing has calibrated it"):
        recalibrate_instrument(tmp_path / "out", tmp_path / "again", [other_bench])
    average = load_instrument(tmp_path / "out")
    assert "not calibrated" in average.measure(np.zeros((6, 16, 16, 3), np.uint8)).alarm_reason
    assert pq.read_table(tmp_path / "out" / ANSWERS).num_rows == 0


def test_what_does_not_belong_together_is_refused(dataset, members, ensemble, tmp_path):
    other = train(dataset, tmp_path, 3, epochs=2)
    for chosen, split, problem in (
        (members[:1], "by_simulation", r"1 instrument\(s\) given; 2 to 16 are combined"),
        ([members[0]] * 2, "by_simulation", r"has seed 0, as .*seed0 has"),
        ([members[0], ensemble], "by_simulation", "is itself combined of 3 trainings"),
        (members, "by_video", "was trained on the split by_simulation, not by_video"),
        ([*members, other], "by_simulation", r"seed3: differs from .*seed0 in its settings"),
    ):
        with pytest.raises(BadInput, match=problem):
            combine_instruments(chosen, dataset, split, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_it_is_found_beside_its_members_and_only_with_them(members, folder, tmp_path):
    def found(folder, seeds=SEEDS):
        instrument = CONFIG.instrument.model_copy(update={"seeds": seeds})
        config = CONFIG.model_copy(update={"instrument": instrument})
        return [key[2] for key in Trained(config, instruments=folder).load()]

    assert found(folder) == [0, 1, 2, None]
    assert found(folder, [1]) == [1]
    copy = shutil.copytree(folder, tmp_path / "copy")
    shutil.rmtree(copy / "by_simulation/seed2")
    with pytest.raises(BadInput, match="is the average of other instruments than those beside it"):
        found(copy)
    shutil.copytree(members[0], copy / "by_simulation/ensemble", dirs_exist_ok=True)
    with pytest.raises(BadInput, match="holds by_simulation seed 0: does not match its folder"):
        found(copy)


def test_the_command_averages_to_the_same_bits_and_says_so(
    dataset, members, ensemble, tmp_path, capsys
):
    write_config(CONFIG, tmp_path / "c.json")
    command = f"instrument --config {tmp_path}/c.json --dataset {dataset} --split by_simulation "
    command += f"--out-dir {tmp_path}/out"
    of_all = f"{command} --members {' '.join(map(str, members))}"
    assert run(of_all) == 0
    said = capsys.readouterr().out
    assert "average of seeds 0, 1, 2; calibrated on 12 simulations" in said
    for name in (WEIGHTS, CARD):
        assert (tmp_path / "out" / name).read_bytes() == (ensemble / name).read_bytes(), name
    for words, problem in (
        (f"{of_all} --seed 0", "--members cannot be combined with --seed"),
        (command, "one of --seed, --members, --recalibrate is required"),
        (f"{of_all} {tmp_path}/missing", f"missing/{WEIGHTS}: no such file"),
    ):
        assert problem in refused(capsys, words)
