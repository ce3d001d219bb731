"""The instrument's files and what it says of any array of frames."""

import dataclasses
import json
import math
from itertools import permutations

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from support.models import untrained_instrument

from slipstitch.base.errors import BadInput
from slipstitch.config.train import InstrumentSettings
from slipstitch.dataset.videos import Videos
from slipstitch.learning.evaluation.metrics import covered
from slipstitch.learning.instrument.augmentation import (
    augmented,
    rectified_with_errors,
    standardised,
)
from slipstitch.learning.instrument.calibration import calibrated
from slipstitch.learning.instrument.measuring import (
    CARD,
    WEIGHTS,
    ErrorBars,
    load_instrument,
    save_instrument,
)
from slipstitch.learning.instrument.network import shifted_in_time
from slipstitch.learning.model_file import write_weights

FABRICS = ["gray-interlock", "royal-target"]


def untrained(**changes):
    settings = {"channels": [8, 16], "features": 16, "draws": 4} | changes
    return untrained_instrument(32, FABRICS, **settings)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("instrument")
    save_instrument(untrained(), folder)
    return folder


def frames(side=32, count=6, seed=0):
    random = np.random.default_rng(seed)
    return random.integers(0, 256, (count, side, side, 3), dtype=np.uint8)


def test_an_untrained_instrument_is_well_formed_and_says_that_it_knows_nothing(folder):
    measured = load_instrument(folder).measure(frames())
    grid, shares = measured.distribution
    assert (grid[0], grid[-1]) == measured.interval_90 == (0.0, 1.5)
    assert shares.sum() == pytest.approx(1.0)
    assert 0.0 <= measured.friction_coefficient <= 1.5
    assert set(measured.material_probabilities) == set(FABRICS)
    assert measured.attention_weights.shape == (6,)
    assert measured.attention_weights.sum() == pytest.approx(1.0)
    assert measured.alarm and "not calibrated" in measured.alarm_reason


def test_the_same_frames_give_the_same_answer_also_from_disk_and_at_another_size(folder):
    fresh, stored = (untrained(), load_instrument(folder / WEIGHTS))
    doubled = frames().repeat(2, axis=1).repeat(2, axis=2)
    seen = ((fresh, frames()), (stored, frames()), (stored, frames()), (stored, doubled))
    assert len({one.measure(video).friction_coefficient for one, video in seen}) == 1


@pytest.mark.parametrize(
    "wrong",
    [frames(count=5), frames()[:, :, :20], frames().astype(np.float32), frames()[..., 0], "frames"],
)
def test_other_arrays_are_refused(folder, wrong):
    with pytest.raises(BadInput, match=r"uint8 of shape \(6, side, side, 3\) is required"):
        load_instrument(folder).measure(wrong)


def test_exposure_and_colour_cast_do_not_matter():
    video = frames()[None] // 2
    darker = (video * np.array([0.5, 0.8, 0.9])).round().astype(np.uint8)
    torch.testing.assert_close(standardised(video), standardised(darker), atol=0.06, rtol=0)


def bars_of(*edges, value=200):
    """A black image with bright columns."""
    frame = np.zeros((32, 32, 3), np.uint8)
    for low, high in edges:
        frame[:, low:high] = value
    return frame


def centre_of(values):
    """Their centre of mass."""
    return (values * np.arange(len(values))).sum() / values.sum()


def test_an_image_is_rectified_with_the_errors_that_are_asked_for():
    # A move by a quarter of a pixel takes a quarter of the slope, which is 4 a pixel.
    row = (np.arange(32) * 4).astype(np.uint8)
    across = np.broadcast_to(row[None, :, None], (32, 32, 3)).copy()
    move, still = np.tile([0.25, 0.5], (3, 1)), np.zeros((3, 2))
    assert np.array_equal(rectified_with_errors(across, move, 0.0)[:, 1:], across[:, 1:] - 1)
    down = across.transpose(1, 0, 2).copy()
    assert np.array_equal(rectified_with_errors(down, move, 0.0)[1:], down[1:] - 2)
    # Corners that move apart stretch the image between them.
    apart = np.array([[-3.1, 0], [3.1, 0], [-3.1, 0]])
    line = rectified_with_errors(bars_of((10, 11), (20, 21)), apart, 0.0)[16, :, 0].astype(float)
    distance = 16 + centre_of(line[16:]) - centre_of(line[:16])
    assert distance == pytest.approx(10 * (31 + 6.2) / 31, abs=0.1)
    # A blurred edge has the width of its Gaussian.
    edge = bars_of((16, 32), value=255)
    step = np.diff(rectified_with_errors(edge, still, 0.7)[16, :, 0].astype(float))
    spread = (step * (np.arange(31) - centre_of(step)) ** 2).sum() / step.sum()
    assert spread == pytest.approx(0.49, rel=0.1)


@pytest.fixture
def clear(monkeypatch):
    """Augmentation without blur and noise."""
    for name in ("BLUR_PX", "NOISE"):
        monkeypatch.setattr(f"slipstitch.learning.instrument.augmentation.{name}", 0.0)


def test_an_augmented_video_moves_as_a_whole_by_parts_of_a_pixel(clear):
    reach = 0.02
    settings = InstrumentSettings(rectification_error=reach)
    video = np.stack([bars_of((10, 20))] * 6)[None]  # centred at 14.5

    def centre(look):
        weights = look[0, :, 16, :, 0] - look.min()
        return (weights * torch.arange(32)).sum(1) / weights.sum(1)

    moves = []
    for seed in range(20):
        at = centre(augmented(video, settings, np.random.default_rng(seed)))
        assert at.max() == at.min()  # all frames by the same
        moves.append(float(at[0]) - 14.5)
    assert max(np.abs(moves)) <= reach * 32 + 1 / 32
    assert len({round(move, 1) for move in moves}) > 5


def test_an_augmented_videos_colours_change_places(clear):
    settings = InstrumentSettings(rectification_error=0.0)
    video = frames()[None]
    orders = set()
    for seed in range(30):
        looked = augmented(video, settings, np.random.default_rng(seed))
        found = [
            order
            for order in permutations(range(3))
            if torch.equal(looked, standardised(video)[..., list(order)])
        ]
        assert len(found) == 1
        orders.add(found[0])
    assert len(orders) == 6


def test_features_shift_by_one_frame_within_their_video():
    maps = torch.arange(2 * 3 * 8.0).view(6, 8, 1, 1).expand(6, 8, 2, 2)
    moved = shifted_in_time(maps, 3)
    assert moved[0, 0, 0, 0] == moved[3, 0, 0, 0] == 0.0  # nothing before a video's first frame
    assert torch.equal(moved[1, 0], maps[0, 0])  # from the frame before
    assert torch.equal(moved[1, 1], maps[2, 1])  # from the frame after
    assert torch.equal(moved[:, 2:], maps[:, 2:])
    maps = torch.randn(6, 16, 3, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: shifted_in_time(x, 3), maps)


@pytest.mark.parametrize(
    "claim",
    [
        {"frames": None},
        {"frames": 0},
        {"materials": ["silk", 7]},
        {"materials": []},
        {"bfloat16": 1},
        {"pixels": 10**9},
        {"settings": {"friction_max": 1e12}},
        {"error_bars": {"spread": 1.0}},
    ],
)
def test_a_card_signed_anew_claims_nothing_that_is_not_so(folder, tmp_path, claim):
    """The digests fit; what the card says is looked at before anything is built from it."""
    tensors = load_file(folder / WEIGHTS)
    card = json.loads((folder / CARD).read_text())
    card.pop("weights_sha256")
    write_weights(tensors, {**card, **claim}, tmp_path / WEIGHTS, tmp_path / CARD)
    with pytest.raises(BadInput, match="do not match the card"):
        load_instrument(tmp_path)


def test_a_model_of_another_kind_is_refused(tmp_path):
    save_file({"weight": torch.zeros(2)}, tmp_path / WEIGHTS)
    (tmp_path / CARD).write_text('{"format": "slipstitch-lrcn-1"}')
    with pytest.raises(BadInput, match="'slipstitch-instrument-3' is needed"):
        load_instrument(tmp_path)


def test_too_few_calibration_simulations_are_told_from_enough(folder):
    instrument = load_instrument(folder)
    for factor, groups, said in (
        (math.inf, 4, "no error bar: calibrated on 4 simulations; 9 are needed"),
        (math.inf, 1, "no error bar: calibrated on 1 simulation; 9 are needed"),
        (1.3, 12, ""),
    ):
        bars = ErrorBars(1.0, 1.0, factor, alarm=None)
        card = instrument.card | {"calibration_simulations": groups}
        told = dataclasses.replace(instrument, error_bars=bars, card=card)
        assert told.without_error_bar == said


def test_an_instrument_trained_by_video_says_so(folder):
    instrument = load_instrument(folder)

    def caveats(split):
        return dataclasses.replace(instrument, card=instrument.card | {"split": split}).caveats

    for split in ("by_video", "by_video_reflective"):
        assert "trained with the split by video" in caveats(split)[0]
    assert caveats("by_simulation") == []


def test_a_truth_at_the_end_of_the_grid_is_inside_the_whole_grid():
    """1.3 is none of the numbers of float32, in which the network has its grid."""
    low, high = untrained(friction_max=1.3).measure(frames()).interval_90
    assert covered(*np.array([[low], [high], [1.3]]), ["m00_f1300_r00"])[0] == 1.0


def test_error_bars_from_unseen_fabrics_alone_leave_the_fabrics_probabilities():
    instrument = untrained()
    instrument = dataclasses.replace(instrument, card=instrument.card | {"dataset_digest": "own"})
    rows = [
        {"video": f"v{k}", "simulation": f"s{k}", "friction": 0.1 * k}
        | {"material": "gray-interlock" if k < 4 else "x"}
        for k in range(1, 16)
    ]
    videos = Videos(rows, np.stack([frames(seed=k) for k in range(15)]), "own")
    bars = calibrated(instrument, videos, np.arange(15) < 3).error_bars
    assert bars.material_temperature == 1.0
    assert math.isfinite(bars.conformal_scale)
