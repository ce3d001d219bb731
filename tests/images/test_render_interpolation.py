"""A cloth between simulated ones: a mean where that is a cloth, else one of them."""

import numpy as np
import pytest

from slipstitch.base.errors import BadInput
from slipstitch.images.view import edge_strain, interpolated
from slipstitch.physics.simulation.trajectory import Trajectory

SIDE = 6


def sheet(turns_deg, stage_z_m=0.15):
    """A square that hangs on its upper edge, turned about it by an angle in each frame."""
    u, v = np.meshgrid(np.linspace(0, 1, SIDE), np.linspace(0, 1, SIDE))
    uv = np.column_stack([u.ravel(), v.ravel()])
    rest_m = 0.2 * np.column_stack([np.zeros(SIDE**2), uv[:, 0], -uv[:, 1]])
    turn = np.radians(turns_deg)[:, None]
    down_m = -rest_m[None, :, 2]
    positions_m = np.stack(
        [
            down_m * np.sin(turn),
            np.broadcast_to(rest_m[:, 1], down_m.shape) + 0 * turn,
            -down_m * np.cos(turn),
        ],
        axis=2,
    )
    quads = [SIDE * row + column for row in range(SIDE - 1) for column in range(SIDE - 1)]
    faces = [[k, k + 1, k + SIDE + 1] for k in quads] + [[k, k + SIDE + 1, k + SIDE] for k in quads]
    count = len(turns_deg)
    return Trajectory(
        rest_m, uv, np.array(faces), np.array([0]), np.arange(count),
        np.arange(count) / 1.0, np.zeros(count), np.full(count, stage_z_m),
        positions_m.astype(np.float32),
    )  # fmt: skip


def test_a_simulated_cloth_keeps_its_edges_and_a_stretched_one_does_not():
    one = sheet([0.0, 40.0])
    np.testing.assert_allclose(edge_strain(one, one.positions_m.astype(float)), 0, atol=1e-6)
    np.testing.assert_allclose(edge_strain(one, 1.1 * one.positions_m), 0.1, atol=1e-6)


def test_where_the_mean_is_a_cloth_it_is_shown():
    parents = {
        "m00_f0400_r00": sheet([10.0, 20.0]),
        "m00_f0500_r00": sheet([14.0, 26.0], stage_z_m=0.16),
    }
    weights = {"m00_f0400_r00": 0.75, "m00_f0500_r00": 0.25}
    shown = interpolated(parents, weights, "m00_f0400_r00")
    assert shown.metadata["interpolated_frames"] == 2
    low, high = (parents[name].positions_m.astype(float) for name in weights)
    np.testing.assert_allclose(shown.positions_m, 0.75 * low + 0.25 * high, atol=1e-7)
    np.testing.assert_allclose(shown.stage_z_m, 0.1525)
    # A sheet between two small turns is the sheet turned in between.
    between = sheet([11.0, 21.5]).positions_m
    np.testing.assert_allclose(shown.positions_m, between, atol=2e-4)


def test_a_fabric_that_rolls_over_at_another_moment_is_shown_as_simulated_then():
    parents = {"m00_f0400_r00": sheet([10.0, 60.0]), "m00_f0500_r00": sheet([12.0, -60.0])}
    shown = interpolated(parents, dict.fromkeys(parents, 0.5), "m00_f0400_r00")
    assert shown.metadata["interpolated_frames"] == 1
    own = parents["m00_f0400_r00"].positions_m
    np.testing.assert_array_equal(shown.positions_m[1], own[1])


def test_trajectories_at_other_times_are_refused():
    parents = {"m00_f0400_r00": sheet([10.0]), "m00_f0500_r00": sheet([12.0, 13.0])}
    with pytest.raises(BadInput, match="m00_f0500_r00: its frame is not that of m00_f0400_r00"):
        interpolated(parents, dict.fromkeys(parents, 0.5), "m00_f0400_r00")
