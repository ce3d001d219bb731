"""Videos of a bench whose every pixel is known: rectified, synchronised, refused where bad."""

import functools
import os
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from support import analytic_stage as stage
from support.refusal import refused, run

from slipstitch.base.errors import BadInput
from slipstitch.config import write_config
from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.dataset.videos import read_videos
from slipstitch.film.ingest_videos import read_known
from slipstitch.film.stage_video import read_stage_video
from slipstitch.images.camera import pose
from slipstitch.images.rectification import rectify, source_pixels, stage_plane

CONFIG, SCHEDULE = stage.protocol()
CALIBRATED = VIEWPOINTS["calibrated"]
LENS = stage.LENS
START_S = 3.137
RATE_HZ = 12.5


BENCH = stage.Bench(LENS)


def times(until_s: float = 14.0, dense_until_s: float = 6.6) -> np.ndarray:
    """12.5 frames a second until the stage has been seen to start, then 2.5."""
    dense = np.arange(0, dense_until_s, 1 / RATE_HZ)
    return np.concatenate([dense, np.arange(dense_until_s, until_s, 0.4)])


@functools.cache
def drawn(time_s: float) -> np.ndarray:
    """The bench's image at a time from the stage's start."""
    return BENCH.image(time_s)


def images(times_s, start_s=START_S):
    return (drawn(max(round(time_s - start_s, 6), 0.0)) for time_s in times_s)


def film(path, times_s, **options):
    """A video of the bench, with frames at these times."""
    return stage.write_video(path, images(times_s), times_s, **options)


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    return film(tmp_path_factory.mktemp("bench") / "video.mp4", times())


def psnr_db(image, wanted):
    difference = image.astype(float) - wanted
    return 10 * np.log10(255**2 / np.mean(difference**2))


def shift_px(image, wanted):
    """By how much an image is shifted against another: least squares on its gradients."""
    image, wanted = image.mean(axis=-1), wanted.mean(axis=-1)
    down, across = np.gradient(wanted)
    design = np.column_stack([across.ravel(), down.ravel()])
    return np.linalg.lstsq(design, (wanted - image).ravel(), rcond=None)[0]


# Rectification


@pytest.mark.parametrize("turn_deg", [0.0, 4.0])
def test_points_of_the_stage_plane_are_found_through_the_lens(turn_deg):
    lens = stage.lens_camera(*pose(replace(CALIBRATED, azimuth_deg=40.0 + turn_deg)))
    crop = SCHEDULE.crop(20.0)
    x_m = float(SCHEDULE.path.position_m(20.0)[0])
    found = source_pixels(lens, crop, stage_plane(crop, x_m))
    row, column = np.mgrid[5:60:9, 5:60:9].reshape(2, -1)
    pixels = np.column_stack([column, row, np.ones(len(row))])
    rays = pixels @ np.linalg.inv(crop.matrix).T @ crop.rotation
    eye = -crop.rotation.T @ crop.translation_m
    points = eye + ((x_m - eye[0]) / rays[:, 0])[:, None] * rays
    assert np.allclose(crop.project(points), pixels[:, :2], atol=1e-6)
    assert np.allclose(found[row, column], lens.project(points), atol=1e-3)


@pytest.mark.parametrize("time_s", [0.0, 5.0, 12.0])
def test_a_distorted_image_becomes_what_the_calibrated_viewpoint_sees(time_s):
    crop = SCHEDULE.crop(time_s)
    x_m = float(SCHEDULE.path.position_m(time_s)[0])
    lens = stage.lens_camera(*pose(CALIBRATED), size=(640, 480))
    seen = stage.Bench(lens).image(time_s)
    image, inside = rectify(seen, lens, crop, stage_plane(crop, x_m))
    wanted = stage.Bench(crop).image(time_s)
    assert inside == 1.0
    assert psnr_db(image, wanted) > 33
    assert np.abs(shift_px(image, wanted)).max() < 0.04


def test_from_a_place_nearby_the_cloth_lies_where_the_viewpoint_sees_it():
    """The flat cloth lies in the stage plane: only the floor is shifted by its parallax."""
    lens = stage.lens_camera(*pose(replace(CALIBRATED, azimuth_deg=45.0, distance_m=1.5)))
    near = stage.Bench(lens)
    crop = SCHEDULE.crop(0.0)
    image, _ = rectify(near.image(0.0), lens, crop, stage_plane(crop, 0.0))
    wanted = stage.Bench(crop).image(0.0)
    corners = np.array([[0, y, z] for y in (-0.08, 0.08) for z in (0.04, 0.19)])
    (left, top), (right, bottom) = (
        getattr(crop.project(corners), end)(axis=0).round().astype(int) for end in ("min", "max")
    )
    inner = np.s_[top + 6 : bottom - 5, left + 3 : right - 2]
    assert np.abs(shift_px(image[inner], wanted[inner])).max() < 0.05


# Synchronisation


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("rate_hz", [12.5, 30.0])
@pytest.mark.parametrize("start_s", [2.4, 3.137])
def test_the_start_is_found_to_a_frame(tmp_path, rate_hz, start_s):
    """With camera noise, drifting exposure and strong compression."""
    rng = np.random.default_rng(3)
    times_s = np.arange(0, start_s + 2.8, 1 / rate_hz)

    def filmed():
        for time_s, image in zip(times_s, images(times_s, start_s), strict=True):
            noisy = image * (1 - 0.03 * time_s) + rng.normal(0, 4, image.shape)
            yield np.clip(noisy, 0, 255).astype(np.uint8)

    path = stage.write_video(tmp_path / "noisy.mp4", filmed(), times_s, crf="30")
    schedule = replace(SCHEDULE, frame=SCHEDULE.frame[:2])
    found = read_stage_video(path, LENS, schedule).start
    assert found.found
    assert abs(found.time_s - start_s) < 0.01  # a quarter of a frame at 25 frames a second
    assert found.speed == pytest.approx(1, abs=0.03)


def test_the_frames_are_those_of_the_dataset(video):
    read = read_stage_video(video, LENS, SCHEDULE)
    assert read.start.time_s == pytest.approx(START_S, abs=0.01)
    assert np.abs(read.time_s - SCHEDULE.time_s).max() <= 0.2
    assert read.frame_interval_s == pytest.approx(0.08, abs=0.33)
    assert not read.notes
    for time_s, image in zip(read.time_s, read.frames, strict=True):
        wanted = stage.Bench(SCHEDULE.crop(max(time_s, 0))).image(time_s)
        assert psnr_db(image, wanted) > 28


def test_a_stated_start_is_taken_refused_where_frames_contradict_it_and_noted_elsewhere(
    video, tmp_path
):
    read = read_stage_video(video, LENS, SCHEDULE, start_s=3.0)
    assert not read.start.found and not read.notes
    assert np.abs(read.time_s - SCHEDULE.time_s).max() <= 0.2
    for start_s in (2.0, 60.0):
        problem = rf"seen to start at 3\.1\d s, but {start_s:.2f} s is stated"
        with pytest.raises(BadInput, match=problem):
            read_stage_video(video, LENS, SCHEDULE, start_s=start_s)
    # Two frames a second are too few to find it.
    path = film(tmp_path / "seldom.mp4", np.arange(0, 14, 0.5))
    with pytest.raises(BadInput, match=STILL):
        read_stage_video(path, LENS, SCHEDULE)
    read = read_stage_video(path, LENS, SCHEDULE, start_s=START_S)
    assert read.notes[0].startswith("the stated start could not be verified")


@pytest.mark.slow
def test_of_two_starts_in_a_film_the_stated_one_counts(tmp_path):
    """The stage is lowered for 3 s, raised again, and rests before the protocol."""
    again_s = 6.0
    rehearsed = np.arange(0, START_S + 3.0, 1 / RATE_HZ)
    dense = np.arange(6.2, again_s + 6.6, 1 / RATE_HZ)
    filmed = np.concatenate([dense, np.arange(again_s + 6.6, again_s + 14.0, 0.4)])
    shown = [*images(rehearsed), *images(filmed, START_S + again_s)]
    path = stage.write_video(tmp_path / "two.mp4", shown, [*rehearsed, *filmed])
    read = read_stage_video(path, LENS, SCHEDULE, start_s=START_S + again_s)
    assert read.notes == []
    with pytest.raises(BadInput, match=r"seen to start at 9\.1\d s, but 8\.00 s is stated"):
        read_stage_video(path, LENS, SCHEDULE, start_s=8.0)


def test_missing_frames_move_the_choice_not_the_clock_and_a_long_gap_is_refused(tmp_path):
    """Frames around 5 s after the start are lost: a frame beside the gap, cropped for its time."""

    def with_gap(first_s, last_s):
        kept = [one for one in times() if not first_s < one - START_S < last_s]
        return film(tmp_path / f"{first_s}.mp4", kept)

    read = read_stage_video(with_gap(4.6, 5.5), LENS, SCHEDULE)
    off_s = np.abs(read.time_s - SCHEDULE.time_s)
    assert read.longest_gap_s == pytest.approx(1.2, abs=0.4)
    assert 0.25 < off_s[3] < 0.8
    assert off_s[[0, 1, 2, 4, 5]].max() <= 0.21
    assert "frames are missing" in read.notes[0]
    wanted = stage.Bench(SCHEDULE.crop(read.time_s[3])).image(read.time_s[3])
    assert psnr_db(read.frames[3], wanted) > 28
    with pytest.raises(BadInput, match=r"needed at 8\.1. s; the nearest usable one is 1\.\d s"):
        read_stage_video(with_gap(3.8, 6.2), LENS, SCHEDULE)


def test_a_wrong_frame_rate_is_noticed_and_can_be_stated(tmp_path):
    right = np.arange(0, 13.2, 1 / RATE_HZ)
    path = stage.write_video(tmp_path / "slow.mp4", images(right), right / 2)
    with pytest.raises(BadInput, match=r"descends (1\.9|2\.0)\d times .*\(--frame-rate-hz, or"):
        read_stage_video(path, LENS, SCHEDULE)
    read = read_stage_video(path, LENS, SCHEDULE, frame_rate_hz=RATE_HZ)
    assert read.start.time_s == pytest.approx(START_S, abs=0.01)


def test_memory_does_not_grow_with_the_video(video):
    """65 MB of decoded frames, of which one at a time and some small strips are held."""
    read_stage_video(video, LENS, SCHEDULE)
    tracemalloc.start()
    read_stage_video(video, LENS, SCHEDULE)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(times()) * 240 * 320 * 3 > 20e6
    assert peak < 12e6


# The table and the dataset


@pytest.fixture
def folder(tmp_path, video):
    """A bench's folder: a video, a camera file, the configuration; `table` writes the table."""
    os.link(video, tmp_path / "a.mp4")
    (tmp_path / "b.mp4").write_bytes(video.read_bytes() + b"\0")
    stage.camera_file(LENS, tmp_path / "camera.json")
    write_config(CONFIG, tmp_path / "config.json")
    return tmp_path


COLUMNS = "video,material,substrate,repeat,mu_ref,mu_ref_error,reflective,camera"
GOOD = "a.mp4,gray-interlock,glass,1,0.31,0.02,no,camera.json"


def command_of(folder, *rows, columns=COLUMNS):
    """The command that ingests a table of these rows."""
    (folder / "captures.csv").write_text("\n".join([columns, *rows]) + "\n")
    files = f"{folder}/captures.csv --config {folder}/config.json"
    return f"capture ingest {files} --out-dir {folder}/dataset"


def test_captures_become_a_dataset_like_any_other(folder, capsys):
    second = "b.mp4,tweed of our own,glass,1,0.5,0.05,yes,camera.json,3.0"
    assert run(command_of(folder, GOOD + ",", second, columns=COLUMNS + ",start_s")) == 0
    said = capsys.readouterr().out
    assert "c00_r01_t00_v00: gray-interlock on glass, repeat 1; the stage starts at 3.1" in said
    assert "2 videos of 2 pairs" in said
    videos = read_videos(folder / "dataset")
    assert videos.pixels.shape == (2, 6, 64, 64, 3)
    assert [row["material_id"] for row in videos.rows] == ["m05", "other"]
    assert [row["friction"] for row in videos.rows] == [0.31, 0.5]
    known = read_known(folder / "dataset")
    assert [row["mu_ref_error"] for row in known] == [0.02, 0.05]
    assert [row["start_found"] for row in known] == [True, False]
    assert not any(row["surrogate"] for row in known)
    # Reference values fill empty cells.
    reference = "material,substrate,mu,error\ngray-interlock,glass,0.33,0.015\n"
    (folder / "reference.csv").write_text(reference)
    command = command_of(folder, "a.mp4,gray-interlock,glass,1,,,no,camera.json")
    assert run(f"{command} --reference {folder}/reference.csv") == 0
    assert read_known(folder / "dataset")[0]["mu_ref"] == 0.33


def test_a_wrong_number_where_any_is_allowed_is_named_without_bounds(folder, capsys):
    reference = "material,substrate,mu,error,bench_error\ngray-interlock,glass,0.33,0.015,small\n"
    (folder / "reference.csv").write_text(reference)
    command = command_of(folder, "a.mp4,gray-interlock,glass,1,,,no,camera.json")
    said = refused(capsys, f"{command} --reference {folder}/reference.csv")
    assert said.rstrip().endswith("line 2, bench_error: 'small'; must be a number")


def changed(old, new):
    """The rows of a table of the good one alone, changed."""
    return [GOOD.replace(old, new)]


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        (changed("a.mp4", "c.mp4"), "line 2, video: 'c.mp4'; no such file below"),
        (changed("a.mp4", "../a.mp4"), "video: '../a.mp4'; must be a path below"),
        (changed("a.mp4", "/etc/passwd"), "video: '/etc/passwd'; must be a path below"),
        (changed("a.mp4", "link.mp4"), "must not be a link to outside"),
        (changed("camera.json", "no.json"), "camera: 'no.json'; no such file below"),
        (changed("0.31", "-0.31"), "mu_ref: '-0.31'; must be a number from 0 to 10"),
        (changed("0.31", "nan"), "mu_ref: 'nan'; must be a number from 0 to 10"),
        (changed("0.31", ""), "mu_ref: empty"),
        (changed("glass", '"=HYPERLINK(""x"")"'), "'=HYPERLINK(\"x\")' looks like a formula"),
        (changed(",1,", ",one,"), "repeat: 'one'; must be a whole number from 0 to 99"),
        (changed(",no,", ",maybe,"), "reflective: 'maybe'; must be yes or no"),
        ([GOOD + ",7"], "line 2: 9 cells, the header has 8"),
        ([GOOD, GOOD], "line 3: repeat 1 of gray-interlock on glass duplicates line 2"),
        ([GOOD, *changed(",1,", ",2,")], "line 3, video: the same content as in line 2"),
        (
            [GOOD, GOOD.replace("a.mp4", "b.mp4").replace(",1,0.31", ",2,0.35")],
            "line 3: gray-interlock on glass differs in mu_ref, mu_ref_error or reflective from",
        ),
        ([], "contains no rows"),
    ],
)
def test_a_wrong_table_is_one_line(folder, tmp_path_factory, capsys, rows, problem):
    outside = tmp_path_factory.mktemp("outside") / "secret.mp4"
    outside.write_bytes(b"\0")
    (folder / "link.mp4").symlink_to(outside)
    assert problem in refused(capsys, command_of(folder, *rows))
    assert not (folder / "dataset").exists()


def test_wrong_columns_are_one_line(folder, capsys):
    for old, new, problem in (
        ("material", "materiel", "unknown column 'materiel'; did you mean mate"),
        (",camera", ",video", "column video: given twice"),
        (",camera", "", "no column 'camera'; required: video, material"),
    ):
        columns = COLUMNS.replace(old, new)
        row = ",".join(GOOD.split(",")[: columns.count(",") + 1])
        assert problem in refused(capsys, command_of(folder, row, columns=columns))


STILL = "no start of the stage's motion found"


def drawn_video(times_s, shown):
    """Writes a video of such images at a path."""
    return lambda path: stage.write_video(path, shown(times_s), times_s)


def cut_off(path):
    sound = path.with_name("b.mp4").read_bytes()
    path.write_bytes(sound[: len(sound) // 2])


def stream_cut_off(path):
    """A container that can be read until there."""
    sound = film(path.with_name("whole.mkv"), times()).read_bytes()
    path.write_bytes(sound[: len(sound) * 4 // 5])


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"no video\n" * 40, "a text file, not a video"),
        (b"#EXTM3U\n#EXTINF:10,\nhttp://localhost:1/a.ts\n", "a text file, not a video"),
        (np.random.default_rng(0).bytes(50_000), "not a video that FFmpeg can read"),
        (b"", "empty, not a video"),
        (cut_off, "not a video that FFmpeg can read (damaged or truncated?)"),
        (stream_cut_off, "ends after"),
        (drawn_video(times()[:10], images), "if it does, give the start (--start-s, or start_s"),
        (
            drawn_video(times()[:60], lambda times_s: map(np.rot90, images(times_s))),
            "240x320 pixels (portrait: the camera was calibrated in the other orient",
        ),
        (drawn_video(times(), lambda times_s: images(times_s, 1e3)), STILL),
        (drawn_video(times(), lambda times_s: images(times_s[::-1])), STILL),
    ],
    ids=["text", "playlist", "noise", "empty", "cut off", "stream cut off", "ten frames",
         "portrait", "still", "backwards"],
)  # fmt: skip
def test_a_bad_video_is_one_line(folder, capfd, content, problem):
    path = folder / "a.mp4"
    path.unlink()
    path.write_bytes(content) if isinstance(content, bytes) else content(path)
    said = refused(capfd, command_of(folder, GOOD))
    assert "a.mp4: " in said and problem in said
