"""A training learns, resumes to the same bits, and says so where it cannot."""

import csv
import math
from collections import Counter

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file
from support import synthetic_videos
from support.refusal import refused, run

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import read_sidecar
from slipstitch.config import write_config
from slipstitch.config.train import TrainSettings
from slipstitch.dataset.videos import read_videos
from slipstitch.learning import lrcn_training
from slipstitch.learning.checkpoint import CHECKPOINT
from slipstitch.learning.lrcn import LRCN, WEIGHTS, load_model
from slipstitch.learning.lrcn_training import learning_rate, progressive_schedule, train_network
from slipstitch.learning.trainer import DivergedError, Phase, PlateauError, Run, place

CONFIG = synthetic_videos.config()
VIEWS = ["calibrated", "side"]
FEW = {"epochs_per_cycle": 1, "plateau_margin": None, "checkpoint_interval_s": 0.0}


def train(dataset, out, network="friction_baseline", split="by_simulation", seed=0, **options):
    changes, view_order = options.pop("changes", {}), options.pop("view_order", VIEWS)
    settings = TrainSettings(**{**CONFIG.train.model_dump(), **changes})
    names = {"uses", "threads", "after_step"} & set(options)
    run = Run(dataset, split, seed, out, **{name: options.pop(name) for name in names})
    return train_network(settings, run, network, view_order, **options)


def kill(progress):
    """Interrupts a training at its second step."""
    if progress.step == 2:
        raise KeyboardInterrupt


def begins_at(dataset, out, **options):
    """The first step of a training that is stopped after it."""
    steps = []

    def stop(progress):
        steps.append(progress.step)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(dataset, out, changes=FEW, after_step=stop, **options)
    return steps[0]


@pytest.fixture(scope="module")
def checkpoint(dataset, tmp_path_factory):
    """What a training leaves that was killed at its second step."""
    folder = tmp_path_factory.mktemp("killed")
    with pytest.raises(KeyboardInterrupt):
        train(dataset, folder, changes=FEW, after_step=kill)
    return folder / CHECKPOINT


@pytest.fixture(scope="module")
def undisturbed(dataset, tmp_path_factory):
    """The files of that training where nothing kills it."""
    return trained(dataset, tmp_path_factory.mktemp("undisturbed"))


def trained(dataset, folder, seed=0):
    train(dataset, folder, seed=seed, changes=FEW)
    files = ("model.safetensors", "model.json", "history.csv")
    return {file: (folder / file).read_bytes() for file in files}


def history(folder):
    with open(folder / "history.csv", newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def material(dataset, tmp_path_factory):
    """A trained material network of the split by simulation."""
    folder = tmp_path_factory.mktemp("material")
    train(dataset, folder, "material_baseline", changes=FEW)
    return folder


def test_the_schedule_adds_viewpoints_lowers_the_rate_and_ends_on_the_calibrated_one():
    settings = TrainSettings(learning_rate=2.0, epochs_per_cycle=5, fine_tuning_epochs=2)
    phases = progressive_schedule(settings, ["a", "b", "c"])
    shown = [(phase.viewpoints, phase.epochs) for phase in phases]
    assert shown == [(("a",), 5), (("a", "b"), 5), (("a", "b", "c"), 5), (("a",), 2)]
    expected = [2.0] * 3, [2.0] * 3, [2.0, 1.05, 0.1], [0.1] * 3
    for phase, rates in zip(phases, expected, strict=True):
        found = [learning_rate(settings, phases, phase, done) for done in (0.0, 0.5, 1.0)]
        assert found == pytest.approx(rates)


def test_epochs_until_the_validation_is_flat_come_before_the_last_cycle():
    """Flat: the lowest loss is two epochs old; one at chance is not, however flat."""
    settings = TrainSettings(epochs_per_cycle=1, fine_tuning_epochs=1, flat_epochs=2)
    phases = progressive_schedule(settings, ["a", "b"])
    names = ["cycle 1", "until flat", "cycle 2", "fine-tuning"]
    assert [phase.name for phase in phases] == names
    assert phases[1].viewpoints == ("a", "b") and phases[1].epochs == 8
    assert learning_rate(settings, phases, phases[1], 1.0) == settings.learning_rate

    def seen(validation, training):
        """Phases of the epochs with such losses, and of the next."""
        losses = zip(training, validation, strict=True)
        rows = [{"train_loss": one, "validation_loss": other} for one, other in losses]
        following = [place(phases, rows[:count], 0.9) for count in range(len(rows) + 1)]
        return [one and (one[0].name, one[1]) for one in following]

    flat = [("until flat", number) for number in range(3)]
    ends = [("cycle 2", 0), ("fine-tuning", 0), None]
    found = seen([9.0, 0.5, 0.6, 0.5, 0.4, 0.4], [0.8] * 6)
    assert found == [("cycle 1", 0), *flat, *ends]
    at_chance = seen([1.0] * 11, [1.0] * 11)
    assert [one and one[0] for one in at_chance] == [names[0], *[names[1]] * 8, *names[2:], None]


def test_the_network_before_fine_tuning_is_kept_and_tells_the_material(dataset, tmp_path):
    few = FEW | {"keep_all_views": True}

    def kill(progress):
        if progress.epoch == 2 and progress.step == 2:  # in the first epoch of fine-tuning
            raise KeyboardInterrupt

    folder = tmp_path / "material"
    with pytest.raises(KeyboardInterrupt):
        train(dataset, folder, "material_baseline", changes=few, after_step=kill)
    # Nothing but the checkpoint: Snakemake removes all other files of a job that was killed.
    assert [file.name for file in folder.iterdir()] == [CHECKPOINT]
    train(dataset, folder, "material_baseline", changes=few)
    kept = load_model(folder / "all_views")
    assert kept.card["epochs"] == 2 and load_model(folder).card["epochs"] == 4
    assert read_sidecar(folder / "all_views/model.safetensors")["stage"] == "train"
    without = few | {"fine_tuning_epochs": 0}
    train(dataset, tmp_path / "alone", "material_baseline", changes=without)
    alone = load_model(tmp_path / "alone").network.state_dict()
    for name, value in kept.network.state_dict().items():
        assert torch.equal(value, alone[name]), name
    conditional = tmp_path / "conditional"
    card = train(dataset, conditional, "friction_conditional", material_model=folder, changes=few)
    assert card["condition_sha256"] == kept.card["weights_sha256"]


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("split", ["by_video", "by_simulation"])
def test_a_network_learns_friction(dataset, tmp_path, split):
    card = train(dataset, tmp_path, split=split)
    assert card["chance_loss"] == pytest.approx(math.log(2), abs=0.03)
    # Processors differ in last bits, and these small trainings in where they end.
    assert card["train_loss"] < 0.5 * card["chance_loss"]
    rows = history(tmp_path)
    epochs = Counter(row["stage"] for row in rows)
    assert epochs == {"cycle 1": 20, "cycle 2": 20, "fine-tuning": 2}
    assert float(rows[-1]["train_loss"]) == card["train_loss"]


def test_a_training_may_use_part_of_the_videos_in_phases_of_its_own(dataset, tmp_path):
    phases, changes = [Phase("joint", ("calibrated", "side"), 2)], {"plateau_margin": None}
    some = {"uses": lambda row: row["texture"] == "tartan"}
    card = train(dataset, tmp_path, phases=phases, changes=changes, **some)
    assert card["training_videos"] == 4 * 2  # simulations, viewpoints
    assert [(row["stage"], row["videos"]) for row in history(tmp_path)] == [("joint", "8")] * 2


def test_equal_seeds_give_equal_files_and_other_seeds_other_weights(dataset, undisturbed, tmp_path):
    """Also with a copy of the dataset."""
    elsewhere = synthetic_videos.altered_copy(dataset, tmp_path / "copy", same)
    assert trained(elsewhere, tmp_path / "again") == undisturbed
    other = trained(dataset, tmp_path / "other", seed=1)
    assert other["model.safetensors"] != undisturbed["model.safetensors"]


@pytest.mark.default_cases(1)
@pytest.mark.parametrize(
    ("steps", "precision", "interval_s"),
    [(1, "float32", 0.0), (5, "bfloat16", 0.0), (13, "float32", 1e3)],
)
def test_a_killed_training_goes_on_to_the_same_bits(
    dataset, tmp_path, capsys, steps, precision, interval_s
):
    """Also where checkpoints are to be written less often than before."""
    few = FEW | {"epochs_per_cycle": 2, "precision": precision}
    whole, killed = tmp_path / "undisturbed", tmp_path / "killed"
    train(dataset, whole, changes=few)
    left = iter(range(steps - 1, -1, -1))

    def kill(_):
        if not next(left, True):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(dataset, killed, changes=few, after_step=kill)
    assert (killed / CHECKPOINT).exists()
    assert not (killed / "model.safetensors").exists()
    train(dataset, killed, changes=few | {"checkpoint_interval_s": interval_s})
    assert "continuing from" in capsys.readouterr().err
    assert (killed / "history.csv").read_bytes() == (whole / "history.csv").read_bytes()
    weights = load_model(killed).network.state_dict()
    for name, value in load_model(whole).network.state_dict().items():
        assert torch.equal(value, weights[name]), name
    assert not (killed / CHECKPOINT).exists()


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("other", [{"seed": 1}, {"threads": 2}], ids=["seed", "threads"])
def test_a_checkpoint_of_another_training_is_not_used(
    dataset, undisturbed, tmp_path, capsys, other
):
    """Sums over several threads round otherwise: the result would be neither run's."""
    with pytest.raises(KeyboardInterrupt):
        train(dataset, tmp_path, changes=FEW, after_step=kill, **other)
    assert trained(dataset, tmp_path) == undisturbed
    assert "from another training" in capsys.readouterr().err


@pytest.mark.parametrize("part", ["progress", "identity", "weights", "shape", "all"])
def test_a_checkpoint_altered_in_any_part_is_said_and_not_used(
    dataset, checkpoint, tmp_path, capsys, part
):
    path = tmp_path / CHECKPOINT
    with safe_open(checkpoint, "pt") as file:
        notes = file.metadata()
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    if part == "weights":
        tensors["network.fully_connected.3.bias"][0] += 1
    elif part == "shape":
        tensors["random"] = tensors["random"][None]
    elif part != "all":
        edited = {"progress": ('"step": 2', '"step": 1'), "identity": ('"seed": 0', '"seed": 1')}
        assert edited[part][0] in notes[part]
        notes[part] = notes[part].replace(*edited[part])
    save_file(tensors, path, notes)
    if part == "all":
        path.write_bytes(b"no checkpoint")
    assert begins_at(dataset, tmp_path, seed=int(part == "identity")) == 1
    assert "no readable checkpoint; starting from scratch" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("learning_rate", "given_up_after", "error", "words"),
    [
        (1e-9, None, PlateauError, r"still .*, at chance \(0\.69"),
        (1e-9, 3, PlateauError, "after 3 epochs"),
        (1e38, None, DivergedError, "the loss became nan"),
    ],
)
def test_a_network_that_learns_nothing_fails_and_writes_no_model(
    dataset, tmp_path, monkeypatch, learning_rate, given_up_after, error, words
):
    if given_up_after:
        monkeypatch.setattr(lrcn_training, "PLATEAU_EPOCHS", given_up_after)
    changes = {"learning_rate": learning_rate, "epochs_per_cycle": 3}
    with pytest.raises(error, match=words):
        train(dataset, tmp_path, changes=changes)
    assert not (tmp_path / "model.safetensors").exists()


def test_a_network_that_falls_silent_in_the_first_cycle_is_drawn_anew(
    dataset, tmp_path, monkeypatch, capsys
):
    """Also by a training that is killed after that and resumed: to the same bits."""
    draw, drawn = LRCN.initialise, []

    def silent_first(network):
        draw(network)
        drawn.append(network)
        if len(drawn) == 1:
            with torch.no_grad():  # none of these rectifiers ever passes anything on
                network.fully_connected[0].bias.fill_(-1e6)

    def kill_second_draw(progress):
        if progress.draws == 2:
            kill(progress)

    monkeypatch.setattr(LRCN, "initialise", silent_first)
    card = train(dataset, tmp_path / "whole", changes=FEW)
    assert "silent after cycle 1: weights are drawn anew" in capsys.readouterr().err
    assert card["draws"] == len(drawn) == 2
    with open(tmp_path / "whole/history.csv") as stream:
        epochs = [int(row["epoch"]) for row in csv.DictReader(stream)]
    assert epochs == list(range(1, card["epochs"] + 1))

    drawn.clear()
    with pytest.raises(KeyboardInterrupt):
        train(dataset, tmp_path / "killed", changes=FEW, after_step=kill_second_draw)
    capsys.readouterr()
    assert train(dataset, tmp_path / "killed", changes=FEW)["draws"] == 2
    assert "epoch 1, step 3" in capsys.readouterr().err
    whole, killed = (tmp_path / name / WEIGHTS for name in ("whole", "killed"))
    assert whole.read_bytes() == killed.read_bytes()


def leak(rows):
    rows[0]["split_by_simulation"], rows[1]["split_by_simulation"] = "test", "train"


def swap(rows):
    for row in rows:
        row["friction"] = 0.7 - row["friction"]


def empty(rows):
    for row in rows:
        if row["friction_id"] == "f0600":
            row["split_by_simulation"] = "validation"


def same(rows):
    pass


THREE = {"expected_classes": {"friction": [0.1, 0.3, 0.6]}}


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        (leak, {}, r"leaks: m\d\d_f\d+_r\d\d is in train and test"),
        (swap, {}, "was altered"),
        (empty, {}, "friction class f0600 has no training video"),
        (same, THREE, r"2 friction classes \(0\.1, 0\.6\), the configuration 3"),
        (same, {"view_order": ["frontal"]}, "viewpoint 'frontal' has no training video"),
    ],
)
def test_a_dataset_that_does_not_fit_is_refused(dataset, tmp_path, change, options, words):
    sample = synthetic_videos.altered_copy(dataset, tmp_path / "data", change, change is not swap)
    with pytest.raises(BadInput, match=words):
        train(sample, tmp_path / "out", **options)


def test_swapped_images_are_noticed_and_a_missing_file_is_named(dataset, tmp_path):
    copy = synthetic_videos.altered_copy(dataset, tmp_path / "copy", same)
    path = sorted(copy.glob("m*.parquet"))[0]
    table = pq.read_table(path)
    rows = table.to_pylist()
    rows[0]["image"], rows[7]["image"] = rows[7]["image"], rows[0]["image"]
    pq.write_table(pa.Table.from_pylist(rows, schema=table.schema), path)
    with pytest.raises(BadInput, match="its pixels do not match the manifest"):
        read_videos(copy)
    path.unlink()
    with pytest.raises(BadInput, match=f"{path.name}: no such file"):
        read_videos(copy)


def test_a_material_model_says_what_it_is_and_is_of_one_split(dataset, material, tmp_path):
    with pytest.raises(BadInput, match="has split 'by_simulation', 'by_video' is needed"):
        train(dataset, tmp_path, "friction_conditional", "by_video", material_model=material)
    with pytest.raises(BadInput, match="does not take --material-model"):
        train(dataset, tmp_path, "friction_baseline", material_model=material)
    card = load_model(material).card
    assert card["network"] == "material_baseline" and card["training_simulations"] == 4
    record = read_sidecar(material / "model.safetensors")
    assert record["stage"] == "train" and record["seed"] == 0 and record["threads"] == 1
    assert any(name.endswith("manifest.parquet") for name in record["inputs"])


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        ("model.safetensors", lambda old: old[:-1] + bytes([old[-1] ^ 1]), "altered or damaged"),
        ("model.json", lambda old: old.replace(b"m00", b"m09"), "differs from the card inside"),
        ("model.json", lambda old: b'{"architecture": "other"}', "not a model card of Slipstitch"),
        ("model.json", None, r"model\.json: no such file"),
    ],
)
def test_a_model_that_is_not_as_it_was_written_is_refused(material, tmp_path, file, change, words):
    for name in ("model.safetensors", "model.json"):
        content = (material / name).read_bytes()
        if name != file or change:
            (tmp_path / name).write_bytes(change(content) if name == file else content)
    with pytest.raises(BadInput, match=words):
        load_model(tmp_path)


def test_the_command_trains_and_answers_bad_input_in_one_line(dataset, tmp_path, capsys):
    train = CONFIG.train.model_copy(update=FEW)
    write_config(CONFIG.model_copy(update={"train": train}), tmp_path / "c.json")
    command = f"train --config {tmp_path}/c.json --dataset {dataset} --split by_video --seed 0 "
    command += f"--out-dir {tmp_path}/out --network"
    assert run(f"{command} friction_baseline") == 0
    assert "4 epochs on 26 videos" in capsys.readouterr().out
    assert "requires --material-model" in refused(capsys, f"{command} friction_conditional")
