"""A fabric as it was weighed and bent: where it differs from those that were tested."""

import json
import math

import pytest
from support.refusal import refused, run

from slipstitch.film.measure.told_fabric import ToldFabric, bending_length_m
from slipstitch.physics.experiments.cantilever import heavy_cantilever
from slipstitch.physics.fabric import load_fabric

FABRICS = ("gray-interlock", "royal-target")


def test_a_strip_of_twice_the_bending_length_hangs_over_by_the_angle_of_the_standard():
    # ISO 9073-7 reads half the overhang at which the chord to the tip slopes by 41.5 degrees.
    fabric = load_fabric("royal-target")
    weight_N_m2 = 9.81 * fabric.areal_density_kg_m2
    rigidity_N_m = fabric.bending_N_m[[0, 2], 4].mean() / 4  # equal to 2 % in warp and weft
    gamma = weight_N_m2 * (2 * bending_length_m(fabric)) ** 3 / rigidity_N_m
    slope = heavy_cantilever(gamma).height_over_width
    assert math.degrees(math.atan(slope)) == pytest.approx(41.5, abs=1.0)


@pytest.mark.parametrize(
    ("told", "says"),
    [
        ({}, ""),
        ({"areal_density_g_m2": 200.0, "bending_length_mm": 20.0}, ""),
        ({"areal_density_g_m2": 145.0}, "the fabric is too light: areal density 145 g/m²"),
        ({"areal_density_g_m2": 283.0}, "the fabric is too heavy: areal density 283 g/m² (tested"),
        ({"bending_length_mm": 12.0}, "the fabric is too limp: bending length 12 mm (tested on 13"),
        ({"bending_length_mm": 34.0}, "the fabric is too stiff: bending length 34 mm"),
        (
            {"areal_density_g_m2": 400.0, "bending_length_mm": 40.0},
            "the fabric is too heavy: areal density 400 g/m² (tested on 146 ... 282); the fabric "
            "is too stiff: bending length 40 mm (tested on 13 ... 33)",
        ),
    ],
)
def test_it_says_which_way_a_fabric_is_outside(told, says):
    found = ToldFabric(FABRICS, told).outside
    assert found.startswith(says) and bool(found) == bool(says)


def test_the_command_names_a_fabric_that_was_never_tested(capsys, tmp_path):
    told = "--areal-density-g-m2 640 --bending-length-mm 21"
    files = f"--out {tmp_path / 'a.html'} --json {tmp_path / 'a.json'}"
    assert run(f"measure --example {told} {files}") == 3
    assert "ALARM: the fabric is too heavy: areal density 640 g/m²" in capsys.readouterr().out
    numbers = json.loads((tmp_path / "a.json").read_text())
    assert (numbers["areal_density_g_m2"], numbers["bending_length_mm"]) == (640, 21)
    assert (
        "<td>bending length, mm</td><td>11 ... 33</td><td>21</td>"
        in (tmp_path / "a.html").read_text()
    )
    said = refused(capsys, "measure --example --bending-length-mm 0.021")
    assert "bending length 0.021: must be from 2 to 150 mm" in said
    said = refused(capsys, "measure --example --areal-density-g-m2 nan")
    assert "areal density nan: must be from 10 to 2000 g/m²" in said
