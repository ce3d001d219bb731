"""The start of the stage is found by the cloth, whatever stands still around it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support import analytic_stage as stage

from slipstitch.capture import stage_start
from slipstitch.capture.schedule import Schedule
from slipstitch.capture.stage_start import find_start
from slipstitch.catalogue import VIEWPOINTS
from slipstitch.config import resolve_config
from slipstitch.render.camera import pose

CONFIG = resolve_config({})
SCHEDULE = Schedule.of(CONFIG.simulation, CONFIG.render, CONFIG.sample)
START_S = 3.3
# Turned and raised from the calibrated viewpoint, so that the floor's far edge lies behind the
# cloth, and far away: 4 mm a pixel.
CALIBRATED = VIEWPOINTS["calibrated"]
ASIDE = stage.lens_camera(
    *pose(
        replace(
            CALIBRATED,
            azimuth_deg=CALIBRATED.azimuth_deg + 8.5,
            elevation_deg=CALIBRATED.elevation_deg + 7.5,
        )
    ),
    size=(224, 168),
)


def filmed(monkeypatch, lens, cloth, floor=None):
    """The moments of a noisy video at 12 frames per second of a cloth on a floor."""
    monkeypatch.setattr(stage, "_cloth_light", cloth)
    bench = stage.Bench(lens.camera, lens.distortion)
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
    return find_start(moments, lens, SCHEDULE.crop(0.0), SCHEDULE.path)


def test_the_edge_of_a_bright_floor_behind_the_cloth_does_not_hide_the_start(monkeypatch):
    moments = filmed(monkeypatch, ASIDE, woven, floor=0.7)
    start = start_of(moments, ASIDE)
    assert start.time_s == pytest.approx(START_S, abs=0.03)
    assert start.speed_is_right
    # The wide strip alone is held by what stands still.
    monkeypatch.setattr(stage_start, "_STRIPS_M", stage_start._STRIPS_M[:1])
    assert start_of(moments, ASIDE) is None


def test_a_plain_cloth_is_followed_by_its_upper_edge(monkeypatch):
    moments = filmed(monkeypatch, ASIDE, plain)
    assert start_of(moments, ASIDE).time_s == pytest.approx(START_S, abs=0.05)


def test_a_stage_that_does_not_move_has_no_start(monkeypatch):
    moments = filmed(monkeypatch, ASIDE, woven, floor=0.7)
    still = [SimpleNamespace(time_s=one.time_s, image=moments[0].image) for one in moments]
    assert start_of(still, ASIDE) is None
