"""The start of the stage is found by the cloth, whatever stands still around it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support import analytic_stage as stage

from slipstitch.config import resolve_config
from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.film import stage_start
from slipstitch.film.frame_schedule import Schedule
from slipstitch.film.stage_start import find_start
from slipstitch.images.camera import pose

CONFIG = resolve_config({})
SCHEDULE = Schedule.of(CONFIG.simulation, CONFIG.render, CONFIG.sample)
START_S = 3.3
CALIBRATED = VIEWPOINTS["calibrated"]


def camera(turn_deg, raise_deg):
    """Beside and above the calibrated viewpoint, and far away: 4 mm a pixel."""
    seen_from = replace(
        CALIBRATED,
        azimuth_deg=CALIBRATED.azimuth_deg + turn_deg,
        elevation_deg=CALIBRATED.elevation_deg + raise_deg,
    )
    return stage.lens_camera(*pose(seen_from), size=(224, 168))


# The floor's far edge lies behind the cloth.
ASIDE = camera(8.5, 7.5)


def filmed(monkeypatch, lens, cloth, floor=None):
    """The moments of a noisy video at 12 frames per second of a cloth on a floor."""
    monkeypatch.setattr(stage, "_cloth_light", cloth)
    bench = stage.Bench(lens)
    if floor is not None:
        bench.floor = np.where(bench.floor > 0.05, floor, 0.006)
    noise = np.random.default_rng(0)
    moments = []
    for time_s in np.arange(0, 14, 1 / 12):
        image = bench.image(time_s - START_S)[..., ::-1] + noise.normal(0, 2, (*bench.shape, 3))
        image = np.clip(image, 0, 255).astype(np.uint8)
        moments.append(SimpleNamespace(time_s=float(time_s), image=lambda image=image: image))
    return moments


def woven(y, down):
    """A weave of little contrast."""
    first = np.sin(2 * np.pi * (1.3 * y + down) / 0.031)
    return 0.35 + 0.05 * (first + np.sin(2 * np.pi * (y - 0.4 * down) / 0.023))


def plain(y, down):
    return np.full_like(y, 0.35)


def start_of(moments, lens):
    return find_start(moments, lens, SCHEDULE)


def test_the_edge_of_a_bright_floor_behind_the_cloth_does_not_hide_the_start(monkeypatch):
    moments = filmed(monkeypatch, ASIDE, woven, floor=0.7)
    start = start_of(moments, ASIDE)
    assert start.time_s == pytest.approx(START_S, abs=0.03)
    assert start.speed_is_right
    # The wide strip alone is held by what stands still.
    monkeypatch.setattr(stage_start, "_STRIPS_M", stage_start._STRIPS_M[:1])
    assert start_of(moments, ASIDE) is None


def test_an_edge_that_slows_the_wide_strip_down_does_not_make_the_stage_slow(monkeypatch):
    lens = camera(12.0, 4.0)
    moments = filmed(monkeypatch, lens, woven, floor=0.7)
    start = start_of(moments, lens)
    assert start.time_s == pytest.approx(START_S, abs=0.03)
    assert start.speed == pytest.approx(1, abs=0.02)
    monkeypatch.setattr(stage_start, "_STRIPS_M", stage_start._STRIPS_M[:1])
    assert not start_of(moments, lens).speed_is_right


def test_a_stage_at_another_speed_is_found_at_that_speed(monkeypatch):
    lens = camera(0.0, 0.0)
    moments = filmed(monkeypatch, lens, woven)
    slow = [
        SimpleNamespace(time_s=START_S + 1.25 * (one.time_s - START_S) + 1, image=one.image)
        for one in moments
    ]
    start = start_of(slow, lens)
    assert start.speed == pytest.approx(0.8, abs=0.03)
    assert not start.speed_is_right


def test_a_plain_cloth_is_followed_by_its_upper_edge(monkeypatch):
    moments = filmed(monkeypatch, ASIDE, plain)
    assert start_of(moments, ASIDE).time_s == pytest.approx(START_S, abs=0.05)


def test_a_stage_that_does_not_move_has_no_start(monkeypatch):
    moments = filmed(monkeypatch, ASIDE, woven, floor=0.7)
    still = [SimpleNamespace(time_s=one.time_s, image=moments[0].image) for one in moments]
    assert start_of(still, ASIDE) is None
