"""The instrument's files and what it says of any array of frames."""

import json

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from slipstitch.errors import BadInput
from slipstitch.instrument import load_instrument
from slipstitch.instrument.augmentation import augmented, standardised
from slipstitch.instrument.measuring import CARD, WEIGHTS, save_instrument, untrained_instrument
from slipstitch.instrument.network import shifted_in_time
from slipstitch.instrument.settings import InstrumentSettings
from slipstitch.train.model_file import write_weights

SETTINGS = InstrumentSettings(channels=[8, 16], features=16, recurrent_units=8)
FABRICS = ["gray-interlock", "royal-target"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("instrument")
    save_instrument(untrained_instrument(SETTINGS, FABRICS, 32, frames=6), folder)
    return folder


def frames(side=32, count=6, seed=0):
    random = np.random.default_rng(seed)
    return random.integers(0, 256, (count, side, side, 3), dtype=np.uint8)


def test_an_untrained_instrument_is_well_formed_and_says_that_it_knows_nothing(folder):
    measured = load_instrument(folder).measure(frames())
    grid, shares = measured.distribution
    assert grid[0] == 0.0
    assert grid[-1] == 1.5
    assert shares.sum() == pytest.approx(1.0)
    assert measured.interval_90 == (0.0, 1.5)
    assert 0.0 <= measured.friction_coefficient <= 1.5
    assert set(measured.material_probabilities) == set(FABRICS)
    assert measured.moments.shape == (6,)
    assert measured.moments.sum() == pytest.approx(1.0)
    assert measured.alarm
    assert "not calibrated" in measured.alarm_reason


def test_the_same_frames_give_the_same_answer_also_from_disk(folder):
    fresh, stored = (
        untrained_instrument(SETTINGS, FABRICS, 32, frames=6),
        load_instrument(folder / WEIGHTS),
    )
    answers = [one.measure(frames()).friction_coefficient for one in (fresh, stored, stored)]
    assert len(set(answers)) == 1


def test_larger_frames_are_brought_to_the_networks_size(folder):
    doubled = frames().repeat(2, axis=1).repeat(2, axis=2)
    instrument = load_instrument(folder)
    small, large = instrument.measure(frames()), instrument.measure(doubled)
    assert large.friction_coefficient == small.friction_coefficient


@pytest.mark.parametrize(
    "wrong",
    [
        frames(count=5),
        frames()[:, :, :20],
        frames().astype(np.float32),
        frames()[..., 0],
        "frames",
    ],
)
def test_other_arrays_are_refused(folder, wrong):
    with pytest.raises(BadInput, match=r"uint8 of shape \(6, side, side, 3\) is needed"):
        load_instrument(folder).measure(wrong)


def test_exposure_and_colour_cast_do_not_matter():
    video = frames()[None] // 2
    darker = (video * np.array([0.5, 0.8, 0.9])).round().astype(np.uint8)
    torch.testing.assert_close(standardised(video), standardised(darker), atol=0.06, rtol=0)


def test_an_augmented_video_is_the_same_scene_moved_and_recoloured():
    settings = InstrumentSettings(noise=0.0, shift_share=0.1)
    # Rows and columns that the statistics skip differ by the move: compare grey levels' order.
    pixels = np.kron(frames(side=8, count=6), np.ones((1, 4, 4, 1), np.uint8))[None]
    video = standardised(pixels)
    moved = augmented(pixels, settings, np.random.default_rng(1))
    inner = moved[0, :, 8:24, 8:24]
    found = [
        (down, across)
        for down in range(-3, 4)
        for across in range(-3, 4)
        if torch.equal(
            inner.sort(-1).values,
            video[0, :, 8 + down : 24 + down, 8 + across : 24 + across].sort(-1).values,
        )
    ]
    assert len(found) == 1


def test_features_shift_by_one_frame_within_their_video():
    maps = torch.arange(2 * 3 * 8.0).view(6, 8, 1, 1).expand(6, 8, 2, 2)
    moved = shifted_in_time(maps, 3)
    assert moved[0, 0, 0, 0] == 0.0  # nothing before a video's first frame
    assert moved[3, 0, 0, 0] == 0.0
    assert torch.equal(moved[1, 0], maps[0, 0])  # from the frame before
    assert torch.equal(moved[1, 1], maps[2, 1])  # from the frame after
    assert torch.equal(moved[:, 2:], maps[:, 2:])


def test_the_shifts_derivative_is_its_transpose():
    maps = torch.randn(6, 16, 3, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: shifted_in_time(x, 3), maps)


def test_altered_files_are_refused(folder, tmp_path):
    for name in (WEIGHTS, CARD):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    card = json.loads((tmp_path / CARD).read_text())
    (tmp_path / CARD).write_text(json.dumps({**card, "materials": ["silk", "wool"]}))
    with pytest.raises(BadInput, match="altered"):
        load_instrument(tmp_path)
    (tmp_path / CARD).write_text(json.dumps(card))
    (tmp_path / WEIGHTS).write_bytes((folder / WEIGHTS).read_bytes()[:-1] + b"?")
    with pytest.raises(BadInput, match="altered or damaged"):
        load_instrument(tmp_path)


@pytest.mark.parametrize(
    "claim",
    [
        {"frames": None},
        {"frames": 0},
        {"materials": ["silk", 7]},
        {"materials": []},
        {"bfloat16": 1},
        {"pixels": 10**9},
        {"settings": {"friction_step": 1e-12}},
        {"error_bars": {"temperature": 1.0}},
    ],
)
def test_a_card_signed_anew_claims_nothing_that_is_not_so(folder, tmp_path, claim):
    """The digests fit; what the card says is looked at before anything is built from it."""
    with safe_open(folder / WEIGHTS, "pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    card = json.loads((folder / CARD).read_text())
    card.pop("weights_sha256")
    write_weights(tensors, {**card, **claim}, tmp_path / WEIGHTS, tmp_path / CARD)
    with pytest.raises(BadInput, match="do not fit the card"):
        load_instrument(tmp_path)


def test_foreign_files_are_refused(folder, tmp_path):
    with pytest.raises(BadInput, match="no such file"):
        load_instrument(tmp_path)
    save_file({"weight": torch.zeros(2)}, tmp_path / WEIGHTS)
    (tmp_path / CARD).write_text("{}")
    with pytest.raises(BadInput, match="no model card of Slipstitch"):
        load_instrument(tmp_path)
    (tmp_path / CARD).write_text('{"format": "slipstitch-lrcn-1"}')
    with pytest.raises(BadInput, match="'slipstitch-instrument-1' is needed"):
        load_instrument(tmp_path)
