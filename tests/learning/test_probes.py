"""What a probe must find, what it must not, and which datasets are refused."""

import struct
import zlib
from itertools import product

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support import synthetic_videos

from slipstitch.base.errors import BadInput
from slipstitch.dataset.dataset import write_dataset
from slipstitch.dataset.probes import (
    SIGNIFICANCE,
    UNTOLD,
    chance_of,
    check_nothing_told,
    linear_answers,
    standardised,
    untold_features,
)
from slipstitch.dataset.videos import ROLES, Videos, read_videos, takes_part
from slipstitch.learning.evaluation.test_sets import (
    MIDDLE_FRAME,
    WHAT,
    network_answers,
    probe_split,
    probes,
)

CONFIG = synthetic_videos.config(
    grid={
        "materials": ["gray-interlock", "ivory-rib-knit", "royal-target"],
        "frictions": [0.1, 0.3, 0.6, 1.0],
        "replicates": 2,
    },
    render={"textures": ["stripes", "tartan", "dots"]},
    sample={"validation_fraction": 0.1, "test_fraction": 0.2},
)


def row_of(**columns):
    """A row of the manifest, of a video that trains."""
    trains = dict.fromkeys([f"{kind}_role" for kind in ROLES], "train")
    return {**trains, "viewpoint": "calibrated", "viewpoint_id": "v00", **columns}


def grid_of_images(leak: float, seed: int = 0, viewpoint: str = "calibrated"):
    """Videos of 4 fabrics x 8 coefficients x 6 textures: rows and first frames.

    `leak` scales a faint pattern that every simulation has of its own, as a perturbed bench has.
    """
    random = np.random.default_rng(seed)
    texture = random.normal(0, 40, (6, 16, 16, 3))
    fabric = random.normal(0, 20, (4, 16, 16, 3))
    own = random.normal(0, 1, (4, 8, 16, 16, 3))
    rows, images = [], []
    for m, f, t in product(range(4), range(8), range(6)):
        known = {"friction": 0.1 * f, "simulation": f"m{m}f{f}", "viewpoint": viewpoint}
        ids = {"friction_id": f"f{100 * f:04d}", "material_id": f"m{m}", "texture_id": f"t{t}"}
        sides = {"split_by_video": random.choice(["train", "test"], p=[0.75, 0.25])}
        sides["split_by_simulation"] = "test" if (m + f) % 4 == 0 else "train"
        rows.append(row_of(**known, **ids, **sides))
        images.append(128 + texture[t] + fabric[m] + leak * own[m, f])
    return rows, np.clip(np.stack(images), 0, 255).astype(np.uint8)


def check(where, rows, images, sizes=None):
    """`check_nothing_told`, of files of equal size unless said otherwise."""
    check_nothing_told(where, rows, images, np.full(len(rows), 900) if sizes is None else sizes)


def test_benches_of_one_simulation_each_may_tell_it_where_whole_simulations_are_held_out():
    check("benches", *grid_of_images(6.0, viewpoint="bench_1"))
    rows, frames = grid_of_images(0.0, viewpoint="bench_1")
    floors = np.random.default_rng(0).normal(0, 10, (8, 16, 16, 3))
    drawn = frames + floors[[round(10 * row["friction"]) for row in rows]]
    with pytest.raises(BadInput, match="benches: split by simulation: the first frame tells"):
        check("benches", rows, np.clip(drawn, 0, 255).astype(np.uint8))


@pytest.mark.parametrize("seed", range(3))
def test_a_planted_leak_is_refused_in_one_line_and_clean_images_are_not(seed):
    check("clean", *grid_of_images(0.0, seed))
    with pytest.raises(BadInput) as problem:
        check("planted", *grid_of_images(6.0, seed))
    said = str(problem.value)
    assert said.startswith("planted: split by video: the first frame tells the friction")
    assert "without any contact (chance " in said and "\n" not in said


def test_a_pattern_of_the_simulation_alone_tells_nothing_of_new_simulations():
    """By simulation the same images are clean: that split does not meet a bench again."""
    rows, images = grid_of_images(6.0)
    labels = np.unique([row["friction"] for row in rows], return_inverse=True)[1]
    for split, learn in product(("by_video", "by_simulation"), (linear_answers, network_answers)):
        sides = np.array([row[f"split_{split}"] for row in rows])
        answers = learn(standardised(images, sides == "train"), labels, sides)
        right = (answers == labels)[sides == "test"].mean()
        assert right > 0.6 if split == "by_video" else right < 0.3


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


@pytest.mark.slow
def test_every_probe_is_a_row_in_both_splits_and_the_motion_shows_in_the_middle(dataset):
    every = list(probes(dataset))
    names = [f"{name}{end}" for name in WHAT for end in ("", "_network")]
    assert [found[:2] for found in every] == [
        (split, name) for split in ("by_video", "by_simulation") for name in names
    ]
    manifest = pq.read_table(dataset / "manifest.parquet").to_pylist()
    for split, name, classes, rows in every:
        assert len(classes) == 4
        tested = sum(row[f"split_{split}"] == "test" for row in manifest)
        assert len(rows) == tested or name.startswith("probe_order")
        if not name.startswith(MIDDLE_FRAME):
            assert np.mean([row["true"] == row["predicted"] for row in rows]) <= 0.5


@pytest.mark.slow
def test_a_floor_that_knows_the_coefficient_is_found_in_the_first_frame(dataset):
    videos = read_videos(dataset, takes_part, 32, 2)
    pixels = videos.pixels.copy()
    for row, video in zip(videos.rows, pixels, strict=True):
        video[0, -4:] = int(20 + 60 * row["friction"])  # below the cloth
    with pytest.raises(BadInput, match=r"by simulation: the first frame tells the friction"):
        list(probe_split(dataset, Videos(videos.rows, pixels, ""), "by_simulation"))


def planted(leak, seed=3, floors=("train",)):
    """240 videos of a simulation each, 4 coefficients: rows, first frames, sizes of files.

    Above is cloth, coloured at random in every video, below a grey floor. One thing is drawn by the
    coefficient: a spot of the floor, the size of the file, or (the other way about) the coefficient
    by the place in the order in which the videos train. With `floors` "test" every video is there
    once more, on a floor of the second training set, of which alone the leak is then.
    """
    random = np.random.default_rng(seed)
    label = random.permutation(np.tile(np.arange(4), 60))
    sides = np.array(["train", "train", "train", "test"] * 60)
    training = np.flatnonzero(sides == "train")
    if leak == "order":
        at = np.random.default_rng([0, 0]).permutation(training)
        label[at] = 4 * np.arange(len(at)) // len(at)
    rows, images, sizes = [], [], []
    for role in floors:
        leaks = leak if role == floors[-1] else ""
        for k in range(240):
            image = random.integers(0, 256, (32, 32, 3))
            image[31:] = 100 + random.normal(0, 2, (1, 32, 1))
            image[31, 3:5] += 5 * label[k] * (leaks == "background")
            images.append(image)
            sizes.append(900 + random.integers(9) + 10 * label[k] * (leaks == "file_size"))
            ids = {"friction_id": f"f{label[k]}", "material_id": f"m{k % 3}"}
            ids |= {"texture_id": f"t{k % 2}", "viewpoint_id": f"v{len(images) > 240:02d}"}
            held = dict.fromkeys(("split_by_video", "split_by_simulation"), sides[k])
            rows.append(row_of(floor_role=role, simulation=f"s{k}", **ids, **held))
    return rows, np.clip(np.stack(images), 0, 255).astype(np.uint8), np.array(sizes)


@pytest.mark.slow
@pytest.mark.parametrize("leak", ["background", "file_size", "order"])
def test_a_leak_is_found_by_the_probe_that_is_for_it_and_by_no_other(leak):
    rows, images, sizes = planted(leak)
    labels = np.unique([row["friction_id"] for row in rows], return_inverse=True)[1]
    names = np.array([row["simulation"] for row in rows])
    sides = np.array([row["split_by_simulation"] for row in rows])
    seen_by = untold_features(rows, images, sizes, sides)

    def finds(learn, name):
        seen, by = seen_by[name]
        test = by == "test"
        right = learn(standardised(seen, by == "train"), labels, by) == labels
        return chance_of(right[test], labels[test], names[test]) < SIGNIFICANCE

    assert [name for name in UNTOLD if finds(linear_answers, name)] == [leak]
    assert finds(network_answers, leak)
    with pytest.raises(BadInput) as problem:
        check_nothing_told("planted", rows, images, sizes)
    assert str(problem.value).startswith(f"planted: split by video: {UNTOLD[leak]} tells")
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize("leak", ["background", "file_size"])
def test_floors_of_the_second_training_set_that_know_the_coefficient_are_found(leak):
    """The first set is clean, so only a training with both would learn from them."""
    check_nothing_told("clean", *planted("", floors=("train", "test")))
    rows, images, sizes = planted(leak, floors=("train", "test"))
    check_nothing_told("first", rows[:240], images[:240], sizes[:240])
    with pytest.raises(BadInput, match=f"split by video reflective: {UNTOLD[leak]} tells"):
        check_nothing_told("both", rows, images, sizes)


def test_sampling_refuses_a_leak_before_anything_trains(tmp_path):
    """Files of images grow with friction; in every pixel they are as before."""
    config = synthetic_videos.config(
        grid={"frictions": [0.1, 1.0], "replicates": 4},
        sample={"validation_fraction": 0.1, "test_fraction": 0.4},
    )
    shards = synthetic_videos.write_shards(config, tmp_path / "render")
    for path in shards:
        table = pq.read_table(path)
        friction = int(path.name.split("_f")[1][:4])
        rows = table.to_pylist()
        for row in rows:
            row["image"]["bytes"] = commented(row["image"]["bytes"], 2 * friction)
        pq.write_table(pa.Table.from_pylist(rows, schema=table.schema), path)
    with pytest.raises(BadInput, match="by video: the size of the first frame's file tells"):
        write_dataset(config, shards, tmp_path / "sample")
    assert not (tmp_path / "sample" / "manifest.parquet").exists()


def commented(png: bytes, length: int) -> bytes:
    """A PNG file with a comment of so many bytes behind its header."""
    body = b"tEXt" + b"Comment\0" + bytes(length)
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    return png[:33] + chunk + png[33:]
