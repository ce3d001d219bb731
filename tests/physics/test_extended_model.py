"""The file of a verdict's model, and the simulations that run with it."""

import numpy as np
import pytest
import yaml

from slipstitch.base.errors import BadInput
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.friction_law import Contact
from slipstitch.physics.friction_law.extended_model import read_extended_model
from slipstitch.physics.simulation.drop_and_drag import DropAndDrag, simulate_drop_and_drag

MODEL = {
    "causes": ["adhesion", "tilt"],
    "friction_law": {
        "face": {"coefficient": 0.4, "mechanisms": {"adhesion": {"adhesion": 0.8}}},
        "edge": {"coefficient": 0.2, "mechanisms": {}},
    },
    "bench": {"tilt_along_rad": 0.02, "mass_error": 0.1, "camera_scale": 1.02},
}

TABLE = {"covariate": "speed_mm_s", "knots": [1.0, 10.0], "factors": [0.8, 1.2]}


def written(folder, **changes):
    path = folder / "extended_model.yaml"
    path.write_text(yaml.safe_dump(MODEL | changes))
    return path


def test_what_moves_the_cloth_is_told_from_what_changes_readings(tmp_path):
    model = read_extended_model(written(tmp_path))
    assert model.law.mechanisms == {"adhesion": {"adhesion": 0.8}}
    assert (model.mass_error, model.bending_error) == (0.1, 0.0)
    assert model.readings == {"camera_scale": 1.02}
    assert model.law_at(0.7).coefficient == 0.7
    gravity = model.gravity_m_s2(GRAVITY_M_S2)
    assert gravity[0] == pytest.approx(GRAVITY_M_S2 * np.sin(0.02))
    assert np.linalg.norm(gravity) == pytest.approx(GRAVITY_M_S2)


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"friction_law": None}, "friction_law.face: missing"),
        ({"friction_law": {"face": {"mechanisms": {}}}}, "not an extended model"),
        ({"friction_law": {"face": {"coefficient": -1.0}}}, "at least 0"),
        ({"bench": {"mass_error": -1.5}}, "mass_error -1.5: must be above -1"),
        (
            {"bench": {"tilt_along_rad": 1.0, "tilt_across_rad": -1.3}},
            "bench.tilt_along_rad 1 and tilt_across_rad -1.3: their sizes must add up to less",
        ),
        ({"friction_law": {"face": {"coefficient": 1, "mechanisms": {"glue": {}}}}}, "glue"),
        ({"discrepancy": [1, 2]}, "discrepancy: must have covariate, knots and factors"),
        ({"discrepancy": TABLE | {"covariate": "smell"}}, "'smell' is none of speed_mm_s, load"),
        ({"discrepancy": TABLE | {"knots": [10.0, 1.0]}}, "discrepancy: knots must increase"),
        ({"discrepancy": TABLE | {"factors": ["much", 1.0]}}, "must be numbers"),
    ],
)
def test_what_is_wrong_with_a_file_is_said(changes, words, tmp_path):
    with pytest.raises(BadInput, match=words):
        read_extended_model(written(tmp_path, **changes))
    with pytest.raises(BadInput, match=r"none\.yaml: cannot be read"):
        read_extended_model(tmp_path / "none.yaml")


def dragged(friction=0.3, model=None, **settings):
    """A frame every 4 s: the cloth is down after 7 s and dragged from then on."""
    coarse = {"vertices_per_side": 9, "frames": 5, "frame_rate_hz": 0.25, "settle_s": 0.0}
    coarse["friction_tolerance"] = 1e-5  # equal laws agree as closely as steps are solved
    settings = SimulationSettings(**coarse, model=model and str(model), **settings)
    run, columns = simulate_drop_and_drag(DropAndDrag("11oz-black-denim", friction, 0), settings)
    assert columns["residual"].max() <= settings.friction_tolerance
    return run


def tail_m(run):
    return run.positions_m[-1, -9:, 0].mean()


def test_drop_and_drag_runs_with_the_model(tmp_path):
    plain, extended = dragged(), dragged(model=written(tmp_path))
    assert plain.metadata["extended_model"] is None
    assert extended.metadata["extended_model"]["mass_error"] == 0.1
    assert tail_m(extended) < tail_m(plain) - 0.002  # adhesion holds the tail back


@pytest.mark.slow
def test_the_warp_is_the_direction_that_the_configuration_names(tmp_path):
    """Dragged along v, with half as much again along the warp and half as much less across."""
    law = {"coefficient": 0.3, "mechanisms": {"anisotropy": {"anisotropy": 0.5}}}
    model = written(tmp_path, friction_law={"face": law}, bench={})
    along_u, along_v = (dragged(model=model, warp=warp) for warp in "uv")
    assert tail_m(along_v) < tail_m(along_u) - 0.002


def test_a_table_of_factors_is_read_in_its_covariate_s_unit(tmp_path):
    law = read_extended_model(written(tmp_path, discrepancy=TABLE)).law_at(0.5)
    sliding = Contact(normal_force_N=2.0, speed_m_s=0.001 * np.sqrt(10))
    assert law.force_limit(sliding, static=False) == pytest.approx(np.sqrt(0.8 * 1.2) + 0.8)
    place = TABLE | {"covariate": "pos_x_mm", "knots": [0.0, 50.0]}
    law = read_extended_model(written(tmp_path, discrepancy=place)).law
    assert law.curve.knots == (0.0, 0.05)
    drift = TABLE | {"covariate": "clock_min"}  # checked, and left out
    assert read_extended_model(written(tmp_path, discrepancy=drift)).law.curve is None
    with pytest.raises(BadInput, match="2 knots and 3 factors"):
        read_extended_model(written(tmp_path, discrepancy=drift | {"factors": [1, 1, 1]}))


@pytest.mark.slow
def test_drop_and_drag_runs_with_a_table_of_factors(tmp_path):
    """A table of equal factors is another coefficient; one by place acts where the cloth lies."""
    plain, weak = (dragged(friction).positions_m for friction in (0.3, 0.2))
    law = {"face": {"coefficient": 0.2, "mechanisms": {}}}
    place = {"covariate": "pos_x_mm"}

    def with_table(friction, table):
        model = written(tmp_path, friction_law=law, bench={}, discrepancy=table)
        return dragged(friction, model).positions_m

    assert np.array_equal(with_table(0.3, None), plain)  # bit by bit
    for knots, factors in (([-500.0, 500.0], [1.5, 1.5]), ([-500.0, -300.0], [3.0, 1.5])):
        found = with_table(0.2, place | {"knots": knots, "factors": factors})
        np.testing.assert_allclose(found, plain, atol=2e-5)
    assert np.abs(weak - plain).max() > 1e-3
