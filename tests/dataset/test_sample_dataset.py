"""The dataset is complete, labelled, reproducible; what is wrong with the shards is said."""

import io
import itertools
import json
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image
from support import synthetic_videos as synthetic
from support.refusal import refused, run

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import read_metadata, read_provenance
from slipstitch.config import resolve_config, write_config
from slipstitch.config.train import REFLECTIVE
from slipstitch.dataset.dataset import write_dataset
from slipstitch.dataset.videos import read_videos, takes_part
from slipstitch.design import splits
from slipstitch.design.grid import sampled_frames, simulations


@pytest.fixture(scope="module")
def config():
    return synthetic.config()


@pytest.fixture(scope="module")
def rendered(config, tmp_path_factory):
    return synthetic.write_shards(config, tmp_path_factory.mktemp("render"))


@pytest.fixture
def shards(rendered, tmp_path):
    """Copies that a test may damage."""
    return [Path(shutil.copy(path, tmp_path)) for path in rendered]


def test_every_video_has_its_frames_labels_and_sides(config, rendered, tmp_path):
    rows = write_dataset(config, rendered, tmp_path)
    assert len(rows) == 2 * 2 * 2 * 2 * 2
    manifest = pq.read_table(tmp_path / "manifest.parquet").to_pylist()
    assert manifest == rows
    one = rows[-1]
    table = pq.read_table(tmp_path / one["file"])
    frames = [row for row in table.to_pylist() if row["video"] == one["video"]]
    assert [(row["position"], row["frame"]) for row in frames] == [*enumerate(range(0, 60, 10))]
    for row in frames:
        assert (row["material"], row["friction"]) == (one["material"], one["friction"])
        with Image.open(io.BytesIO(row["image"]["bytes"])) as image:
            assert image.size == (16, 16)
    assert read_videos(tmp_path).points_m is None  # these shards have none
    # The files say that they hold images and where they come from.
    path = tmp_path / rows[0]["file"]
    features = json.loads(pq.read_schema(path).metadata[b"huggingface"])["info"]["features"]
    assert features["image"] == {"_type": "Image"}
    assert features["friction"] == {"dtype": "float64", "_type": "Value"}
    record = read_provenance(path)
    assert record["stage"] == "sample" and len(record["inputs"]) == 2


def test_places_of_points_go_with_their_frames(config, tmp_path):
    synthetic.write_dataset(config, tmp_path, marked=True)
    shards = sorted((tmp_path / "render").glob("*.parquet"))
    videos = read_videos(tmp_path / "sample", frames=3)
    known = read_metadata(shards[0])["marked_points_m"]
    names = [f"{row['simulation']}_{row['viewpoint_id']}" for row in videos.rows]
    of_shard = [k for k, name in enumerate(names) if name == shards[0].stem]
    assert len(of_shard) == 2  # textures
    for k in of_shard:
        for place, frame in zip(videos.points_m[k], (0, 20, 40), strict=True):
            np.testing.assert_allclose(place.ravel(), known[str(frame)], atol=1e-6)
    assert videos.chosen(np.arange(len(videos)) == 1).points_m.shape == (1, 3, 9, 3)


def test_equal_shards_and_seeds_give_equal_datasets(config, rendered, tmp_path):
    first = write_dataset(config, rendered, tmp_path / "a")
    second = write_dataset(config, rendered[::-1], tmp_path / "b")
    assert first == second
    manifests = [read_metadata(tmp_path / name / "manifest.parquet") for name in "ab"]
    assert len({one["dataset_digest"] for one in manifests}) == 1
    other = write_dataset(synthetic.config(seed=2), rendered, tmp_path / "c")
    assert [row["split_by_video"] for row in other] != [row["split_by_video"] for row in first]


def sampled(folder, **sections):
    """The rows of a dataset of such a configuration."""
    config = synthetic.config(**sections)
    return write_dataset(config, synthetic.write_shards(config, folder), folder / "sample")


def test_what_is_for_testing_only_is_marked_and_never_trains(tmp_path):
    """Textures and viewpoints test by video; coefficients and fabrics off the grid in both."""
    looks = {"test_textures": ["chevron"], "test_viewpoints": ["calibrated_-15"]}
    further = {"test_frictions": [0.35], "test_materials": ["royal-target"]}
    only = {"texture": "chevron", "viewpoint": "calibrated_-15"}
    only |= {"friction": 0.35, "material": "royal-target"}
    rows = sampled(tmp_path / "further", render=looks, grid=further)
    for row in rows:
        new = {kind for kind, value in only.items() if row[kind] == value}
        assert new == {kind for kind in only if row[f"{kind}_role"] == "test"}
        assert not new or row["split_by_video"] == "test"
        assert not new & {"friction", "material"} or row["split_by_simulation"] == "test"
    assert {row["viewpoint_turn_deg"] for row in rows if row["viewpoint_role"] == "test"} == {-15}
    assert {row["friction_id"] for row in rows if row["friction_role"] == "test"} == {"f0350"}
    sides = {row["video"]: row["split_by_simulation"] for row in rows}
    without = sampled(tmp_path / "without")
    assert all(sides[row["video"]] == row["split_by_simulation"] for row in without)


def test_videos_on_other_floors_have_the_sides_of_the_same_on_their_own(tmp_path):
    rows = sampled(tmp_path, render={"reflective_floors": ["ceramic"]})
    key = ("simulation", "texture", "viewpoint")
    own = {tuple(row[k] for k in key): row for row in rows if row["floor_role"] == "train"}
    others = [row for row in rows if row["floor_role"] == "test"]
    assert len(others) == len(own) == len(rows) / 2
    for row in others:
        twin = own[tuple(row[k] for k in key)]
        assert row["video"] != twin["video"]
        assert all(row[side] == twin[side] for side in ("split_by_video", "split_by_simulation"))
        assert not takes_part(row) and takes_part(row, REFLECTIVE) and takes_part(twin, REFLECTIVE)


def test_more_phases_keep_more_frames_and_the_same_first_ones(config, tmp_path):
    rows = sampled(tmp_path, sample={"frames": 6, "phases": 2})
    assert {row["frames"] for row in rows} == {12}
    table = pq.read_table(tmp_path / "sample" / rows[0]["file"], columns=["video", "frame"])
    kept = [row["frame"] for row in table.to_pylist() if row["video"] == rows[0]["video"]]
    assert kept[::2] == sampled_frames(config.simulation.frames, config.sample.frames).tolist()


def test_a_missing_shard_is_named_by_its_simulation_or_video(config, rendered, tmp_path):
    with pytest.raises(BadInput, match=r"no image shard of simulation m\d\d_f0100_r00 \(1 of"):
        write_dataset(config, rendered[2:], tmp_path)
    with pytest.raises(BadInput, match=r"no images of video m\d\d_f0100_r00_t00_v00"):
        write_dataset(config, rendered[1:], tmp_path)


def _spoil(rows):
    rows[3]["image"]["bytes"] = rows[3]["image"]["bytes"][:40]
    return rows


#: What becomes of the rows of a shard, or of the configuration -> what is said.
WRONG = [
    (lambda rows: [row for row in rows if row["frame"] != 20], {}, "lacks frame 20"),
    (lambda rows: [*rows, rows[0]], {}, "has frame 0 twice"),
    (_spoil, {}, "frame 30: not an image file, or a damaged image"),
    (list, {"render": {"pixels": 32}}, "image is 16x16 RGB; must be 32x32 RGB"),
    (list, {"grid": {"replicates": 1}}, r"'m\d\d_f\d+_r01' is not in the configured grid"),
]


@pytest.mark.parametrize(("change", "sections", "problem"), WRONG)
def test_what_is_wrong_with_the_images_is_named(shards, tmp_path, change, sections, problem):
    table = pq.read_table(shards[0])
    changed = pa.Table.from_pylist(change(table.to_pylist()), schema=table.schema)
    pq.write_table(changed, shards[0])
    with pytest.raises(BadInput, match=problem):
        write_dataset(synthetic.config(**sections), shards, tmp_path / "out")


def test_the_command_says_what_it_wrote_and_of_a_damaged_file_one_line(
    config, shards, tmp_path, capsys
):
    write_config(config, tmp_path / "c.json")
    paths = " ".join(map(str, shards))
    command = f"sample --config {tmp_path}/c.json --out-dir {tmp_path}/o {paths}"
    assert run(command) == 0
    said = capsys.readouterr().out
    assert "32 videos of 8 simulations, 6 frames each" in said
    assert "by_video: 26 train, 3 validation, 3 test" in said
    shards[0].write_bytes(shards[0].read_bytes()[:500])
    assert "damaged or not a Parquet file" in refused(capsys, command)


# Which frames and which videos: the choices that labels and honesty hang on


def grid(materials, frictions, replicates):
    return [
        (f"m{m:02d}", f"f{f:02d}", f"r{r:02d}")
        for m, f, r in itertools.product(range(materials), range(frictions), range(replicates))
    ]


@pytest.mark.parametrize(("total", "sampled"), [(300, 7), (31, 30), (30, 30), (5, 1)])
def test_intervals_are_regular_to_one_frame(total, sampled):
    frames = sampled_frames(total, sampled)
    assert len(frames) == sampled and frames[0] == 0 and frames[-1] < total
    gaps = np.diff(np.append(frames, total))
    assert gaps.min() >= 1 and gaps.max() - gaps.min() <= 1
    assert sampled_frames(300, 30).tolist() == list(range(0, 300, 10))  # the paper's
    for most, asked in ((10, 11), (10, 0), (0, 1)):
        with pytest.raises(BadInput, match="cannot be sampled"):
            sampled_frames(most, asked)


def test_by_video_has_the_asked_shares_and_does_not_depend_on_the_order_of_the_ids():
    videos = [f"v{i}" for i in range(200)]
    sides = splits.split_by_video(videos, 0.1, 0.1, seed=3)
    assert Counter(sides.values()) == {"train": 160, "validation": 20, "test": 20}
    assert sides == splits.split_by_video(videos[::-1], 0.1, 0.1, seed=3)
    assert sides != splits.split_by_video(videos, 0.1, 0.1, seed=4)


def test_two_replicates_one_of_every_pair_trains_and_every_friction_is_tested_equally():
    sides = splits.split_by_simulation(grid(3, 4, 2), 0.1, 0.1, seed=1)
    assert Counter(sides.values()) == {"train": 12, "validation": 4, "test": 8}
    trained = [one for one, side in sides.items() if side == "train"]
    assert len({one[:2] for one in trained}) == 12 and {one[2] for one in trained} == {"r00"}
    assert set(Counter(one[1] for one, side in sides.items() if side == "test").values()) == {2}
    sides = splits.split_by_simulation(grid(10, 16, 10), 0.1, 0.1, seed=1)
    assert Counter(sides.values()) == {"train": 1280, "validation": 160, "test": 160}


@pytest.mark.parametrize(("materials", "frictions"), [(10, 16), (2, 2), (3, 4), (4, 3)])
def test_without_replicates_whole_pairs_are_held_out_and_no_class_goes_untrained(
    materials, frictions
):
    everything = grid(materials, frictions, 1)
    sides = splits.split_by_simulation(everything, 0.1, 0.1, seed=5)
    assert set(sides) == set(everything)
    trained = [one for one, side in sides.items() if side == "train"]
    assert [len({one[k] for one in trained}) for k in (0, 1)] == [materials, frictions]
    tested = Counter(one[1] for one, side in sides.items() if side == "test")
    assert len(tested) == frictions and len(set(tested.values())) == 1


def test_a_coefficient_that_only_trains_is_never_held_out_and_moves_no_other():
    """Of a fabric for validation only nothing trains, at this coefficient neither."""
    fabrics = ["gray-interlock", "royal-target", "ivory-rib-knit", "tango-red-jet-set"]
    sample = {"hold_out": "pair", "validation_materials": ["royal-target"]}

    def sides(frictions, only):
        grid = {"materials": fabrics, "frictions": frictions}
        chosen = {"grid": grid, "sample": sample | {"train_only_frictions": only}}
        config = resolve_config(chosen)
        held = splits.sides_of_simulations(config)
        names = simulations(config)
        return {(one.material, one.friction, one.replicate): held[one.id] for one in names}

    found = sides([0.1, 0.5, 1.0, 1.75], [1.75])
    for (material, friction, _), side in found.items():
        if friction == 1.75:
            assert side == ("validation" if material == "royal-target" else "train")
    rest = {key: side for key, side in found.items() if key[1] != 1.75}
    assert rest == sides([0.1, 0.5, 1.0], [])
    assert set(rest.values()) == {"train", "validation", "test"}


@pytest.mark.parametrize(("materials", "frictions"), [(1, 4), (1, 1), (2, 1)])
def test_a_grid_too_small_to_hold_anything_out_is_refused(materials, frictions):
    for options, problem in (
        ({}, "at least 2 replicates are needed"),
        ({"hold_out": "replicate"}, r"grid\.replicates must be at least 2"),
    ):
        with pytest.raises(BadInput, match=problem):
            splits.split_by_simulation(grid(materials, frictions, 1), 0.1, 0.1, seed=0, **options)


def test_a_simulation_on_both_sides_is_named():
    with pytest.raises(BadInput, match=r"leaks: a is in train and test \(1 of 2"):
        splits.check_no_simulation_on_both_sides(["a", "b", "a"], ["train", "test", "test"])
    splits.check_no_simulation_on_both_sides(["a", "b", "a"], ["train", "test", "train"])
