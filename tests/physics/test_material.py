"""The fabrics and their law: the file, the tables, the values that the source gives."""

import json

import numpy as np
import pytest

from slipstitch.base.errors import BadInput
from slipstitch.config.catalogue import FABRICS_FILE, fabric_names
from slipstitch.physics.fabric import (
    ElasticTables,
    load_fabric,
    read_fabric_file,
    stretching_stiffness,
)


def test_the_catalogue_holds_the_ten_fabrics_in_a_fixed_order():
    assert len(fabric_names()) == 10
    assert fabric_names()[5] == "gray-interlock"
    assert load_fabric("gray-interlock").areal_density_kg_m2 == 0.187


def test_an_unknown_fabric_is_named_with_those_that_exist():
    with pytest.raises(BadInput, match=r"unknown material 'silk'; allowed: ivory-rib-knit"):
        load_fabric("silk")


@pytest.mark.parametrize("part", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("name", fabric_names())
def test_a_stretch_in_a_measured_direction_gives_the_measured_row(name, part):
    """From row zero at rest to past the 1 + 1/6 of the tables.

    Independent of the law's own strain algebra: the strain comes from a stretch tensor.
    """
    rows = load_fabric(name).stretching_N_m
    for row, angle in enumerate(np.radians([0.0, 22.5, 45.0, 67.5, 90.0]), 1):
        direction = np.array([np.cos(angle), np.sin(angle)])
        stretch = np.eye(2) + max(part / 6, 0.2 * (part == 1)) * np.outer(direction, direction)
        G = (stretch.T @ stretch - np.eye(2)) / 2
        expected = 2 * np.maximum((1 - part) * rows[0] + part * rows[row], 0)
        found = stretching_stiffness(rows, G[0, 0], G[1, 1], G[0, 1])
        np.testing.assert_allclose(found, expected, atol=1e-9)


def test_the_sampled_table_reproduces_the_original_at_zero_strain():
    """Zero strain is no node of the original's table: k22 comes out as 109.8, not 69.0 N/m."""
    fabric = load_fabric("gray-interlock")
    table = ElasticTables.of_fabric(fabric).stretching_N_m
    # Zero lies half way between nodes 7 and 8 (-1/60 and 1/60) in G00 and G11.
    at_rest = table[7:9, 7:9, 0].mean(axis=(0, 1))
    assert at_rest[2] == pytest.approx(109.8, abs=0.05)
    assert 2 * fabric.stretching_N_m[0, 2] == pytest.approx(69.0, abs=0.05)


def _altered(tmp_path, change):
    content = json.loads(FABRICS_FILE.read_text())
    change(content["fabrics"]["gray-interlock"])
    path = tmp_path / "fabrics.json"
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda f: f.pop("bending_N_m"), "bending_N_m is missing"),
        (lambda f: f.update(areal_density_kg_m2=-0.1), "areal_density_kg_m2 must be positive"),
        (lambda f: f["bending_N_m"][1].__setitem__(2, -1e-5), "bending_N_m must be positive"),
        (lambda f: f["stretching_N_m"][0].__setitem__(0, -3.0), "row 0 must have positive c11"),
        (lambda f: f["stretching_N_m"].pop(), r"has shape \(5, 4\), must be \(6, 4\)"),
        (lambda f: f["bending_N_m"][0].__setitem__(0, "soft"), "must contain only numbers"),
        (lambda f: f["bending_N_m"][0].__setitem__(0, float("nan")), "non-finite"),
    ],
)
def test_a_bad_fabric_file_is_refused_in_one_line_that_names_the_fabric(tmp_path, change, message):
    path = _altered(tmp_path, change)
    with pytest.raises(BadInput, match=f"fabric 'gray-interlock': .*{message}") as caught:
        read_fabric_file(path)
    assert "\n" not in str(caught.value)
