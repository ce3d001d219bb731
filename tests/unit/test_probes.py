"""What a probe must find, what it must not, and which datasets are refused."""

import numpy as np
import pyarrow.parquet as pq
import pytest
from support import synthetic_videos

from slipstitch.config.evaluate import EvaluateSettings
from slipstitch.errors import BadInput
from slipstitch.evaluate.probes import MIDDLE_FRAME, WHAT, network_answers, probe_split, probes
from slipstitch.sample.dataset import write_dataset
from slipstitch.sample.probes import (
    SIGNIFICANCE,
    chance_of,
    check_first_frames,
    linear_answers,
    refuse_leak,
    standardised,
)
from slipstitch.sample.videos import Videos

CONFIG = synthetic_videos.config(
    grid={
        "materials": ["gray-interlock", "ivory-rib-knit", "royal-target"],
        "frictions": [0.1, 0.3, 0.6, 1.0],
        "replicates": 2,
    },
    render={"textures": ["stripes", "tartan", "dots"]},
    sample={"validation_fraction": 0.1, "test_fraction": 0.2},
)


@pytest.fixture(scope="module")
def shards(tmp_path_factory):
    return synthetic_videos.write_shards(CONFIG, tmp_path_factory.mktemp("render"))


@pytest.fixture(scope="module")
def dataset(shards, tmp_path_factory):
    folder = tmp_path_factory.mktemp("sample")
    write_dataset(CONFIG, shards, folder)
    return folder


def grid_of_images(leak: float, seed: int = 0, viewpoint: str = "calibrated"):
    """Videos of 4 fabrics x 8 coefficients x 6 textures: rows and first frames.

    `leak` scales a faint pattern that every simulation has of its own, as a perturbed bench has.
    """
    random = np.random.default_rng(seed)
    texture = random.normal(0, 40, (6, 16, 16, 3))
    fabric = random.normal(0, 20, (4, 16, 16, 3))
    own = random.normal(0, 1, (4, 8, 16, 16, 3))
    rows, images = [], []
    for m in range(4):
        for f in range(8):
            for t in range(6):
                side = random.choice(["train", "test"], p=[0.75, 0.25])
                rows.append(
                    {
                        "friction": 0.1 * f,
                        "friction_id": f"f{100 * f:04d}",
                        "viewpoint": viewpoint,
                        "simulation": f"m{m}f{f}",
                        "split_by_video": side,
                        "split_by_simulation": "test" if (m + f) % 4 == 0 else "train",
                    }
                )
                images.append(128 + texture[t] + fabric[m] + leak * own[m, f])
    return rows, np.clip(np.stack(images), 0, 255).astype(np.uint8)


def test_benches_of_one_simulation_each_may_tell_it_where_whole_simulations_are_held_out():
    check_first_frames("benches", *grid_of_images(6.0, viewpoint="bench_1"))
    rows, frames = grid_of_images(0.0, viewpoint="bench_1")
    floors = np.random.default_rng(0).normal(0, 10, (8, 16, 16, 3))
    drawn = floors[[round(10 * row["friction"]) for row in rows]]
    with pytest.raises(BadInput, match="benches: split by simulation: the first frame tells"):
        check_first_frames("benches", rows, np.clip(frames + drawn, 0, 255).astype(np.uint8))


@pytest.mark.parametrize("seed", range(3))
def test_a_planted_leak_is_refused_in_one_line_and_clean_images_are_not(seed):
    check_first_frames("clean", *grid_of_images(0.0, seed))
    with pytest.raises(BadInput) as problem:
        check_first_frames("planted", *grid_of_images(6.0, seed))
    said = str(problem.value)
    assert said.startswith("planted: split by video: the first frame tells the friction")
    assert "without any contact (chance " in said and "\n" not in said


def test_a_pattern_of_the_simulation_alone_tells_nothing_of_new_simulations():
    """By simulation the same images are clean: that split does not meet a bench again."""
    rows, images = grid_of_images(6.0)
    labels = np.unique([row["friction"] for row in rows], return_inverse=True)[1]
    right = {}
    for split in ("by_video", "by_simulation"):
        sides = np.array([row[f"split_{split}"] for row in rows])
        for learn in (linear_answers, network_answers):
            answers = learn(standardised(images, sides == "train"), labels, sides)
            right[split, learn] = (answers == labels)[sides == "test"].mean()
    assert all(right["by_video", learn] > 0.6 for learn in (linear_answers, network_answers))
    assert all(right["by_simulation", learn] < 0.3 for learn in (linear_answers, network_answers))


def test_guessing_is_seldom_called_a_leak():
    """The videos of a simulation fall together, and still no more than so many are refused."""
    random = np.random.default_rng(3)
    refused = 0
    labels = np.repeat(np.arange(8), 5 * 4)
    names = [f"s{k // 4}" for k in range(len(labels))]
    for _ in range(2000):
        guessed = np.repeat(random.integers(0, 8, 40), 4)
        refused += chance_of(guessed == labels, labels, names) < SIGNIFICANCE
    assert refused <= 6  # 2 are expected at most


def test_every_probe_is_a_row_in_both_splits_and_the_motion_shows_in_the_middle(dataset):
    found = probes(EvaluateSettings(), dataset)
    rows = pq.read_table(dataset / "manifest.parquet").to_pylist()
    for split, of_split in found.items():
        assert list(of_split) == [f"{name}{end}" for name in WHAT for end in ("", "_network")]
        tested = sum(row[f"split_{split}"] == "test" for row in rows)
        for name, detail in of_split.items():
            assert detail["n"] == tested or name.startswith("probe_order")
            assert np.sum(detail["confusion"]) == detail["n"]
            if not name.startswith(MIDDLE_FRAME):
                assert detail["mean"]["friction_lt_0.1"] <= 0.5
    # The drawn cloths lean by friction from the first frame on, and stand upright in it.
    assert found["by_simulation"][MIDDLE_FRAME]["chance"]["uniform"] == 0.25


def test_a_floor_that_knows_the_coefficient_is_found_in_the_background(dataset):
    videos = _videos(dataset)
    pixels = videos.pixels.copy()
    for row, video in zip(videos.rows, pixels, strict=True):
        video[0, -4:] = int(20 + 60 * row["friction"])  # below the cloth
    with pytest.raises(BadInput, match=r"by simulation: the first frame tells the friction"):
        probe_split(EvaluateSettings(), dataset, Videos(videos.rows, pixels, ""), "by_simulation")


def test_a_size_of_files_that_knows_the_coefficient_is_found():
    labels = np.tile(np.arange(4), 60)
    sides = np.array(["train", "train", "test"] * 80)
    names = [f"s{k}" for k in range(240)]
    size = standardised((labels * 40 + np.arange(240) % 7)[:, None], sides == "train")
    right = network_answers(size, labels, sides) == labels
    with pytest.raises(BadInput, match="the size of the first frame's file tells the friction"):
        test = sides == "test"
        refuse_leak(WHAT["probe_file_size"], right[test], labels[test], np.array(names)[test])


def _videos(dataset):
    from slipstitch.sample.videos import read_videos, takes_part

    return read_videos(dataset, takes_part, 32, 2)
