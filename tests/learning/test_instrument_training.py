"""The instrument learns, goes on after a kill to the same bits, and refuses what cannot work."""

import csv
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from support import synthetic_videos
from support.models import held_out
from support.refusal import run

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import read_sidecar
from slipstitch.config import write_config
from slipstitch.config.train import InstrumentSettings
from slipstitch.design.grid import sampled_frames
from slipstitch.learning.instrument.augmentation import disordered, phase_frames
from slipstitch.learning.instrument.measuring import CARD, WEIGHTS, load_instrument
from slipstitch.learning.instrument.network import (
    KEYPOINT_ERROR_M,
    InstrumentNetwork,
    keypoint_errors,
    next_frictions,
    noisy_keypoints,
)
from slipstitch.learning.instrument.training import (
    chance_score,
    load_start,
    losses,
    train_instrument,
    training_views,
)
from slipstitch.learning.trainer import Run, curve

CONFIG = synthetic_videos.config(
    grid={"frictions": [0.2, 0.5, 0.8], "replicates": 6},
    render={"pixels": 24, "viewpoints": ["calibrated", "side"]},
    sample={"frames": 6, "phases": 2, "validation_fraction": 0.34, "test_fraction": 0.16},
)
SETTINGS = InstrumentSettings(
    channels=[8, 16, 24],
    features=32,
    epochs=40,
    rectification_error=0.01,  # a quarter of a pixel
    precision="float32",
)


def train(dataset, out, frames=6, **changes):
    run = Run(dataset, "by_simulation", 0, out, frames)
    return train_instrument(SETTINGS.model_copy(update=changes), run, ["calibrated"])


@pytest.fixture(scope="module")
def folder(dataset, tmp_path_factory):
    folder = tmp_path_factory.mktemp("trained")
    train(dataset, folder)
    return folder


@pytest.fixture(scope="module")
def tests(dataset):
    """Videos of simulations that neither trained nor calibrated, from the measuring viewpoint."""
    videos = held_out(dataset)
    return videos, videos.seen_with(videos.pixels.shape[2], 6).pixels


def errors_of(instrument, videos, frames):
    """Absolute errors of the measurements, and the mean one of the best constant answer."""
    truth = np.array([row["friction"] for row in videos.rows])
    found = np.array([instrument.measure(one).friction_coefficient for one in frames])
    return abs(found - truth), abs(truth - np.median(truth)).mean()


def test_it_measures_new_simulations_and_raises_its_alarm_for_other_videos(folder, tests):
    videos, frames = tests
    instrument = load_instrument(folder)
    errors, constant = errors_of(instrument, videos, frames)
    assert errors.mean() < 0.5 * constant
    measured = [instrument.measure(one) for one in frames]
    ends = np.array([one.interval_90 for one in measured])
    truth = np.array([row["friction"] for row in videos.rows])
    assert np.mean((ends[:, 0] <= truth) & (truth <= ends[:, 1])) > 0.7
    assert np.diff(ends).mean() < 0.7
    fabrics = [one.fabrics[0] for one in measured]
    assert np.mean(np.array(fabrics) == [row["material"] for row in videos.rows]) > 0.7
    # 12 videos; promised at most a twentieth of very many.
    assert np.mean([one.alarm for one in measured]) <= 0.25
    for wrong, least in (
        (np.full_like(frames[:4], 20), 1.0),
        (255 - frames[:12], 0.95),
        (frames[:12, :, ::-1], 0.95),
    ):
        assert np.mean([instrument.measure(one).alarm for one in wrong]) >= least


@pytest.mark.slow
def test_places_of_the_cloth_are_learnt_and_friction_read_from_them_alone(tests, tmp_path):
    marked = synthetic_videos.write_dataset(CONFIG, tmp_path, marked=True)
    train(marked, tmp_path, points_weight=1.0, through_points=True, epochs=80)
    history = list(csv.DictReader((tmp_path / "history.csv").open()))
    instrument = load_instrument(tmp_path)
    # On simulations that did not train, beside the mean distance from a constant place.
    off_m = float(history[-1]["validation_points"]) * KEYPOINT_ERROR_M
    assert off_m < 0.3 * float(instrument.networks[0].points_spread_m.mean())
    errors, constant = errors_of(instrument, *tests)
    assert errors.mean() < 0.5 * constant


def test_the_learning_curve_falls_and_is_kept(folder):
    rows = list(csv.DictReader((folder / "history.csv").open()))
    assert [int(row["epoch"]) for row in rows] == list(range(1, 41))
    assert float(rows[-1]["train_loss"]) < 0.4 * float(rows[0]["chance_loss"])
    card = load_instrument(folder).card
    assert card["train_loss"] == float(rows[-1]["train_loss"])
    assert card["training_simulations"] == 18
    assert card["calibration_simulations"] == 12


def test_a_training_goes_on_from_another_instruments_weights(dataset, folder, tmp_path):
    card = train(dataset, tmp_path, starts_from=str(folder), epochs=1, learning_rate=2e-4)
    assert card["started_from"] == load_instrument(folder).card["weights_sha256"]
    assert card["started_from"] in read_sidecar(tmp_path / WEIGHTS)["inputs"].values()
    begun, finished = (
        float(list(csv.DictReader((one / "history.csv").open()))[-1]["validation_loss"])
        for one in (tmp_path, folder)
    )
    assert begun < 1.5 * finished < 0.5 * card["chance_loss"]


def test_weights_of_other_fabrics_are_a_start_but_for_the_layer_that_tells_them(folder):
    before = load_instrument(folder)
    network = InstrumentNetwork(SETTINGS, len(before.card["materials"]) + 1, 24)
    drawn = network.material.weight.clone()
    settings = SETTINGS.model_copy(update={"starts_from": str(folder)})
    load_start(network, settings, [*before.card["materials"], "another"], 0)
    assert torch.equal(network.material.weight, drawn)
    begun, learnt = (one.recurrent.weight_ih_l0 for one in (network, before.networks[0]))
    assert torch.equal(begun, learnt)


def test_weights_of_other_sizes_are_no_start(dataset, folder, tmp_path):
    with pytest.raises(BadInput, match="its network has other sizes than the settings"):
        train(dataset, tmp_path, starts_from=str(folder), features=16)


def test_a_start_is_a_folder_and_else_refused_before_the_training(dataset, folder, tmp_path):
    with pytest.raises(BadInput, match=r"instrument\.json"):
        train(dataset, tmp_path, starts_from=str(folder / CARD))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"frames": 13}, "videos have 12 frames; the instrument requires 13"),
        ({"friction_max": 0.7}, "friction 0.8 is above the grid's end, 0.7"),
        ({"channels": [8] * 5}, "24 pixels are too few for 5 convolutions"),
        ({"points_weight": 1.0}, "has no keypoints of the cloth"),
    ],
)
def test_settings_that_do_not_fit_the_data_are_refused(dataset, tmp_path, changes, words):
    with pytest.raises(BadInput, match=words):
        train(dataset, tmp_path, **changes)


def emptied(rows):
    for row in rows:
        if row["friction"] == 0.8:
            row["split_by_simulation"] = "validation"


def leaking(rows):
    same = [row for row in rows if row["simulation"] == rows[0]["simulation"]]
    same[0]["split_by_simulation"], same[1]["split_by_simulation"] = "train", "validation"


@pytest.mark.parametrize(
    ("change", "settings", "code", "words"),
    [
        (emptied, {}, 2, "friction 0.8 has no training video"),
        (leaking, {}, 2, "is in train and validation"),
        (None, {"learning_rate": 1e30}, 1, "the loss became nan in epoch 1, step"),
        (None, {"learning_rate": 1e-9}, 1, "at chance"),
    ],
    ids=["an empty class", "a leaking split", "no number", "a plateau"],
)
def test_what_cannot_be_learnt_stops_the_command_with_one_line(
    dataset, tmp_path, capsys, change, settings, code, words
):
    if change:
        dataset = synthetic_videos.altered_copy(dataset, tmp_path / "data", change)
    section = InstrumentSettings(**{**SETTINGS.model_dump(), "epochs": 1, **settings})
    write_config(CONFIG.model_copy(update={"instrument": section}), tmp_path / "c.json")
    command = f"instrument --config {tmp_path}/c.json --dataset {dataset} --split by_simulation"
    assert run(f"{command} --seed 0 --out-dir {tmp_path}/out") == code
    said = [line for line in capsys.readouterr().err.splitlines() if ": epoch 1/1: " not in line]
    assert len(said) == 1 and words in said[0]
    assert said[0].startswith("slipstitch instrument: ")
    assert not (tmp_path / "out" / "instrument.safetensors").exists()


def test_chance_is_the_score_of_the_labels_distribution_and_a_median_a_point_of_the_grid():
    # Uniform in [0, 1]: mean distance 1/3, so 1/6.
    assert chance_score(np.linspace(0, 1, 401)) == pytest.approx(1 / 6, rel=0.01)
    # Two videos, one in order: the network is sure of 0.75, which is true.
    grid = torch.arange(151) / 100
    sure = torch.tensor([[[0.0], [0.75], [-7.0]]])
    said = {"friction": sure, "material": torch.zeros(1, 2), "order": torch.zeros(2)}

    class Sure(SimpleNamespace):
        def __call__(self, *_):
            return said

    network = Sure(grid=grid, middles=(grid[1:] + grid[:-1]) / 2)
    ordered = torch.tensor([1.0, 0.0])
    found = losses(network, None, torch.tensor([0.75]), torch.tensor([0]), ordered, False)
    assert found["median_error"] == pytest.approx(0.0, abs=1e-6)


def test_gradients_in_bfloat16_are_those_in_float32(tests):
    _, frames = tests
    settings = InstrumentSettings(channels=[8, 16, 24], dropout=0.0)
    torch.manual_seed(0)
    network = InstrumentNetwork(settings, 2, 24)
    views, ordered, _, _ = training_views(frames[:8], 6, settings, np.random.default_rng(0))
    gradients = []
    frictions, materials = torch.linspace(0.2, 0.8, 8), torch.arange(8) % 2
    for bfloat16 in (False, True):
        network.zero_grad()
        part = losses(network, views, frictions, materials, ordered, bfloat16)
        (part["friction"] / 0.15 + 0.1 * part["material"] + 0.1 * part["order"]).backward()
        gradients.append(torch.cat([weight.grad.flatten() for weight in network.parameters()]))
    assert torch.nn.functional.cosine_similarity(*gradients, dim=0) > 0.999


def test_places_lie_between_neighbours_of_a_fabric_where_a_cloth_changes_smoothly():
    known = [  # fabric, replicate, coefficient, interpolated, trains
        ("a", "r00", 0.2, False, True),
        ("a", "r00", 0.4, False, True),
        ("a", "r00", 0.47, True, True),
        ("a", "r00", 0.47, True, True),
        ("b", "r00", 0.5, True, True),
        ("a", "r00", 0.6, False, True),
        ("a", "r00", 0.55, True, False),
        ("a", "r01", 0.5, True, True),  # of another bench: its cloth may lie on the other side
    ]
    names = ("material_id", "replicate_id", "friction", "interpolated")
    rows = [dict(zip(names, one[:4], strict=True)) for one in known]
    training = np.array([one[4] for one in known])
    assert next_frictions(rows, training).tolist() == [0, 2, 5, 5, 4, 5, 6, 7]


def test_places_are_found_with_errors_of_the_cloth_of_points_and_of_frames():
    spread_m = torch.tensor([0.01, 0.02, 0.04]).repeat(9, 1)
    noisy = noisy_keypoints(torch.zeros(4000, 2, 9, 3), spread_m, 0.002, np.random.default_rng(0))
    off_m = noisy * spread_m
    # Three errors of 2 mm; all points of a cloth share one, all frames of a point two.
    assert float(off_m.std()) == pytest.approx(0.002 * 3**0.5, rel=0.02)
    of_points = (off_m[:, 0, 0] * off_m[:, 1, 5]).mean() ** 0.5
    of_frames = (off_m[:, 0] * off_m[:, 1]).mean() ** 0.5
    assert float(of_points) == pytest.approx(0.002, rel=0.05)
    assert float(of_frames) == pytest.approx(0.002 * 2**0.5, rel=0.05)


def test_a_network_through_points_reads_from_places_and_friction_does_not_teach_them(tests):
    """Else it shifts them a little, by which it tells the videos that train."""
    _, frames = tests
    settings = InstrumentSettings(channels=[8, 16, 24], points_weight=1.0, through_points=True)
    network = InstrumentNetwork(settings, 2, 24)
    images = torch.from_numpy(frames[:3]).float() / 255
    with torch.inference_mode():
        seen = network.eval()(images)
        read = network.of_keypoints(seen["points"])
    for name, value in read.items():
        assert torch.equal(value, seen[name]), name
    seen = network.train()(images)
    (seen["friction"].sum() + seen["order"].sum() + seen["material"].sum()).backward()
    assert network.points.weight.grad is None
    assert all(layer.weight.grad is None for layer in network.convolutions)
    assert network.of_points[0].weight.grad is not None
    seen["points"].sum().backward()
    assert all(layer.weight.grad.abs().max() > 0 for layer in network.convolutions)


def test_a_millimetre_is_as_wrong_at_every_point():
    settings = InstrumentSettings(points_weight=1.0)
    network = InstrumentNetwork(settings, 2, 32)
    network.points_spread_m.copy_(torch.linspace(0.001, 0.06, 27).view(9, 3))
    off = keypoint_errors(network, -0.001 / network.points_spread_m.expand(2, 4, -1, -1))
    assert off.numpy() == pytest.approx(0.001 / KEYPOINT_ERROR_M)


def test_frames_are_drawn_at_any_phase_of_the_first_interval_and_disordered_ones_in_none():
    taken = phase_frames(50, 12, 4, np.random.default_rng(0))
    assert sampled_frames(12, 4).tolist() == [0, 3, 6, 9]
    assert {tuple(row) for row in taken.tolist()} == {(k, k + 3, k + 6, k + 9) for k in range(3)}
    video = np.arange(12, dtype=np.uint8)[:, None, None, None]
    for seed in range(30):
        assert not np.array_equal(disordered(video, np.random.default_rng(seed)), video)


def test_the_curve_in_the_terminal_falls_as_the_loss_does():
    assert curve([4.0, 3.0, 2.0, 1.0], width=4) == "█▆▃▁"
    assert curve([1.0, float("nan"), 2.0]) == "▁ █"
    assert len(curve(list(range(100)))) == 16
    assert curve([]) == ""
