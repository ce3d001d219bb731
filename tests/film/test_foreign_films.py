"""Films as other people's cameras and programs write them: read, or refused with the cause."""

import functools
import re
import struct
from dataclasses import replace

import cv2
import numpy as np
import pytest
from support import analytic_stage as stage

from slipstitch.base.errors import BadInput
from slipstitch.config import resolve_config
from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.film import recording
from slipstitch.film.frame_schedule import Schedule
from slipstitch.film.recording import Recording
from slipstitch.film.stage_video import read_stage_video
from slipstitch.images.camera import pose

CONFIG = resolve_config(
    {"simulation": {"frames": 24}, "sample": {"frames": 6}, "render": {"pixels": 48}}
)
SCHEDULE = replace(
    schedule := Schedule.of(CONFIG.simulation, CONFIG.render, CONFIG.sample),
    frame=schedule.frame[:4],
)
LENS = stage.lens_camera(*pose(VIEWPOINTS["calibrated"]))
START_S, LENGTH_S = 3.1, 11.0


@functools.cache
def film_at(rate_hz):
    """Times and noisy images of a film."""
    bench, noise = stage.Bench(LENS), np.random.default_rng(0)
    times_s = np.arange(0, LENGTH_S, 1 / rate_hz)
    images = [
        np.clip(
            bench.image(time_s - START_S) + noise.normal(0, 3, (*bench.shape, 3)), 0, 255
        ).astype(np.uint8)
        for time_s in times_s
    ]
    return times_s, images


def refused(path, **options):
    with pytest.raises(BadInput) as problem:
        read_stage_video(path, LENS, SCHEDULE, **options)
    return str(problem.value)


@pytest.mark.slow
@pytest.mark.parametrize(("rate_hz", "slowed"), [(25.0, 2), (25.0, 4), (12.5, 4), (12.5, 8)])
def test_slow_motion_is_named_with_the_rate_that_helps(tmp_path, rate_hz, slowed):
    times_s, images = film_at(rate_hz)
    path = stage.write_video(tmp_path / "a.mp4", images, slowed * times_s)
    said = refused(path)
    assert f"descends {1 / slowed:.2f} times as fast" in said
    assert f"filmed at {rate_hz:g} and saved at {rate_hz / slowed:.4g} frames a second" in said
    read = read_stage_video(path, LENS, SCHEDULE, frame_rate_hz=rate_hz)
    assert read.start.time_s == pytest.approx(START_S, abs=0.05)


@pytest.mark.default_cases(1)
@pytest.mark.parametrize(
    ("rate_hz", "again_s", "message"),
    [
        (12.5, None, r"its timestamps step back by 7\.\d+ s after 7\."),
        (25.0, None, r"its timestamps step back by 7\.\d+ s after 7\."),
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
    assert re.search(message, refused(tmp_path / "joined.ts"))
    read = read_stage_video(tmp_path / "joined.ts", LENS, SCHEDULE, frame_rate_hz=rate_hz)
    assert read.start.time_s == pytest.approx(START_S, abs=0.05)
    assert read.time_s == pytest.approx(SCHEDULE.time_s, abs=1 / rate_hz)


@pytest.mark.default_cases(1)
@pytest.mark.parametrize(
    ("rate_hz", "clock", "message"),
    [
        (12.5, lambda s: np.round(s, 1), "have the timestamp of the frame before: the clock is"),
        (25.0, lambda s: np.round(s, 1), "have the timestamp of the frame before: the clock is"),
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
    decoded = recording._frames

    def frames(video):
        unit_s = float(video.streams.video[0].time_base)
        for frame in decoded(video):
            frame.pts = round(clock(frame.pts * unit_s) / unit_s)
            yield frame

    monkeypatch.setattr(recording, "_frames", frames)
    monkeypatch.setattr(Recording, "listed", None)
    assert message in refused(path)
    read = read_stage_video(path, LENS, SCHEDULE, frame_rate_hz=rate_hz)
    assert read.start.time_s == pytest.approx(START_S, abs=0.05)


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
    said = refused(path)
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
    read = read_stage_video(path, LENS, SCHEDULE)
    assert read.start.time_s == pytest.approx(START_S, abs=0.06)
    said = refused(path, frame_rate_hz=rate_hz)
    assert "in which frames are repeated, it does: leave the frame rate out" in said
