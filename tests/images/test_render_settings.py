"""Render settings: only textures and viewpoints that exist, training and test kept apart."""

import pytest
from pydantic import ValidationError

from slipstitch.config.catalogue import TEST_ONLY_TEXTURES, TEXTURES, VIEWPOINTS
from slipstitch.config.render import RenderSettings
from slipstitch.design.grid import texture_ids, viewpoint_ids


def test_there_are_eight_training_textures_and_one_for_testing_only():
    assert len(TEXTURES) - len(TEST_ONLY_TEXTURES) == 8
    assert len(TEST_ONLY_TEXTURES) == 1


def test_the_test_viewpoints_turn_the_calibrated_one_about_the_vertical():
    calibrated = VIEWPOINTS["calibrated"]
    for turn in (-15, -10, -5, 5, 10, 15):
        turned = VIEWPOINTS[f"calibrated_{turn:+d}"]
        assert turned.test_only
        assert turned.azimuth_deg == calibrated.azimuth_deg + turn
        assert turned.elevation_deg == calibrated.elevation_deg
        assert turned.distance_m == calibrated.distance_m


def test_ids_count_training_names_first():
    settings = RenderSettings(
        textures=["dots", "denim"],
        test_textures=["chevron"],
        viewpoints=["side"],
        test_viewpoints=["calibrated_+5", "frontal"],
    )
    assert texture_ids(settings) == {"t00": "dots", "t01": "denim", "t02": "chevron"}
    assert viewpoint_ids(settings) == {"v00": "side", "v01": "calibrated_+5", "v02": "frontal"}


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"textures": ["plaid"]}, "unknown texture 'plaid'; known: stripes, checks"),
        ({"viewpoints": ["top"]}, "unknown viewpoint 'top'; known: calibrated, frontal"),
        ({"textures": ["dots", "dots"]}, "duplicate"),
        ({"textures": ["dots"], "test_textures": ["dots"]}, "share dots"),
        ({"textures": ["chevron"]}, "chevron: for testing only"),
        ({"viewpoints": ["calibrated_-10"]}, "calibrated_-10: for testing only"),
        ({"pixels": 8}, "greater than or equal to 16"),
        ({"frames": "some"}, "'sampled' or 'all'"),
        ({"pixel": 64}, "Extra inputs"),
        ({"textures": []}, "at least 1"),
    ],
)
def test_impossible_settings_are_refused(keys, message):
    with pytest.raises(ValidationError, match=message.replace("+", r"\+")):
        RenderSettings(**keys)
