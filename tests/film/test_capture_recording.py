"""Videos read frame by frame, all of them or those needed; films of foreign cameras."""

import functools
import re
import struct
from dataclasses import replace

import av
import cv2
import numpy as np
import pytest
from av.video.reformatter import ColorRange, Colorspace
from support import analytic_stage as stage

from slipstitch.base.errors import BadInput
from slipstitch.film import recording as recording_module
from slipstitch.film.recording import Recording
from slipstitch.film.stage_video import read_stage_video

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
    # Frames without times have no index.
    recording = Recording(written(tmp_path / "a.h264", bf="2"), frame_rate_hz=20.0)
    assert recording.listed is None and len(recording.decoded.time_s) == 60


# A video of the stage

_, SCHEDULE = stage.protocol()
LENS = stage.LENS
START_S = 3.0


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """A key frame every 0.8 s, 27 s of the protocol: enough to follow the stage."""
    bench = stage.Bench(LENS)
    times_s = np.arange(0, 30, 1 / RATE_HZ)
    images = (bench.image(max(time_s - START_S, 0.0)) for time_s in times_s)
    path = tmp_path_factory.mktemp("stage") / "film.mp4"
    return stage.write_video(path, images, times_s, g="10", bf="0", sc_threshold="0")


@pytest.mark.slow
def test_the_stage_is_read_alike_from_some_frames_and_from_all(film, monkeypatch):
    _, schedule = stage.protocol(60, 12)
    some = read_stage_video(film, LENS, schedule)
    monkeypatch.setattr(Recording, "listed", None)
    whole = read_stage_video(film, LENS, schedule)
    np.testing.assert_array_equal(some.frames, whole.frames)
    np.testing.assert_array_equal(some.time_s, whole.time_s)
    assert some.longest_gap_s == whole.longest_gap_s
    sd = some.time_base.rate_sd
    assert some.time_base.rate == pytest.approx(whole.time_base.rate, abs=2 * sd)


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


# Films as other people's cameras and programs write them: read, or refused with the cause

_, WHOLE = stage.protocol(pixels=48)
FILM = replace(WHOLE, frame=WHOLE.frame[:4])
FILM_START_S, LENGTH_S = 3.1, 11.0


@functools.cache
def film_at(rate_hz):
    """Times and noisy images of a film."""
    bench, noise = stage.Bench(LENS), np.random.default_rng(0)
    times_s = np.arange(0, LENGTH_S, 1 / rate_hz)
    clean = (bench.image(time_s - FILM_START_S) for time_s in times_s)
    noisy = (image + noise.normal(0, 3, (*bench.shape, 3)) for image in clean)
    return times_s, [np.clip(image, 0, 255).astype(np.uint8) for image in noisy]


def said_of(path, **options):
    with pytest.raises(BadInput) as problem:
        read_stage_video(path, LENS, FILM, **options)
    return str(problem.value)


@pytest.mark.slow
@pytest.mark.parametrize(("rate_hz", "slowed"), [(25.0, 2), (25.0, 4), (12.5, 4), (12.5, 8)])
def test_slow_motion_is_named_with_the_rate_that_helps(tmp_path, rate_hz, slowed):
    times_s, images = film_at(rate_hz)
    path = stage.write_video(tmp_path / "a.mp4", images, slowed * times_s)
    said = said_of(path)
    assert f"descends {1 / slowed:.2f} times as fast" in said
    assert f"filmed at {rate_hz:g} and saved at {rate_hz / slowed:.4g} frames a second" in said
    read = read_stage_video(path, LENS, FILM, frame_rate_hz=rate_hz)
    assert read.start.time_s == pytest.approx(FILM_START_S, abs=0.05)


@pytest.mark.default_cases(1)
@pytest.mark.parametrize(
    ("rate_hz", "again_s", "message"),
    [
        (12.5, None, r"its timestamps step back by 7\.\d+ s after 7\."),
        (25.0, 0.5, r"its timestamps step back by 0\.4\d s after 7\."),
    ],
)
def test_joined_parts_whose_times_overlap_are_refused_and_a_stated_rate_is_read(
    tmp_path, rate_hz, again_s, message
):
    times_s, images = film_at(rate_hz)
    half = len(times_s) * 2 // 3
    whole = b""
    for number, part in enumerate([slice(None, half), slice(half, None)]):
        path = tmp_path / f"{number}.ts"
        own_s = times_s[part] - (times_s[part][0] if again_s is None else number * again_s)
        stage.write_video(path, images[part], own_s, bf="0")
        whole += path.read_bytes()
    (tmp_path / "joined.ts").write_bytes(whole)
    assert re.search(message, said_of(tmp_path / "joined.ts"))
    read = read_stage_video(tmp_path / "joined.ts", LENS, FILM, frame_rate_hz=rate_hz)
    assert read.start.time_s == pytest.approx(FILM_START_S, abs=0.05)
    assert read.time_s == pytest.approx(FILM.time_s, abs=1 / rate_hz)


@pytest.mark.default_cases(1)
@pytest.mark.parametrize(
    ("rate_hz", "clock", "message"),
    [
        (12.5, lambda s: np.round(s, 1), "have the timestamp of the frame before: the clock is"),
        (25.0, lambda s: np.round(s), "have the timestamp of the frame before: the clock is"),
        (12.5, lambda s: 1e3 * s, "0.0125 frames a second by its timestamps, as in milliseconds"),
    ],
)
def test_a_clock_in_another_unit_or_too_coarse_is_named(
    tmp_path, monkeypatch, rate_hz, clock, message
):
    """A container can hold such times, a writer that encodes them cannot: they are read so."""
    times_s, images = film_at(rate_hz)
    path = stage.write_video(tmp_path / "a.mp4", images, times_s, bf="0")
    decoded = recording_module._frames

    def frames(video):
        unit_s = float(video.streams.video[0].time_base)
        for frame in decoded(video):
            frame.pts = round(clock(frame.pts * unit_s) / unit_s)
            yield frame

    monkeypatch.setattr(recording_module, "_frames", frames)
    monkeypatch.setattr(Recording, "listed", None)
    assert message in said_of(path)
    read = read_stage_video(path, LENS, FILM, frame_rate_hz=rate_hz)
    assert read.start.time_s == pytest.approx(FILM_START_S, abs=0.05)


def tagged_by_180(path):
    """Set the matrix of the track header, by which a player turns the film."""
    content = bytearray(path.read_bytes())
    at = content.index(b"tkhd") + 44
    height, width = stage.Bench(LENS).shape
    one = 1 << 16
    matrix = (-one, 0, 0, 0, -one, 0, width * one, height * one, 1 << 30)
    content[at : at + 36] = struct.pack(">9i", *matrix)
    path.write_bytes(content)
    return path


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("rate_hz", [12.5, 25.0])
@pytest.mark.parametrize("is_tagged", [False, True])
def test_a_film_upside_down_is_named_as_one(tmp_path, rate_hz, is_tagged):
    times_s, images = film_at(rate_hz)
    turned = [cv2.rotate(image, cv2.ROTATE_180) for image in images]
    path = stage.write_video(tmp_path / "a.mp4", turned, times_s)
    if is_tagged:
        assert Recording(tagged_by_180(path)).rotation_deg == 180
    said = said_of(path)
    assert "shows the bench upside down" in said
    assert ("orientation tag says 180 degrees" in said) == is_tagged


@pytest.mark.slow
@pytest.mark.parametrize(("rate_hz", "padded_hz"), [(12.5, 25.0), (10.0, 25.0), (12.5, 30.0)])
def test_repeated_frames_do_no_harm_and_a_rate_stated_for_them_is_refused(
    tmp_path, rate_hz, padded_hz
):
    _, images = film_at(rate_hz)
    padded_s = np.arange(0, LENGTH_S - 0.2, 1 / padded_hz)
    shown = [images[int(time_s * rate_hz + 1e-6)] for time_s in padded_s]
    path = stage.write_video(tmp_path / "a.mp4", shown, padded_s, crf="18")
    read = read_stage_video(path, LENS, FILM)
    assert read.start.time_s == pytest.approx(FILM_START_S, abs=0.06)
    said = said_of(path, frame_rate_hz=rate_hz)
    assert "in which frames are repeated, it does: leave the frame rate out" in said
