"""Settings of the calibrate stage. Pydantic and the standard library only."""

from typing import Annotated

from pydantic import Field

from slipstitch.config.section import Section

# What is swept: settings of the section ``simulation``, and the vertices along the strip; and the
# name of the configured settings themselves.
KEYS = ("time_step_s", "vertices", "friction_tolerance", "newton_iterations_max", "damping_s")
BASE = "base"

StripStep = Annotated[float, Field(ge=1e-4, le=2.0, allow_inf_nan=False)]
StripVertices = Annotated[int, Field(ge=8, le=1000)]
StripTolerance = Annotated[float, Field(gt=0.0, le=100.0, allow_inf_nan=False)]
StripIterations = Annotated[int, Field(ge=1, le=1000)]
StripDamping = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
Friction = Annotated[float, Field(gt=0.0, le=10.0, allow_inf_nan=False)]


class CalibrateSettings(Section):
    """Settings to sweep with the pushed strip.

    The strip experiment is run with the settings of the section ``simulation`` and with one of them
    changed at a time; the cheapest that meet the requirements are used, never looser ones than
    ``simulation`` says. With them the other known-answer experiments are checked.
    """

    strip_frictions: tuple[Friction, ...] = Field(
        (0.05, 0.2, 0.35, 0.4, 0.6), min_length=1, description="pushed strip: friction coefficients"
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
