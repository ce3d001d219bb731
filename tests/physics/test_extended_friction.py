"""The extended friction law in the cloth as in NumPy, then in motion; the file of a verdict."""

import math

import numpy as np
import pytest
import warp as wp
import yaml
from scipy.optimize import bisect

from slipstitch.base.errors import BadInput
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.cloth import Conditions, SolverSettings, rectangle
from slipstitch.physics.cloth.friction import ContactState, force_limit
from slipstitch.physics.experiments.specimen import started
from slipstitch.physics.fabric import isotropic_tables
from slipstitch.physics.friction_law import CONTACT_MECHANISMS, Contact, Curve, FrictionLaw
from slipstitch.physics.friction_law.extended_model import read_extended_model
from slipstitch.physics.simulation.drop_and_drag import DropAndDrag, simulate_drop_and_drag

AREAL_DENSITY_KG_M2 = 0.2
PRESSURE_PA = AREAL_DENSITY_KG_M2 * GRAVITY_M_S2
MU = 0.4
STEP_S = 0.02
TILT_STEPS = 100
RESTED_S = 18.0
# A plain amount of every mechanism there is.
PLAIN = {
    "load_power": {"load_power": -0.15},
    "adhesion": {"adhesion": 0.2},
    "static_kinetic": {"static_kinetic": 0.25},
    "ageing": {"ageing": 0.1},
    "rate": {"rate": 0.2},
    "anisotropy": {"anisotropy": 0.2},
    "nap": {"nap": -0.2},
    "wear": {"wear": 0.3, "wear_r0": 2.0},
    "humidity": {"humidity": 0.1},
}
CURVES = [
    Curve("speed_m_s", (0.001, 0.004, 0.03), (0.8, 1.3, 1.1)),
    Curve("load_ratio", (0.5, 5.0, 40.0, 900.0), (1.2, 1.0, 0.7, 0.9)),
    Curve("place_m", tuple(np.linspace(-0.1, 0.2, 16)), tuple(1 + 0.2 * np.sin(np.arange(16)))),
]
LAWS = [*[{name: PLAIN[name]} for name in CONTACT_MECHANISMS], PLAIN]

QUANTITIES = tuple(ContactState.vars)


@wp.kernel(enable_backward=False)
def _limits(
    values: wp.array(dtype=wp.float64),
    at_rest: bool,
    states: wp.array(dtype=ContactState),
    limits: wp.array(dtype=wp.float64),
):
    i = wp.tid()
    limits[i] = force_limit(wp.float64(0.4), values, at_rest, states[i])


@pytest.mark.parametrize("static", [True, False])
@pytest.mark.parametrize(
    "law",
    [FrictionLaw(MU, mechanisms) for mechanisms in LAWS]
    + [FrictionLaw(MU, {}, curve) for curve in CURVES]
    + [FrictionLaw(MU, PLAIN, CURVES[0])],
    ids=lambda law: "+".join([*law.mechanisms, law.curve.quantity if law.curve else "plain"]),
)
def test_warp_and_numpy_evaluate_the_same_law(law, static):
    random = np.random.default_rng(7)
    low = np.array([1e-6, 1e-5, -7, 0, 0, 0, 20, -0.2])
    high = np.array([1.0, 1e-2, 7, 1e3, 0.1, 30, 80, 0.3])
    states = low + (high - low) * random.random((500, 8))
    limits = wp.zeros(500, dtype=wp.float64, device="cpu")
    values = wp.array(law.parameter_values(), dtype=wp.float64, device="cpu")
    rows = np.array([*map(tuple, states)], dtype=ContactState.numpy_dtype())
    inputs = [values, static, wp.array(rows, dtype=ContactState, device="cpu"), limits]
    wp.launch(_limits, dim=500, inputs=inputs, device="cpu")
    expected = law.force_limit(Contact(**dict(zip(QUANTITIES, states.T, strict=True))), static)
    assert expected.std() > 0
    np.testing.assert_allclose(limits.numpy(), expected, rtol=1e-13)


def gravity(slope_rad):
    return GRAVITY_M_S2 * math.sin(slope_rad), 0.0, -GRAVITY_M_S2 * math.cos(slope_rad)


def slope_solver(law, slope_rad, conditions=None, speed_m_s=0.0, rested_s=0.0):
    """A square of cloth resting on a plane that is tilted slowly to a slope (downhill is x)."""
    mesh = rectangle(4, 4, 0.02, 0.02)
    # Laid so that sliding downhill is along -v.
    u, v = mesh.rest_uv_m.T
    tables = isotropic_tables(AREAL_DENSITY_KG_M2, 200.0, 1e-7)
    start_m, free = np.column_stack([-v, u, 0 * u]), np.zeros((mesh.vertex_count, 3), bool)
    settings = SolverSettings(friction_tolerance=1e-7)
    solver = started(settings, mesh, tables, start_m, free, law, conditions)
    solver.positions_m[:, 2] = -solver.mass_kg * GRAVITY_M_S2 / solver.contact_stiffness_N_m
    solver.start()
    solver.floor.rest(rested_s)
    for angle in np.linspace(0, slope_rad, TILT_STEPS + 1)[1:]:
        solver.set_gravity(gravity(angle))
        solver.advance(STEP_S)
    solver.velocities_m_s[:, 0] += speed_m_s
    return solver


def travelled(solver, duration_s=0.4):
    start_m = solver.positions_m[:, 0].mean()
    for _ in range(round(duration_s / STEP_S)):
        solver.advance(STEP_S)
    return solver.positions_m[:, 0].mean() - start_m


def threshold_rad(law, contact):
    """Slope at which W sin = F(W cos), by bisection on the law as NumPy has it."""

    def margin(slope):
        load = PRESSURE_PA * math.cos(slope)
        return law.force_limit(contact.with_load(load, 1.0), True) - PRESSURE_PA * math.sin(slope)

    return bisect(margin, 0.0, 1.2, xtol=1e-14)


# warp angle such that the cloth slides at 0.5 rad from the warp: -v is at -pi/2 from u.
SLIDING_RAD = 0.5
CONDITIONS = Conditions(
    warp_angle_rad=-math.pi / 2 - SLIDING_RAD, relative_humidity_pct=62.0, repeats=3.0
)
AT_REST = Contact(
    normal_force_N=1.0,
    direction_rad=SLIDING_RAD,
    dwell_s=RESTED_S + TILT_STEPS * STEP_S,
    repeats=3.0,
    relative_humidity_pct=62.0,
)


@pytest.mark.parametrize("mechanisms", LAWS, ids=lambda law: "+".join(law))
def test_cloth_sticks_below_the_law_s_threshold_without_creep_and_slides_above(mechanisms):
    law = FrictionLaw(MU, mechanisms)
    threshold = threshold_rad(law, AT_REST)
    slope = math.tan(threshold)
    below = slope_solver(law, math.atan(0.995 * slope), CONDITIONS, rested_s=RESTED_S)
    assert abs(travelled(below)) < 1e-7
    above = slope_solver(law, math.atan(1.02 * slope), CONDITIONS, rested_s=RESTED_S)
    assert travelled(above) > 1e-4


def test_cloth_once_sliding_feels_kinetic_friction():
    law = FrictionLaw(MU, {"static_kinetic": {"static_kinetic": 0.25}})
    slope = math.atan(1.3 * MU)
    solver = slope_solver(law, slope)
    travelled(solver)
    expected = GRAVITY_M_S2 * (math.sin(slope) - MU * math.cos(slope))
    before = solver.velocities_m_s[:, 0].mean()
    travelled(solver, 0.1)
    gained = solver.velocities_m_s[:, 0].mean() - before
    assert gained / 0.1 == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(
    "law, terminal_m_s",
    [
        # tan(slope) = mu (1 + b log10(v / 10 mm/s))
        (FrictionLaw(MU, {"rate": {"rate": 0.2}}), 0.010 * 10 ** (0.1 / 0.2)),
        # tan(slope) = mu f(v), the logarithm of f linear in ln v
        (
            FrictionLaw(MU, {}, Curve("speed_m_s", (0.002, 0.05), (0.9, 1.3))),
            0.002 * 25.0 ** (math.log(1.1 / 0.9) / math.log(1.3 / 0.9)),
        ),
    ],
    ids=["mechanism", "curve"],
)
def test_friction_that_grows_with_speed_gives_the_closed_form_s_terminal_speed(law, terminal_m_s):
    solver = slope_solver(law, math.atan(1.1 * MU), speed_m_s=0.02)
    travelled(solver, 2.0)
    assert solver.velocities_m_s[:, 0].mean() == pytest.approx(terminal_m_s, rel=1e-3)


def test_a_curve_over_the_place_stops_a_slide_where_friction_has_grown():
    """Energy: it slides, stiff as it is, until gravity has done the work of friction."""
    law = FrictionLaw(MU, {}, Curve("place_m", (0.0, 0.1), (1.0, 2.0)))
    slope = math.atan(1.2 * MU)
    solver = slope_solver(law, 0.0)
    solver.set_gravity(gravity(slope))
    start_m = solver.positions_m[:, 0].mean()
    for _ in range(400):  # of a quarter of the usual step, which takes 6 % of the energy
        solver.advance(STEP_S / 4)
    moved = solver.positions_m[:, 0].mean() - start_m
    assert abs(solver.velocities_m_s[:, 0]).max() < 1e-6
    shares = solver.mass_kg / solver.mass_kg.sum()
    path = np.linspace(0.0, 0.1, 2001)
    reached = np.clip(path[:, None] - solver.mesh.rest_uv_m[:, 1], 0.0, 0.1)
    pull = 1.2 - 2.0 ** (reached / 0.1) @ shares
    work = np.cumsum(0.5 * (pull[1:] + pull[:-1]))
    assert moved == pytest.approx(path[1 + np.flatnonzero(work < 0)[0]], rel=0.02)


def test_rest_and_slides_are_counted():
    law = FrictionLaw(MU, {"wear": PLAIN["wear"]})
    solver = slope_solver(law, 0.0, speed_m_s=0.2)
    state = solver.floor.state
    travelled(solver, STEP_S)
    assert (state.sliding.numpy() == 1).all() and (state.dwell_s.numpy() == 0).all()
    travelled(solver, 0.2)  # mu g = 4 m/s2 stops it after 0.05 s and 5 mm
    assert (state.sliding.numpy() == 0).all()
    np.testing.assert_allclose(state.repeats.numpy(), 1.0)
    assert 0.1 < state.dwell_s.numpy().min() <= state.dwell_s.numpy().max() < 0.2
    solver.floor.rest(30.0)
    assert state.dwell_s.numpy().min() > 30.0


def test_a_law_without_mechanisms_is_coulomb_s_bit_by_bit():
    slope = math.atan(1.1 * MU)
    plain, law = slope_solver(MU, slope), slope_solver(FrictionLaw(MU), slope)
    travelled(plain), travelled(law)
    assert np.array_equal(plain.positions_m, law.positions_m)


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
