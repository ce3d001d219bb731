"""Videos read frame by frame: all of them, or those that are needed."""

from dataclasses import replace

import av
import cv2
import numpy as np
import pytest
from av.video.reformatter import ColorRange, Colorspace
from support import analytic_stage as stage

from slipstitch.config import resolve_config
from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.film import recording as recording_module
from slipstitch.film.frame_schedule import Schedule
from slipstitch.film.recording import Recording
from slipstitch.film.stage_video import read_stage_video
from slipstitch.images.camera import pose

RATE_HZ = 12.5
TIMES_S = np.cumsum(np.r_[0, np.random.default_rng(0).uniform(0.03, 0.09, 59)])  # no regular camera


def noise():
    rng = np.random.default_rng(1)
    return (rng.integers(0, 255, (48, 64, 3), np.uint8) for _ in TIMES_S)


def written(path, **options):
    return stage.write_video(path, noise(), TIMES_S, **options)


CLOSED = {"g": "10", "bf": "2"}
OPEN = {"x264-params": "open-gop=1:keyint=9:bframes=2:b-adapt=0:scenecut=0"}


@pytest.mark.parametrize("options", [CLOSED, OPEN, {"g": "1"}, {}], ids=["closed", "open", "1", ""])
@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".ts"])
def test_needed_frames_are_those_of_the_whole_video(tmp_path, options, suffix):
    recording = Recording(written(tmp_path / f"a{suffix}", **options))
    whole = [(one.time_s, one.image()) for one in recording.moments()]
    index = recording.listed
    assert [time_s for time_s, _ in whole] == pytest.approx(index.time_s, abs=1e-9)
    some = dict(recording.some(index, {3, 11, 12, 38}))
    assert list(some) == [3, 11, 12, 38]
    for number, moment in some.items():
        assert moment.time_s == pytest.approx(whole[number][0], abs=1e-9)
        np.testing.assert_array_equal(moment.image(), whole[number][1])


def test_a_cover_picture_is_not_the_film(tmp_path):
    with av.open(str(tmp_path / "a.mkv"), "w") as file:
        cover = file.add_stream("mjpeg", rate=1)
        film = file.add_stream("libx264", rate=25)
        for stream, size in ((cover, 32), (film, 64)):
            stream.width = stream.height = size
            stream.pix_fmt = "yuvj420p" if stream is cover else "yuv420p"
        for stream, count in ((cover, 1), (film, 20)):
            for number in range(count):
                frame = av.VideoFrame(stream.width, stream.height, stream.pix_fmt)
                frame.pts = number
                file.mux(stream.encode(frame))
            file.mux(stream.encode(None))
    recording = Recording(tmp_path / "a.mkv")
    assert recording.size_px == (64, 64)
    assert len(list(recording.moments())) == len(recording.listed.time_s) == 20


def test_between_two_key_frames_nothing_is_decoded_that_is_not_needed(tmp_path, monkeypatch):
    recording = Recording(written(tmp_path / "a.mp4", **CLOSED, sc_threshold="0"))
    assert list(np.flatnonzero(recording.listed.is_key)) == list(range(0, 60, 10))
    decoded = []
    frames = recording_module._frames

    def watched(video):
        for frame in frames(video):
            decoded.append(frame.pts)
            yield frame

    monkeypatch.setattr(recording_module, "_frames", watched)
    assert [number for number, _ in recording.some(recording.listed, {20, 43})] == [20, 43]
    assert set(decoded) == set(recording.listed.timestamp[[20, 40, 41, 42, 43]])


def test_the_pixels_are_those_that_opencv_reads(tmp_path):
    path = written(tmp_path / "a.mp4", **CLOSED)
    other = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    for moment in Recording(path).moments():
        good, image = other.read()
        assert good
        np.testing.assert_array_equal(moment.image(), image)


@pytest.mark.parametrize("full_range", [False, True])
@pytest.mark.parametrize("standard", [Colorspace.ITU709, Colorspace.ITU601])
def test_colours_are_those_filmed_by_the_standard_that_the_file_names(
    tmp_path, standard, full_range
):
    """Telephones write BT.709; read by BT.601, a green of 180 would be 203."""
    filmed = np.repeat([[[200, 60, 40], [40, 180, 60], [50, 60, 200]]], 32, axis=1)
    image = np.repeat(filmed, 64, axis=0).astype(np.uint8)
    shades = ColorRange.JPEG if full_range else ColorRange.MPEG
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"crf": "5"})
        stream.height, stream.width, stream.pix_fmt = *image.shape[:2], "yuv420p"
        stream.codec_context.colorspace, stream.codec_context.color_range = standard, shades
        frame = av.VideoFrame.from_ndarray(image, format="rgb24").reformat(
            format="yuv420p", dst_colorspace=standard, dst_color_range=shades
        )
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    read = next(Recording(path).moments()).image()[..., ::-1].astype(int)
    assert np.abs(read[32, [16, 48, 80]] - image[32, [16, 48, 80]]).max() <= 3


def test_a_stated_frame_rate_counts_in_place_of_the_files_times(tmp_path):
    recording = Recording(written(tmp_path / "a.mp4"), frame_rate_hz=20.0)
    assert recording.listed.time_s == pytest.approx(np.arange(60) / 20)
    assert [one.time_s for one in recording.moments()] == pytest.approx(np.arange(60) / 20)


def test_frames_without_times_have_no_index(tmp_path):
    path = tmp_path / "a.h264"
    stage.write_video(path, noise(), TIMES_S, bf="2")
    recording = Recording(path, frame_rate_hz=20.0)
    assert recording.listed is None
    assert len(recording.decoded.time_s) == 60


# A video of the stage

CONFIG = resolve_config(
    {"simulation": {"frames": 24}, "sample": {"frames": 6}, "render": {"pixels": 64}}
)
SCHEDULE = Schedule.of(CONFIG.simulation, CONFIG.render, CONFIG.sample)
LENS = stage.lens_camera(*pose(VIEWPOINTS["calibrated"]))
START_S = 3.0


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """A key frame every 0.8 s, 27 s of the protocol: enough to follow the stage."""
    bench = stage.Bench(LENS)
    times_s = np.arange(0, 30, 1 / RATE_HZ)
    images = (bench.image(max(time_s - START_S, 0.0)) for time_s in times_s)
    path = tmp_path_factory.mktemp("stage") / "film.mp4"
    return stage.write_video(path, images, times_s, g="10", bf="0", sc_threshold="0")


def long_schedule():
    config = resolve_config(
        {"simulation": {"frames": 60}, "sample": {"frames": 12}, "render": {"pixels": 64}}
    )
    return Schedule.of(config.simulation, config.render, config.sample)


@pytest.mark.slow
def test_the_stage_is_read_alike_from_some_frames_and_from_all(film, monkeypatch):
    schedule = long_schedule()
    some = read_stage_video(film, LENS, schedule)
    monkeypatch.setattr(Recording, "listed", None)
    whole = read_stage_video(film, LENS, schedule)
    np.testing.assert_array_equal(some.frames, whole.frames)
    np.testing.assert_array_equal(some.time_s, whole.time_s)
    assert some.longest_gap_s == whole.longest_gap_s
    assert whole.time_base is not None
    assert some.time_base.rate == pytest.approx(
        whole.time_base.rate, abs=2 * some.time_base.rate_sd
    )


@pytest.mark.slow
@pytest.mark.parametrize("key_frame", [False, True], ids=["the frame", "its key frame"])
def test_where_a_needed_frame_is_damaged_all_are_read(film, tmp_path, monkeypatch, key_frame):
    schedule = replace(SCHEDULE, frame=SCHEDULE.frame[:4])
    sound = read_stage_video(film, LENS, schedule)
    damaged_s = sound.time_s[2] + sound.start.time_s
    content = bytearray(film.read_bytes())
    with av.open(str(film)) as video:
        packets = [one for one in video.demux(video=0) if one.size]
        at = np.argmin([abs(one.pts * one.time_base - damaged_s) for one in packets])
        while key_frame and not packets[at].is_keyframe:
            at -= 1
        content[packets[at].pos : packets[at].pos + packets[at].size] = bytes(packets[at].size)
    path = tmp_path / "damaged.mp4"
    path.write_bytes(content)
    read = read_stage_video(path, LENS, schedule)
    monkeypatch.setattr(Recording, "listed", None)
    np.testing.assert_array_equal(read.frames, read_stage_video(path, LENS, schedule).frames)
    apart_s = np.abs(read.time_s - sound.time_s)
    assert apart_s[[0, 1, 3]].max() < 0.01
    # Without its key frame the decoder rests the frame on what came before.
    assert apart_s[2] == pytest.approx(0 if key_frame else 1 / RATE_HZ, abs=0.01)
