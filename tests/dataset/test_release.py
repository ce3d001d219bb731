"""A release: complete, loadable with the lines of its card, the same again, never half there."""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from support import analytic_stage, synthetic_chain
from support.refusal import run

from slipstitch.base.errors import BadInput, SlipstitchError
from slipstitch.base.provenance import attach_metadata, read_metadata
from slipstitch.config.catalogue import VIEWPOINTS, fabric_names
from slipstitch.dataset.audit.auditing import audit_release
from slipstitch.dataset.manifest import dataset_digest, read_manifest
from slipstitch.dataset.release import assembly, manifest
from slipstitch.dataset.release.assembly import write_release
from slipstitch.dataset.release.checksums import SUMS, read_sums
from slipstitch.dataset.release.records import rows_digest
from slipstitch.dataset.videos import decode, pixels_digest
from slipstitch.design.grid import films, simulations
from slipstitch.design.interpolation import filmed_friction, interpolations
from slipstitch.design.splits import sides_of_simulations
from slipstitch.images.camera import pose

ROOT = Path(__file__).parents[2]
CONFIG = synthetic_chain.config()


@pytest.fixture(scope="module")
def listed(original):
    return pq.read_table(original / "manifest.parquet").to_pylist()


def test_every_video_is_where_the_manifest_says_with_the_pixels_it_says(original, listed):
    for row in listed:
        table = pq.read_table(original / row["shard"]).slice(row["first_row"], row["frames"])
        assert set(table["video"].to_pylist()) == {row["video"]}
        assert table["position"].to_pylist() == list(range(row["frames"]))
        images = [decode(image["bytes"], row["video"]) for image in table["image"].to_pylist()]
        assert pixels_digest(np.stack(images)) == row["pixels_sha256"]


def test_shards_are_cut_at_the_configured_size(original):
    shards = sorted((original / "data").iterdir())
    parts = Counter(path.name.partition("-")[0] for path in shards)
    assert len(shards) > len(parts)
    for path in shards:
        part, number, _, count = path.stem.split("-")
        assert parts[part] == int(count)
        if int(number) + 1 < int(count):
            assert pq.read_table(path).nbytes >= CONFIG.release.shard_mb * 1e6


def test_sums_are_those_of_sha256sum_and_no_file_may_be_written(original):
    words = ["sha256sum", "--check", "--strict", "--quiet", SUMS]
    answer = subprocess.run(words, cwd=original, capture_output=True)
    assert answer.returncode == 0, answer.stdout
    there = {
        path.relative_to(original).as_posix() for path in original.rglob("*") if path.is_file()
    }
    assert set(read_sums(original)) == there - {SUMS}
    assert all((original / name).stat().st_mode & 0o222 == 0 for name in there)


def test_sampled_manifest_can_be_had_back(original, results, listed):
    sampled = results / "sample/manifest.parquet"
    notes = read_metadata(original / "manifest.parquet")
    rows = manifest.sampled_rows(listed, notes["sampled_columns"])
    assert rows == read_manifest(sampled.parent)[0]
    assert dataset_digest(rows) == read_metadata(sampled)["dataset_digest"]


def test_splits_of_the_manifest_keep_apart_what_they_say(listed):
    frame = pd.DataFrame(listed)
    trains = (frame.texture_role == "train") & (frame.viewpoint_role == "train")

    def side(split, name):
        return frame[frame[f"split_{split}"] == name]

    held_out = {"by_simulation": "simulation", "unseen_friction": "friction"}
    held_out |= {"unseen_fabric": "material", "unseen_texture": "texture"}
    for split, held in (held_out | {"unseen_viewpoint": "viewpoint"}).items():
        test, train = side(split, "test"), side(split, "train")
        assert len(test) and len(train) and trains[train.index].all()
        assert not set(test[held]) & set(train[held]), split
    for split in ("by_video", "by_simulation", "unseen_friction", "unseen_fabric"):
        assert trains[frame[f"split_{split}"].notna()].all()
    assert set(side("unseen_texture", "test").viewpoint_role) == {"train"}
    assert set(side("unseen_friction", "test").friction) == {0.6}
    assert set(side("by_video", "test").simulation) & set(side("by_video", "train").simulation)


def test_unseen_frictions_lie_between_seen_ones():
    for frictions, share, expected in (
        ([0.1, 0.6], 0.2, []),
        ([0.1, 0.3, 1.0], 0.2, [0.3]),
        ([k / 10 for k in range(16)], 0.2, [0.3, 0.8, 1.2]),
        ([0.1, 0.2, 0.3, 0.4], 0.9, [0.3]),
    ):
        assert manifest.unseen_frictions(frictions, share) == expected


def test_unseen_fabrics_are_drawn_with_the_seed_and_leave_some_to_train():
    names = [f"fabric {k}" for k in range(10)]
    drawn = {tuple(manifest.unseen_fabrics(names, 0.2, seed)) for seed in range(20)}
    assert len(drawn) > 5 and {len(one) for one in drawn} == {2}
    assert manifest.unseen_fabrics(names, 0.2, 3) == manifest.unseen_fabrics(names[::-1], 0.2, 3)
    assert manifest.unseen_fabrics(["one"], 0.2, 1) == []
    assert len(manifest.unseen_fabrics(["one", "two"], 0.9, 1)) == 1


def test_interpolated_videos_bring_nothing_of_what_is_held_out_into_training():
    """Of 6 coefficients and 4 fabrics, films lie between any neighbours that are dragged."""
    config = synthetic_chain.config(
        grid={"materials": fabric_names()[:4], "replicates": 2,
              "frictions": [0.4, 0.6, 0.8, 1.0, 1.2, 1.4]},
        render={"viewpoints": ["bench_1", "bench_2"], "textures": ["stripes"],
                "interpolation": {"share": 0.7}},
        train={"splits": ["by_simulation"]},
    )  # fmt: skip
    grid, shown = {one.id: one for one in simulations(config)}, interpolations(config)
    rows = [
        {
            "simulation": name,
            "viewpoint_id": view,
            "material": grid[name].material,
            "friction": filmed_friction(grid[name], shown.get((name, view))),
            "split_by_simulation": sides_of_simulations(config)[name],
        }
        for name, view in films(config)
    ]
    splits = manifest.split_columns(rows, config)
    for split, key in (("unseen_friction", "friction"), ("unseen_fabric", "material")):
        sides = dict(zip(films(config), splits[split], strict=True))
        test = {film for film, side in sides.items() if side == "test"}
        held = {getattr(grid[name], key) for name, _ in test}
        assert len(held) == 1
        assert not test & shown.keys(), "what is tested is simulated"
        trained = {film for film, side in sides.items() if side == "train"}
        assert trained & shown.keys()
        for film in trained:
            parents = [grid[name] for name in (shown[film].weights if film in shown else film[:1])]
            assert held.isdisjoint(getattr(parent, key) for parent in parents)
    frictions, sides = np.array([row["friction"] for row in rows]), splits["unseen_friction"]
    trained, tested = (frictions[np.array(sides) == side] for side in ("train", "test"))
    assert np.abs(np.subtract.outer(trained, tested)).min() > 0.19


def test_any_kind_with_a_role_gets_its_split():
    base = {"material": "a", "friction": 0.1, "simulation": "m00_f0100_r00", "viewpoint_id": "v00"}
    base |= dict.fromkeys(("split_by_video", "split_by_simulation"), "train")
    base |= dict.fromkeys(("floor_role", "texture_role"), "train")
    floor = base | {"split_by_video": "test", "floor_role": "test"}
    splits = manifest.split_columns([base, floor, floor | {"texture_role": "test"}], CONFIG)
    assert splits == {"unseen_floor": ["train", "test", None]}
    assert manifest.parts(splits) == ["part00", "part01", "part02"]
    found = manifest.parts_of_splits(splits, manifest.parts(splits))
    assert found == {"unseen_floor": {"train": ["part00"], "test": ["part01"]}}


@pytest.mark.slow
def test_lines_of_the_card_load_the_data(original, listed, tmp_path):
    card = (original / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", card, re.DOTALL)
    assert len(blocks) == 3
    offline = {"HF_HOME": str(tmp_path), "HF_HUB_OFFLINE": "1", "HF_DATASETS_OFFLINE": "1"}
    of_run = {"cwd": original, "env": os.environ | offline, "text": True}
    said = [subprocess.check_output([sys.executable, "-c", one], **of_run) for one in blocks]
    trained = [row for row in listed if row["split_by_simulation"] == "train"]
    first = min(trained, key=lambda row: (row["shard"], row["first_row"]))
    assert said[0].split()[:2] == [first["material"], str(first["friction"])]
    assert "(16, 16)" in said[0]
    assert "torch.Size([5, 3, 16, 16])" in said[2]


def test_hugging_face_splits_hold_the_videos_of_the_manifest(original, listed, tmp_path):
    card = (original / "README.md").read_text(encoding="utf-8")
    head = yaml.safe_load(card.split("---\n")[1])
    configs = {one["config_name"]: one["data_files"] for one in head["configs"]}
    names = {name.removeprefix("split_") for name in listed[0] if name.startswith("split_")}
    assert set(configs) == names | {"everything"}
    for name, one in ((split, one) for split in names for one in configs[split]):
        paths = [path for pattern in one["path"] for path in original.glob(pattern)]
        found = pd.concat(pd.read_parquet(path, columns=["video"]) for path in paths)["video"]
        there = {row["video"] for row in listed if row[f"split_{name}"] == one["split"]}
        assert set(found) == there


def test_croissant_is_valid_and_reads_the_records_back(original, listed):
    import mlcroissant as mlc

    dataset = mlc.Dataset(jsonld=original / "croissant.json")
    assert not dataset.metadata.ctx.issues.errors
    videos, frames = (list(dataset.records(name)) for name in ("videos", "frames"))
    assert len(videos) == len(listed)
    assert videos[0]["videos/video"].decode() == listed[0]["video"]
    assert videos[0]["videos/friction"] == listed[0]["friction"]
    assert len(frames) == sum(row["frames"] for row in listed)
    row = next(r for r in listed if r["video"] == frames[0]["frames/video"].decode())
    video = [f for f in frames if f["frames/video"].decode() == row["video"]]
    pixels = np.stack([np.asarray(frame["frames/image"]) for frame in video])
    assert pixels_digest(pixels) == row["pixels_sha256"]


def test_card_shows_how_near_composed_images_are_to_direct_ones(original):
    card = (original / "README.md").read_text()
    compared = json.loads((original / "records/render/verification.json").read_text())[
        "comparisons"
    ]
    for floor, least_db in {"matte": 38, "mirrors": 36}.items():
        of_floor = [one for one in compared if (one["floor"] == "matte") == (floor == "matte")]
        psnr_db = [one["psnr_db"] for one in of_floor]
        assert (
            f"| {floor} | {len(of_floor)} | {min(psnr_db):.1f} dB | {np.mean(psnr_db):.1f} dB | "
            f"{least_db} dB | {min(one['ssim'] for one in of_floor):.3f} |"
        ) in card
    assert "verification.json" in (original / "SHA256SUMS").read_text()


def test_crate_knows_every_job_and_what_it_was_made_from(original):
    from rocrate.rocrate import ROCrate

    crate = ROCrate(original)
    assert crate.mainEntity.id == "code/Snakefile"
    profiles = {entity.id for entity in crate.root_dataset["conformsTo"]}
    assert "https://w3id.org/ro/wfrun/workflow/0.5" in profiles
    actions = {entity.id: entity for entity in crate.get_by_type("CreateAction")}
    runs = 2 * 4 * 2
    for stage, count in (("/render/m", 3 * runs), ("/simulate/", runs)):
        assert sum(stage in name for name in actions) == count
    render = actions["#job/results/render/m05_f0300_r00_v00.parquet"]
    assert [one.id for one in render["object"]] == ["#results/simulate/m05_f0300_r00.parquet"]
    assert render["instrument"]["name"] == "slipstitch render"
    steps = {one.id: one for one in crate.mainEntity["step"]}
    (engine,) = crate.get_by_type("OrganizeAction")
    assert engine["result"].id == "#run"
    started = {one["object"].id: steps[one["instrument"].id] for one in engine["object"]}
    assert started.keys() == actions.keys() - {"#run"}
    for name, step in started.items():
        assert step["workExample"].id == actions[name]["instrument"].id
    for entity in crate.get_by_type("File"):
        if entity.id != "ro-crate-metadata.json":
            data = (original / entity.id).read_bytes()
            assert entity["sha256"] == hashlib.sha256(data).hexdigest(), entity.id


@pytest.mark.parametrize("elsewhere", [False, True])
def test_same_results_make_the_same_bytes(original, results, tmp_path, elsewhere):
    """Also where an equal configuration made them in another folder."""
    again = tmp_path / "release"
    made = synthetic_chain.write(CONFIG, tmp_path) if elsewhere else results
    write_release(CONFIG, made, again, ROOT)
    sums, other = read_sums(original), read_sums(again)
    differing = {name for name in sums | other if sums.get(name) != other.get(name)}
    if elsewhere:  # records hold times and, of files that hold times, digests
        assert all(name.startswith(("records/", "simulations/", "ro-crate")) for name in differing)
        for path in (original / "simulations").iterdir():
            assert rows_digest(path) == rows_digest(again / "simulations" / path.name)
        assert "records/config.json" not in differing
        assert sum(name.startswith("data/") for name in sums) > 10
    else:  # what says how long the release took, and what holds digests of that
        assert differing <= {"records/release.json", "ro-crate-metadata.json"}


@pytest.mark.slow
def test_rows_digest_is_of_the_rows_alone(tmp_path):
    table = pa.table({"a": np.arange(7.0), "b": list("abcdefg")})
    noted = attach_metadata(table, {"wall_s": 3.0})
    packed = {"row_group_size": 2, "compression": "gzip"}
    digests = []
    for one, options in ((table, {}), (noted, packed), (table.slice(1), {})):
        pq.write_table(one, tmp_path / "x.parquet", **options)
        digests.append(rows_digest(tmp_path / "x.parquet"))
    assert digests[0] == digests[1] != digests[2]


def test_no_file_names_a_place_on_this_machine(original, results):
    for path in original.rglob("*"):
        if path.suffix in (".json", ".md", ".cff") and "code" not in path.parts:
            text = path.read_text(encoding="utf-8")
            assert str(results.parent) not in text, path
            assert not re.search(r"/(home|root|Users|tmp)/", text), path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "carried_as"),
    [("bench/camera.json", "camera.json"), ("run/bench/camera.json", "bench/camera.json")],
)
def test_camera_file_is_taken_along_wherever_it_lies(tmp_path, place, carried_as):
    """Outside the working folder ``run``, and in it."""
    camera = tmp_path / place
    camera.parent.mkdir(parents=True)
    lens = analytic_stage.lens_camera(*pose(VIEWPOINTS["calibrated_-15"]), distortion=np.zeros(5))
    analytic_stage.camera_file(lens, camera)
    (tmp_path / "run").mkdir(exist_ok=True)
    config = synthetic_chain.config(
        grid={"materials": ["gray-interlock"], "frictions": [0.1, 0.6], "replicates": 2},
        render={"pixels": 16, "textures": ["stripes"], "camera": str(camera)},
    )
    results = synthetic_chain.write(config, tmp_path / "run")
    write_release(config, results, tmp_path / "release", ROOT)
    carried = tmp_path / "release/records" / carried_as
    assert carried.read_bytes() == camera.read_bytes()
    record = json.loads((carried.parent / "camera.json.record.json").read_text())
    assert record["sha256"] == hashlib.sha256(carried.read_bytes()).hexdigest()
    assert audit_release(tmp_path / "release").verdict == "intact"
    camera.write_text("[]")
    with pytest.raises(BadInput, match=r"camera.json: not the file that"):
        write_release(config, results, tmp_path / "other", ROOT)


def test_folder_of_somebody_else_is_left_alone(results, tmp_path):
    for name in ("folder/data", "release"):
        (tmp_path / name).mkdir(parents=True)
    for name in ("file", f"release/{SUMS}"):
        (tmp_path / name).write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    for name in ("folder", "file", "release"):
        problem = "which is not overwritten" if name == "release" else "exists and is not a release"
        with pytest.raises(BadInput, match=problem):
            write_release(CONFIG, results, tmp_path / name, ROOT)
    assert sorted(tmp_path.rglob("*")) == before


def _remake(path):
    pq.write_table(attach_metadata(pq.read_table(path), {"remade": True}), path)


OTHER = synthetic_chain.config(sample={"frames": 5, "test_fraction": 0.3})
#: What is done to results, or to what a name stands for -> why they are refused.
REFUSED = [
    (lambda results: (results / "sample/m05_f0300_r00.parquet").unlink(), None,
     r"sample/m05_f0300_r00.parquet: no such file"),
    (lambda results: _remake(results / "simulate/m05_f0300_r00.parquet"), None,
     r"not the file that results/render/m05_f0300_r00_v00"),
    ("assembly.pinned_versions", {"numpy": "1.0"}, "numpy .*; envs/requirements.lock has 1.0"),
    ("currency.fabric_digest", "0" * 64, r"different catalogue: catalogue\.fabrics\."),
    ("currency.current_digest", "0" * 64, "made by different code of the stage"),
]  # fmt: skip


@pytest.mark.parametrize(("what", "instead", "problem"), REFUSED)
def test_results_are_refused(results, tmp_path, monkeypatch, what, instead, problem):
    if instead is None:
        results = Path(shutil.copytree(results, tmp_path / "results"))
        what(results)
    else:
        monkeypatch.setattr(f"slipstitch.dataset.release.{what}", lambda *_: instead)
    with pytest.raises(BadInput, match=problem):
        write_release(CONFIG, results, tmp_path / "out", ROOT)
    assert not (tmp_path / "out").exists()


def test_another_configuration_and_a_folder_that_is_no_checkout_are_refused(results, tmp_path):
    for config, project, problem in (
        (OTHER, ROOT, r"different configuration: sample.test_fraction: 0.1 -> 0.3"),
        (CONFIG, tmp_path, "not a workflow folder of Slipstitch: no Snakefile"),
    ):
        with pytest.raises(BadInput, match=problem):
            write_release(config, results, tmp_path / "out", project)


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 400 kB."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=400k", "tmpfs", str(place)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("no right to mount a file system")
    yield place
    subprocess.run(["umount", str(place)], check=True)


@pytest.mark.parametrize("foreseen", [True, False])
def test_full_disk_leaves_nothing(results, small_disk, monkeypatch, foreseen):
    if foreseen:
        monkeypatch.setattr(assembly, "_ROOM", 10)
    else:
        monkeypatch.setattr(assembly, "_check_room", lambda out, needed: None)
    with pytest.raises(SlipstitchError, match="free on that disk" if foreseen else "No space left"):
        write_release(CONFIG, results, small_disk / "release", ROOT)
    assert list(small_disk.iterdir()) == []


def test_command_says_what_it_wrote(results, tmp_path, capsys):
    out = tmp_path / "release"
    assert run(f"release --config {results}/config.json --results {results} --out-dir {out}") == 0
    said = capsys.readouterr().out
    assert "144 videos, 720 images" in said
    assert hashlib.sha256((out / SUMS).read_bytes()).hexdigest() in said
    facts = json.loads((out / "records/release.json").read_text())
    assert facts["provenance"]["stage"] == "release"
