"""``slipstitch render``: shards, previews, and what it says to bad input."""

import json
from dataclasses import replace

import av
import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from support import analytic_stage, synthetic_cloth
from support.refusal import refused, run
from support.synthetic_videos import images_of as images

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import read_metadata, read_sidecar
from slipstitch.config import resolve_config
from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.design import interpolation
from slipstitch.design.grid import sampled_frames, simulations
from slipstitch.design.interpolation import interpolations
from slipstitch.images import image_shards
from slipstitch.images import view as view_module
from slipstitch.images.camera import pose
from slipstitch.images.view import edge_strain, interpolated
from slipstitch.physics.simulation.trajectory import Trajectory, read_trajectory, write_trajectory

FRAMES, SAMPLED = 12, 4
SMALL = {"sample": {"frames": SAMPLED}, "simulation": {"frames": FRAMES}}
MOTION = synthetic_cloth.motion(FRAMES, n=11, frame_rate_hz=0.15)


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A folder with a configuration, a made-up trajectory and its two shards."""
    folder = tmp_path_factory.mktemp("render")
    looks = {
        "pixels": 32,
        "textures": ["dots", "denim"],
        "test_textures": ["chevron"],
        "viewpoints": ["side", "calibrated"],
        "test_viewpoints": ["calibrated_+5"],
    }
    (folder / "config.json").write_text(json.dumps({"render": looks, **SMALL}))
    write_trajectory(folder / "m05_f0300_r00.parquet", Trajectory(**MOTION))
    for viewpoint in ("v00", "v01"):
        assert render(folder, f"--viewpoint {viewpoint}", out=f"{viewpoint}.parquet") == 0
    return folder


def command_of(folder, words, out="out.parquet", trajectory="m05_f0300_r00.parquet"):
    files = f"--trajectory {folder}/{trajectory} --out {folder}/{out}"
    return f"render --config {folder}/config.json {files} {words}"


def render(folder, words, **files):
    return run(command_of(folder, words, **files))


def test_a_shard_has_one_row_for_every_texture_and_sampled_frame(work):
    table = pq.read_table(work / "v00.parquet")
    assert table.schema.equals(image_shards.SCHEMA)
    rows = table.to_pylist()
    expected = [(f, t) for f in sampled_frames(FRAMES, SAMPLED) for t in ("t00", "t01", "t02")]
    assert [(row["frame"], row["texture"]) for row in rows] == expected
    assert {row["simulation"] for row in rows} == {"m05_f0300_r00"}
    assert {row["viewpoint"] for row in rows} == {"v00"}
    for row in rows:
        assert row["time_s"] == MOTION["time_s"][row["frame"]]
        assert row["stage_x_m"] == MOTION["stage_x_m"][row["frame"]]
        assert row["image"]["path"].startswith(f"m05_f0300_r00_{row['texture']}_v00_")
    assert all(image.shape == (32, 32, 3) for image in images(work / "v00.parquet").values())


def test_a_shard_tells_its_cameras_keypoints_and_where_it_comes_from(work):
    metadata = read_metadata(work / "v01.parquet")
    assert metadata["viewpoint"] == {"id": "v01", "name": "calibrated"}
    assert metadata["textures"] == {"t00": "dots", "t01": "denim", "t02": "chevron"}
    assert metadata["smallest_share_of_cloth_in_image"] == 1
    frames = {"0", "3", "6", "9"}
    assert set(metadata["camera"]["frames"]) == set(metadata["marked_points_m"]) == frames
    record = metadata["provenance"]
    assert record["stage"] == "render" and len(record["inputs"]) == 1
    assert record["config"]["render"]["pixels"] == 32
    trajectory = read_trajectory(work / "m05_f0300_r00.parquet")
    # 11 x 11 vertices; rows 3, 7 and 10 are nearest to a third, two thirds and the lower edge.
    vertices = [11 * row + column for row in (3, 7, 10) for column in (0, 5, 10)]
    for frame, places in metadata["marked_points_m"].items():
        expected = trajectory.positions_m[int(frame), vertices].astype(np.float64)
        expected[:, 0] -= trajectory.stage_x_m[int(frame)]
        np.testing.assert_allclose(np.reshape(places, (9, 3)), expected, atol=6e-6)


def test_the_recorded_camera_projects_the_cloth_onto_its_image(work):
    # In the denim images of a side view the cloth is the only thing that is blue.
    metadata = read_metadata(work / "v00.parquet")["camera"]
    trajectory = read_trajectory(work / "m05_f0300_r00.parquet")
    for frame, crop in metadata["frames"].items():
        local = trajectory.positions_m[int(frame)] @ np.array(metadata["rotation"]).T
        local = local + metadata["translation_m"]
        place = local[:, :2] / local[:, 2:] * crop["focal_px"] + crop["principal_point_px"]
        image = images(work / "v00.parquet")["t01", int(frame)].astype(int)
        y, x = np.nonzero(image[..., 0] > image[..., 2] + 12)
        assert place[:, 0].min() == pytest.approx(x.min(), abs=1.2)
        assert place[:, 0].max() == pytest.approx(x.max(), abs=1.2)
        assert place[:, 1].min() == pytest.approx(y.min(), abs=1.6)


def test_a_viewpoint_can_be_given_by_name(work, capfd):
    unknown = refused(capfd, command_of(work, "--viewpoint v07"))
    assert "no viewpoint 'v07'; the configuration has v00 (side)" in unknown
    assert render(work, "--viewpoint frontal", out="frontal.parquet") == 0
    assert set(pq.read_table(work / "frontal.parquet")["viewpoint"].to_pylist()) == {"frontal"}
    # Results on standard output, and nothing of Blender's.
    assert capfd.readouterr().out.count("\n") == 1


def test_the_calibrated_viewpoint_stands_where_the_camera_file_says(work):
    lens = analytic_stage.lens_camera(*pose(VIEWPOINTS["calibrated_-15"]), distortion=np.zeros(5))
    analytic_stage.camera_file(lens, work / "camera.json")
    over = work / "camera.yaml"
    over.write_text(f"render: {{camera: {work / 'camera.json'}, pixels: 16}}\n")
    for name, seen_from in (("calibrated", "calibrated_-15"), ("calibrated_+5", "calibrated_-10")):
        assert render(work, f"--config {over} --viewpoint {name}", out="camera.parquet") == 0
        metadata = read_metadata(work / "camera.parquet")
        found = metadata["camera"]["rotation"]
        np.testing.assert_allclose(found, pose(VIEWPOINTS[seen_from])[0], atol=1e-12)
        assert len(metadata["provenance"]["inputs"]) == 2
    assert render(work, f"--config {over} --viewpoint side", out="camera.parquet") == 0
    assert len(read_metadata(work / "camera.parquet")["provenance"]["inputs"]) == 1


def test_every_frame_can_be_rendered_each_in_a_crop_of_its_own(work):
    over = work / "all.yaml"
    over.write_text("render: {frames: all, pixels: 16}\n")
    assert render(work, f"--config {over} --viewpoint v00", out="all.parquet") == 0
    crops = read_metadata(work / "all.parquet")["camera"]["frames"].values()
    assert len(crops) == FRAMES
    assert len({json.dumps(crop) for crop in crops}) > 1


def test_interrupted_work_leaves_nothing(work, monkeypatch):
    def interrupt(layers, names):
        raise KeyboardInterrupt

    monkeypatch.setattr(image_shards, "compose_light", interrupt)
    before = sorted(work.iterdir())
    assert render(work, "--viewpoint v00", out="interrupted.parquet") == 130
    assert sorted(work.iterdir()) == before


def test_a_preview_is_a_contact_sheet_and_a_video_that_play(work, capsys):
    sheet, video = work / "m05_f0300_r00.png", work / "m05_f0300_r00.mp4"
    files = f"--out-sheet {sheet} --out-video {video} {work}/v00.parquet {work}/v01.parquet"
    assert run(f"render --preview {files}") == 0
    assert capsys.readouterr().out.splitlines() == [str(sheet), str(video)]
    # Two rows of 4 frames and two of 3 textures, 32 pixels each, with gaps of 2.
    assert cv2.imread(str(sheet)).shape == (4 * 34 - 2, 4 * 34 - 2, 3)
    with av.open(str(video)) as film:  # what browsers play
        codec = film.streams.video[0].codec_context
        assert (codec.name, codec.pix_fmt) == ("h264", "yuv420p")
    capture = cv2.VideoCapture(str(video))
    pictures = []
    while (read := capture.read())[0]:
        pictures.append(read[1])
    assert len(pictures) == SAMPLED
    # What plays back is the first texture, seen from both viewpoints.
    expected = images(work / "v00.parquet")["t00", 0]
    scale = pictures[0].shape[0] // 32
    first = pictures[0][: 32 * scale, : 32 * scale]
    shown = cv2.resize(first, (32, 32), interpolation=cv2.INTER_AREA)
    assert np.abs(shown.astype(int) - expected).mean() < 6
    assert read_sidecar(sheet)["stage"] == "render"


def _states(**values):
    def damage(source, path):
        trajectory = read_trajectory(source)
        changes = {name: change(getattr(trajectory, name)) for name, change in values.items()}
        write_trajectory(path, replace(trajectory, **changes))

    return damage


def _without_positions(source, path):
    pq.write_table(pq.read_table(source).drop_columns(["differences_um"]), path)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (_without_positions, "no column 'differences_um'"),
        (_states(stage_z_m=lambda z_m: np.nan * z_m), "stage_z_m contains non-finite numbers"),
        (_states(uv=lambda uv: 3 * uv), "texture coordinates are outside 0 ... 1"),
    ],
    ids=["column", "not finite", "metres"],
)
def test_an_unusable_trajectory_is_one_clear_line(work, capsys, damage, message):
    path = work / "bad_trajectory.parquet"
    damage(work / "m05_f0300_r00.parquet", path)
    command = command_of(work, "--viewpoint v00", out="bad.parquet", trajectory=path.name)
    error = refused(capsys, command)
    assert "bad_trajectory.parquet" in error and message in error
    assert not (work / "bad.parquet").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--out-sheet a.png", "--preview requires image shards"),
        ("v00.parquet", "requires --out-sheet or --out-video"),
        ("--out-sheet a.png m05_f0300_r00.parquet", "no column 'simulation'"),
        ("--out-sheet a.gif v00.parquet", "must end in .png"),
        ("--out-video a.avi v00.parquet", "must end in .mp4"),
        ("--out-sheet a.png v00.parquet v00.parquet", "which is also in another shard"),
    ],
)
def test_an_impossible_preview_is_one_clear_line(work, capsys, monkeypatch, words, message):
    monkeypatch.chdir(work)
    assert message in refused(capsys, f"render --preview {words}")


def test_a_film_of_a_cloth_between_two_shows_their_weighted_mean(tmp_path, monkeypatch):
    """As a film of the mean trajectory, to one level; its label is the coefficient between."""
    monkeypatch.setattr(view_module, "STRAIN_MAX", 1.0)  # a drawn cloth is no sheet
    monkeypatch.setattr(interpolation, "FROM_FRICTION", 0.0)
    grid = {"materials": ["gray-interlock", "ivory-rib-knit"], "frictions": [0.1, 0.3, 0.5]}
    looks = {"pixels": 32, "textures": ["dots"], "viewpoints": ["bench_1"]}
    settings = {
        "grid": grid | {"replicates": 1},
        "render": looks | {"interpolation": {"share": 1.0}},
        "sample": {"frames": SAMPLED, "validation_fraction": 0.0, "test_fraction": 0.1},
        "simulation": {"frames": FRAMES},
        "train": {"splits": ["by_simulation"]},
    }
    config = resolve_config(settings)
    (tmp_path / "config.json").write_text(json.dumps(settings))
    for number, one in enumerate(simulations(config)):
        aside = {"positions_m": MOTION["positions_m"] + np.float32([0, 0.004 * number, 0])}
        write_trajectory(tmp_path / f"{one.id}.parquet", Trajectory(**(MOTION | aside)))
    (simulation, _), shown = next(
        (film, shown) for film, shown in interpolations(config).items() if len(shown.weights) == 2
    )
    trajectory = f"{simulation}.parquet"
    assert render(tmp_path, "--viewpoint v00", trajectory=trajectory) == 0
    metadata = read_metadata(tmp_path / "out.parquet")
    assert metadata["interpolation"] == {"friction": shown.friction, "weights": shown.weights}
    assert metadata["interpolated_frames"] == FRAMES
    assert set(metadata["provenance"]["inputs"]) == {f"{name}.parquet" for name in shown.weights}

    mean = sum(
        weight * read_trajectory(tmp_path / f"{name}.parquet").positions_m.astype(np.float64)
        for name, weight in shown.weights.items()
    )
    mean = MOTION | {"positions_m": mean.astype(np.float32)}
    write_trajectory(tmp_path / trajectory, Trajectory(**mean))
    (tmp_path / "config.json").write_text(json.dumps(settings | {"render": looks}))
    assert render(tmp_path, "--viewpoint v00", out="mean.parquet", trajectory=trajectory) == 0
    between, alone = (images(tmp_path / name) for name in ("out.parquet", "mean.parquet"))
    for key, image in alone.items():  # the mean that was written is rounded to a micrometre
        assert np.abs(between[key].astype(int) - image).max() <= 1


# A cloth between simulated ones: a mean where that is a cloth, else one of them


def sheet(turns_deg, stage_z_m=0.15):
    """A square that hangs on its upper edge, turned about it by an angle in each frame."""
    rest_m, uv, faces = synthetic_cloth.grid(6)
    turn, down_m = np.radians(turns_deg)[:, None], 0.2 * uv[:, 1]
    across_m = np.broadcast_to(rest_m[:, 1], (len(turns_deg), len(uv)))
    places_m = np.stack([down_m * np.sin(turn), across_m, -down_m * np.cos(turn)], axis=2)
    frame = np.arange(len(turns_deg))
    return Trajectory(
        rest_m, uv, faces, np.array([0]), frame, frame / 1.0, np.zeros(len(frame)),
        np.full(len(frame), stage_z_m), places_m.astype(np.float32),
    )  # fmt: skip


def test_a_simulated_cloth_keeps_its_edges_and_a_stretched_one_does_not():
    one = sheet([0.0, 40.0])
    np.testing.assert_allclose(edge_strain(one, one.positions_m.astype(float)), 0, atol=1e-6)
    np.testing.assert_allclose(edge_strain(one, 1.1 * one.positions_m), 0.1, atol=1e-6)


def test_the_mean_is_shown_where_it_is_a_cloth_and_the_simulation_where_it_is_none():
    low, high = sheet([10.0, 20.0, 60.0]), sheet([14.0, 26.0, -60.0], stage_z_m=0.16)
    weights = {"m00_f0400_r00": 0.75, "m00_f0500_r00": 0.25}
    shown = interpolated(dict(zip(weights, (low, high), strict=True)), weights, "m00_f0400_r00")
    assert shown.metadata["interpolated_frames"] == 2
    mean_m = 0.75 * low.positions_m.astype(float) + 0.25 * high.positions_m
    np.testing.assert_allclose(shown.positions_m[:2], mean_m[:2], atol=1e-7)
    np.testing.assert_allclose(shown.stage_z_m, [0.1525, 0.1525, 0.15])
    # A sheet between two small turns is the sheet turned in between.
    between_m = sheet([11.0, 21.5]).positions_m
    np.testing.assert_allclose(shown.positions_m[:2], between_m, atol=2e-4)
    np.testing.assert_array_equal(shown.positions_m[2], low.positions_m[2])  # one rolls over
    parents = {"m00_f0400_r00": low, "m00_f0500_r00": sheet([1.0])}
    with pytest.raises(BadInput, match="m00_f0500_r00: its frame is not that of m00_f0400_r00"):
        interpolated(parents, weights, "m00_f0400_r00")
