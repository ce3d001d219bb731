"""Shading packs: Blender once, then every texture without it; verification against Blender."""

import json
import subprocess
import sys

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from support import synthetic_cloth
from support.refusal import refused, run
from support.synthetic_videos import images_of as images

from slipstitch.base.provenance import read_metadata, read_provenance, read_sidecar, start_clock
from slipstitch.config import resolve_config
from slipstitch.images import verification
from slipstitch.images.surroundings import draw_surroundings
from slipstitch.images.view import View
from slipstitch.physics.simulation.trajectory import Trajectory, write_trajectory

ONE = "m05_f0300_r00"
CONFIG = {
    "seed": 5,
    "render": {
        "pixels": 32,
        "textures": ["dots"],
        "viewpoints": ["side", "calibrated"],
        "floors": ["stainless-steel"],
        "augmentation": {
            "lamp_m": 0.1, "exposure_stops": 0.5, "colour_cast": 0.1, "noise": 0.02,
            "jpeg_quality": 60,
        },
        "verified_images": 1,
    },
    "sample": {"frames": 3},
    "simulation": {"frames": 12},
}  # fmt: skip


def configure(folder, name="config.json", **render):
    config = CONFIG | {"render": CONFIG["render"] | render}
    (folder / name).write_text(json.dumps(config))
    return str(folder / name)


def files(folder, views):
    """The files of such viewpoints in a folder."""
    return " ".join(f"{folder}/{ONE}_{view}.parquet" for view in views.split())


def render(folder, words, config="config.json"):
    return f"render --config {folder}/{config} --trajectory {folder}/{ONE}.parquet {words}"


def shade(folder, views, packs="packs"):
    paths = files(folder / packs, views)
    return run(render(folder, f"--viewpoint {views} --shading {paths}"))


def compose(folder, views, config="config.json", out_dir="images"):
    """The command that composes images."""
    packs = files(folder / "packs", views)
    return render(folder, f"--from-shading {packs} --out-dir {folder}/{out_dir}", config)


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    folder = tmp_path_factory.mktemp("packing")
    configure(folder)
    motion = synthetic_cloth.motion(12, n=11, frame_rate_hz=0.15)
    write_trajectory(folder / f"{ONE}.parquet", Trajectory(**motion))
    assert shade(folder, "v00 v01") == 0
    assert run(compose(folder, "v00 v01")) == 0
    return folder


def test_textures_are_put_on_without_blender(work):
    # In a process in which bpy cannot be imported, with a texture that the pack never heard of.
    configure(work, "more.json", textures=["dots", "tartan"], test_textures=["chevron"])
    words = compose(work, "v00", config="more.json", out_dir="more").split()
    code = (
        "import sys; sys.modules['bpy'] = None\n"
        f"from slipstitch.cli.main import main; sys.exit(main({words!r}))"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr
    more, before = (images(work / of / f"{ONE}_v00.parquet") for of in ("more", "images"))
    assert {texture for texture, _ in more} == {"t00", "t01", "t02"}
    for key, image in before.items():
        np.testing.assert_array_equal(image, more[key])


def test_light_and_images_do_not_depend_on_what_was_rendered_before_or_in_one_go(work):
    assert shade(work, "v01", packs="alone") == 0
    alone, after = (pq.read_table(work / of / f"{ONE}_v01.parquet") for of in ("alone", "packs"))
    assert alone.equals(after)
    path = work / f"{ONE}_whole.parquet"
    assert run(render(work, f"--viewpoint v01 --out {path}")) == 0
    whole, parts = images(path), images(work / "images" / f"{ONE}_v01.parquet")
    assert whole.keys() == parts.keys()
    for key, image in whole.items():
        np.testing.assert_array_equal(image, parts[key])


def test_floor_lamp_cameras_and_what_the_light_depends_on_are_recorded(work):
    side, calibrated = (
        read_metadata(work / "images" / f"{ONE}_{view}.parquet") for view in ("v00", "v01")
    )
    surroundings = side["surroundings"]
    assert surroundings["floor"] == "stainless-steel"
    assert 0.5 <= surroundings["reflectance"] <= 0.62 and 0.2 <= surroundings["roughness"] <= 0.4
    assert surroundings["lamp_position_m"] != [0.8, -0.5, 1.0]
    # One bench for all viewpoints, a camera for each video.
    assert calibrated["surroundings"] == surroundings
    cameras = side["augmentation"]["t00"], calibrated["augmentation"]["t00"]
    assert cameras[0] != cameras[1]
    for camera in cameras:
        assert abs(camera["exposure_stops"]) <= 0.5 and 0.9 <= camera["red"] <= 1.1
        assert 0 < camera["noise"] <= 0.02 and 60 <= camera["jpeg_quality"] <= 100
    record = read_provenance(work / "packs" / f"{ONE}_v00.parquet")
    assert record["stage"] == "render.packing"
    assert record["config"]["render"]["augmentation"] == {"lamp_m": 0.1}
    assert "textures" not in record["config"]["render"]
    assert any(name.endswith("_v00.parquet") for name in side["provenance"]["inputs"])


def test_an_image_file_is_a_texture(work, tmp_path):
    drawing = np.zeros((300, 300, 3), np.uint8)
    drawing[:, 150:] = (0, 0, 255)  # red for u > 1/2, as OpenCV orders colours
    cv2.imwrite(str(tmp_path / "mine.png"), drawing)
    plain = {"textures": [str(tmp_path / "mine.png")], "augmentation": {"lamp_m": 0.1}}
    configure(work, "mine.json", **plain)
    assert run(compose(work, "v01", config="mine.json", out_dir="mine")) == 0
    image = next(iter(images(work / "mine" / f"{ONE}_v01.parquet").values())).astype(int)
    assert (image[..., 2] > image[..., 0] + 60).sum() > 20
    inputs = read_provenance(work / "mine" / f"{ONE}_v01.parquet")["inputs"]
    assert any(name.endswith("mine.png") for name in inputs)


@pytest.mark.parametrize(
    ("file", "message"),
    [("bad.png", "bad.png: not an image file, or a damaged"), ("none.jpg", "no such texture file")],
)
def test_a_texture_that_is_no_image_is_one_clear_line(work, tmp_path, capsys, file, message):
    (tmp_path / "bad.png").write_text("not an image")
    configure(work, "bad.json", textures=[str(tmp_path / file)])
    assert message in refused(capsys, compose(work, "v00", config="bad.json", out_dir="bad"))
    assert not (work / "bad").exists() or not list((work / "bad").iterdir())


@pytest.mark.parametrize("option", ["--trajectory", "--from-shading"])
def test_what_is_no_pack_of_the_trajectory_is_one_clear_line(work, tmp_path, capsys, option):
    other = Trajectory(**synthetic_cloth.motion(12, n=11, frame_rate_hz=0.2))
    write_trajectory(tmp_path / f"{ONE}.parquet", other)
    given, message = {
        "--trajectory": (tmp_path / f"{ONE}.parquet", "not rendered from"),
        "--from-shading": (work / "images" / f"{ONE}_v00.parquet", "not a shading pack"),
    }[option]
    words = compose(work, "v00").split()
    words[words.index(option) + 1] = given
    assert message in refused(capsys, words)


def verify(work, out, shards="images"):
    folders = f"--trajectories {work} --packs {work}/packs"
    command = f"render --config {work}/config.json --verify {folders} --out {out}"
    return run(f"{command} {files(work / shards, 'v00 v01')}")


@pytest.mark.slow
def test_a_sample_of_the_dataset_is_compared_with_direct_renders(work, capsys):
    out = work / "verification.json"
    assert verify(work, out) == 0
    assert len(capsys.readouterr().out.splitlines()) == 1
    content = json.loads(out.read_text())
    assert content["images"] == 1
    assert content["lowest_psnr_db"] >= 36
    assert content["lowest_ssim"] >= 0.97
    assert all(one["as_stored"] for one in content["comparisons"])
    assert read_sidecar(out)["stage"] == "render"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("least_db", "shards", "said"),
    [
        (99.0, "images", "(floor stainless-steel): "),
        (36.0, "altered", "the stored image differs from the one composed from its shading pack"),
    ],
)
def test_an_image_altered_or_unlike_the_direct_one_fails_the_verification(
    work, tmp_path, capsys, monkeypatch, least_db, shards, said
):
    monkeypatch.setattr(verification, "LEAST_PSNR_DB", {True: least_db})
    monkeypatch.setattr(verification, "SAMPLES", {True: 1})
    (work / "altered").mkdir(exist_ok=True)
    for view in ("v00", "v01"):
        path = work / "images" / f"{ONE}_{view}.parquet"
        table = pq.read_table(path)
        rows = table.to_pylist()
        for row in rows:
            image = cv2.imdecode(np.frombuffer(row["image"]["bytes"], np.uint8), cv2.IMREAD_COLOR)
            image[5, 5] ^= 1
            row["image"]["bytes"] = cv2.imencode(".png", image)[1].tobytes()
        altered = table.from_pylist(rows, schema=table.schema)
        pq.write_table(altered, work / "altered" / path.name)
    assert verify(work, tmp_path / "verification.json", shards) == 1
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_viewpoint_of_the_second_training_set_keeps_its_id_and_its_floors(tmp_path):
    """It shares its name with another."""
    render = {"viewpoints": ["calibrated", "side"], "reflective_floors": ["aluminium"]}
    config = resolve_config({"render": render})
    path = tmp_path / "m05_f0100_r00.parquet"
    ids = ("v00", "v02", "calibrated", "frontal")
    views = {name: View.of(config, path, name) for name in ids}
    assert {name: view.viewpoint_id for name, view in views.items()} == {
        "v00": "v00", "v02": "v02", "calibrated": "v00", "frontal": "frontal"
    }  # fmt: skip
    assert views["v02"].viewpoint == "calibrated"
    path.touch()
    for name, floor in (("v02", "aluminium"), ("v00", "matte")):
        recorded = views[name].record("render", start_clock(), {})["config"]
        assert list(recorded["catalogue"]["floors"]) == [floor]
    floors = {draw_surroundings(config.render, 1, path.stem, name).floor for name in ("v02", "v03")}
    assert floors == {"aluminium"}
