"""Which frames and which videos: the choices that labels and honesty hang on."""

import itertools
from collections import Counter

import numpy as np
import pytest

from slipstitch.base.errors import BadInput
from slipstitch.config import resolve_config
from slipstitch.design.grid import simulations
from slipstitch.design.sampled_frames import sampled_frames
from slipstitch.design.splits import (
    check_no_simulation_on_both_sides,
    sides_of_simulations,
    split_by_simulation,
    split_by_video,
)


def grid(materials, frictions, replicates):
    return [
        (f"m{m:02d}", f"f{f:02d}", f"r{r:02d}")
        for m, f, r in itertools.product(range(materials), range(frictions), range(replicates))
    ]


def test_the_papers_frames_are_every_tenth_from_the_first():
    assert sampled_frames(300, 30).tolist() == list(range(0, 300, 10))


@pytest.mark.parametrize(("total", "sampled"), [(300, 7), (31, 30), (30, 30), (5, 1)])
def test_intervals_are_regular_to_one_frame(total, sampled):
    frames = sampled_frames(total, sampled)
    assert len(frames) == sampled and frames[0] == 0 and frames[-1] < total
    gaps = np.diff(np.append(frames, total))
    assert gaps.min() >= 1 and gaps.max() - gaps.min() <= 1


@pytest.mark.parametrize(("total", "sampled"), [(10, 11), (10, 0), (0, 1)])
def test_more_frames_than_there_are_is_refused(total, sampled):
    with pytest.raises(BadInput, match="cannot be sampled"):
        sampled_frames(total, sampled)


def test_by_video_has_the_asked_shares_and_does_not_depend_on_the_order_of_the_ids():
    videos = [f"v{i}" for i in range(200)]
    sides = split_by_video(videos, 0.1, 0.1, seed=3)
    assert Counter(sides.values()) == {"train": 160, "validation": 20, "test": 20}
    assert sides == split_by_video(videos[::-1], 0.1, 0.1, seed=3)
    assert sides != split_by_video(videos, 0.1, 0.1, seed=4)


def test_two_replicates_one_of_every_pair_trains_and_every_friction_is_tested_equally():
    sides = split_by_simulation(grid(3, 4, 2), 0.1, 0.1, seed=1)
    assert Counter(sides.values()) == {"train": 12, "validation": 4, "test": 8}
    pairs = {one[:2] for one, side in sides.items() if side == "train"}
    assert len(pairs) == 12
    assert set(Counter(one[1] for one, side in sides.items() if side == "test").values()) == {2}
    assert {one[2] for one, side in sides.items() if side == "train"} == {"r00"}


def test_ten_replicates_give_the_asked_shares():
    sides = split_by_simulation(grid(10, 16, 10), 0.1, 0.1, seed=1)
    assert Counter(sides.values()) == {"train": 1280, "validation": 160, "test": 160}


@pytest.mark.parametrize(("materials", "frictions"), [(10, 16), (2, 2), (3, 4), (4, 3)])
def test_without_replicates_whole_pairs_are_held_out_and_no_class_goes_untrained(
    materials, frictions
):
    everything = grid(materials, frictions, 1)
    sides = split_by_simulation(everything, 0.1, 0.1, seed=5)
    assert set(sides) == set(everything)
    trained = [one for one, side in sides.items() if side == "train"]
    assert len({one[0] for one in trained}) == materials
    assert len({one[1] for one in trained}) == frictions
    tested = Counter(one[1] for one, side in sides.items() if side == "test")
    assert len(tested) == frictions and len(set(tested.values())) == 1


def test_a_coefficient_that_only_trains_is_never_held_out_and_moves_no_other():
    """Of a fabric for validation only nothing trains, at this coefficient neither."""
    fabrics = ["gray-interlock", "royal-target", "ivory-rib-knit", "tango-red-jet-set"]
    sample = {"hold_out": "pair", "validation_materials": ["royal-target"]}

    def sides(frictions, only):
        config = resolve_config(
            {
                "grid": {"materials": fabrics, "frictions": frictions},
                "sample": {**sample, "train_only_frictions": only},
            }
        )
        held = sides_of_simulations(config)
        return {
            (one.material, one.friction, one.replicate): held[one.id] for one in simulations(config)
        }

    found = sides([0.1, 0.5, 1.0, 1.75], [1.75])
    for (material, friction, _), side in found.items():
        if friction == 1.75:
            assert side == ("validation" if material == "royal-target" else "train")
    rest = {key: side for key, side in found.items() if key[1] != 1.75}
    assert rest == sides([0.1, 0.5, 1.0], [])
    assert set(rest.values()) == {"train", "validation", "test"}


@pytest.mark.parametrize(("materials", "frictions"), [(1, 4), (1, 1), (2, 1)])
def test_a_grid_too_small_to_hold_anything_out_is_refused(materials, frictions):
    with pytest.raises(BadInput, match="at least 2 replicates are needed"):
        split_by_simulation(grid(materials, frictions, 1), 0.1, 0.1, seed=0)


def test_replicates_that_do_not_exist_cannot_be_held_out():
    with pytest.raises(BadInput, match=r"grid\.replicates must be at least 2"):
        split_by_simulation(grid(3, 3, 1), 0.1, 0.1, seed=0, hold_out="replicate")


def test_a_simulation_on_both_sides_is_named():
    with pytest.raises(BadInput, match=r"leaks: a is in train and test \(1 of 2"):
        check_no_simulation_on_both_sides(["a", "b", "a"], ["train", "test", "test"])
    check_no_simulation_on_both_sides(["a", "b", "a"], ["train", "test", "train"])
