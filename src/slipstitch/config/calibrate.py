"""Settings of the calibrate stage. Pydantic and the standard library only."""

from typing import Annotated

from pydantic import Field

from slipstitch.config.section import Section

# What is swept: settings of the section ``simulation``, and the vertices along the strip; and the
# name of the configured settings themselves.
KEYS = ("time_step_s", "vertices", "friction_tolerance", "newton_iterations_max", "damping_s")
BASE = "base"

StripModulus = Annotated[float, Field(ge=6.3e8, le=1e12, allow_inf_nan=False)]
StripStep = Annotated[float, Field(ge=1e-4, le=2.0, allow_inf_nan=False)]
StripVertices = Annotated[int, Field(ge=8, le=1000)]
StripTolerance = Annotated[float, Field(gt=0.0, le=100.0, allow_inf_nan=False)]
StripIterations = Annotated[int, Field(ge=1, le=1000)]
StripDamping = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
Friction = Annotated[float, Field(gt=0.0, le=10.0, allow_inf_nan=False)]


class CalibrateSettings(Section):
    """Settings to sweep, known-answer experiments and their tolerances.

    The strip experiment is run with the settings of the section ``simulation`` and with one of them
    changed at a time; the cheapest that meet the requirements are used, never looser ones than
    ``simulation`` says. With them the other experiments are checked; an empty list of friction
    coefficients leaves its experiment out.
    """

    strip_slip_strain: float = Field(
        6e-3, gt=0.0, lt=1.0, description="pushed strip: largest error of the strain at slip"
    )
    strip_friction: float = Field(
        5e-3,
        gt=0.0,
        lt=1.0,
        description="pushed strip: largest error of the friction coefficient inferred from that "
        "strain",
    )
    strip_frictions: tuple[Friction, ...] = Field(
        (0.05, 0.2, 0.35, 0.4, 0.6), min_length=1, description="pushed strip: friction coefficients"
    )
    strip_young_moduli_Pa: tuple[StripModulus, ...] = Field(
        (6.5e8, 6.5e9),
        min_length=1,
        description="pushed strip: Young's moduli of its fabrics, 1 mm thick, 0.2 kg/m^2",
    )
    strip_vertices: int = Field(
        149, ge=8, le=1000, description="pushed strip: vertices along its 20 cm"
    )
    sweep_time_step_s: tuple[StripStep, ...] = Field(
        (0.01, 0.1, 0.4), description="time steps tried in addition to simulation.time_step_s"
    )
    sweep_vertices: tuple[StripVertices, ...] = Field(
        (8, 15, 41), description="vertices tried in addition to strip_vertices"
    )
    sweep_friction_tolerance: tuple[StripTolerance, ...] = Field(
        (1e-2, 1.0, 10.0),
        description="tolerances tried in addition to simulation.friction_tolerance",
    )
    sweep_newton_iterations_max: tuple[StripIterations, ...] = Field(
        (3, 10), description="limits tried in addition to simulation.newton_iterations_max"
    )
    sweep_damping_s: tuple[StripDamping, ...] = Field(
        (0.0, 0.1), description="damping times tried in addition to simulation.damping_s"
    )

    incline_frictions: tuple[Friction, ...] = Field(
        (0.1, 0.5, 1.2), description="inclined plane: friction coefficients"
    )
    incline_margin: float = Field(
        1e-3,
        gt=0.0,
        lt=0.5,
        description="inclined plane: must stick at tan(slope) = (1 - margin) mu and slide at "
        "(1 + margin) mu",
    )
    incline_steep: float = Field(
        1.5,
        gt=1.0,
        le=10.0,
        description="inclined plane: acceleration is compared at tan(slope) = this times mu",
    )
    incline_creep_m: float = Field(
        1e-6, gt=0.0, description="largest creep of a body that must stick (m in 1 s)"
    )
    incline_acceleration: float = Field(
        1e-3, gt=0.0, lt=1.0, description="largest relative error of the acceleration"
    )

    flat_drag_frictions: tuple[Friction, ...] = Field(
        (0.1, 0.5, 1.0), description="flat drag: friction coefficients"
    )
    flat_drag_pull: float = Field(
        5e-3, gt=0.0, lt=1.0, description="largest relative error of the pull"
    )

    strip_drag_frictions: tuple[Friction, ...] = Field(
        (0.1, 0.3, 0.6, 1.0, 1.5), description="steady strip drag: friction coefficients"
    )
    strip_drag_gravity_length_m: float = Field(
        0.02, gt=0.0, le=0.1, description="steady strip drag: (B/w)^(1/3) of the strip"
    )
    strip_drag_pull: float = Field(
        0.01, gt=0.0, lt=1.0, description="largest relative error of the pull"
    )
    strip_drag_tail_m: float = Field(
        1e-3, gt=0.0, description="largest error of the distance from the tail's end to the holder"
    )
