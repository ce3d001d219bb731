"""Settings of the grid, of the simulations, their calibration, and the convergence study.

Pydantic and the standard library only.
"""

from itertools import pairwise
from math import ceil, floor, gcd
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from slipstitch.config.section import Fabrics, Frictions, RecordedSection, Section, apart

SIDE_M = 0.20  # of the square of cloth
# Fabrics whose folds' stiffness follows the end of a step whatever bending_stiffness_at says: the
# cheaper rules were measured to be wrong for them (docs/how/physics.md).
BENT_AT_END = ("tango-red-jet-set",)
# Of the convergence study, by name: a fabric added to the catalogue changes no configuration.
STUDIED_FABRICS = (
    *("ivory-rib-knit", "pink-ribbon-brown", "white-dots-on-blk", "navy-sparkle-sweat"),
    *("camel-ponte-roma", "gray-interlock", "11oz-black-denim", "white-swim-solid"),
    *("tango-red-jet-set", "royal-target"),
)
# What is swept: settings of the section ``simulation``, and the vertices along the strip; and the
# name of the configured settings themselves.
KEYS = ("time_step_s", "vertices", "friction_tolerance", "newton_iterations_max", "damping_s")
BASE = "base"
TOLERANCES = (1e-2, 1.0, 10.0)
DEMO_FABRICS = ("gray-interlock", "11oz-black-denim", "ivory-rib-knit")


class GridSettings(Section):
    """The simulations: every material with every friction coefficient, some times over."""

    materials: Fabrics = Field(DEMO_FABRICS, min_length=1)
    """fabrics by name; ids m00..m09 are positions in the catalogue of ten"""
    frictions: Frictions = Field((0.1, 0.3, 0.6, 1.0), min_length=1, max_length=100)
    """friction coefficients, increasing, multiples of 0.001; id f0350 is 0.35"""
    replicates: int = Field(2, ge=1, le=100)
    """simulations of each pair with different perturbations; ids r00.."""
    test_frictions: Frictions = Field((), max_length=100)
    """off-grid coefficients, increasing, for testing only, simulated with every material; ids
    follow those of `frictions`"""
    test_materials: Fabrics = ()
    """unseen fabrics, for testing only, simulated with every coefficient of `frictions`"""
    own_benches: bool = False
    """every simulation has clamps, curl and fabric of its own, shared with none at another
    coefficient; only where its cameras are its own as well (viewpoints bench_1 ...), so that whole
    simulations are held out; ideal replicates share theirs"""

    @model_validator(mode="after")
    def _training_and_testing_are_apart(self) -> "GridSettings":
        apart(self, "materials", "frictions")
        return self


class StageSettings(Section):
    """Motion of the clamps: down, then forward and back (the paper, Sec. 4.1)."""

    start_height_m: float = Field(0.21, ge=SIDE_M, le=10)
    """height of the clamps above the floor at the start, from where the cloth, 0.2 m long, hangs
    down freely"""
    drop_m: float = Field(0.06, ge=0, le=10)
    """distance lowered: less than start_height_m, and enough that the cloth touches the floor"""
    stroke_m: float = Field(0.30, gt=0, le=10)
    """length of a stroke along the floor"""
    strokes: int = Field(4, ge=0, le=100)
    """number of strokes: forward, back, forward, back"""
    speed_m_s: float = Field(0.010, gt=0, le=1)
    """largest speed"""
    acceleration_m_s2: float = Field(0.010, gt=0, le=10)
    """acceleration and deceleration of the stage"""

    @model_validator(mode="after")
    def _brings_the_cloth_to_the_floor(self) -> "StageSettings":
        if self.drop_m >= self.start_height_m:
            raise ValueError("drop_m must be less than start_height_m: the clamps hit the floor")
        if round(self.start_height_m - self.drop_m, 9) >= SIDE_M:
            raise ValueError(
                f"drop_m must be more than {self.start_height_m - SIDE_M:g}, not {self.drop_m:g}; "
                f"otherwise the cloth, {SIDE_M:g} m long, never touches the floor"
            )
        return self


class SimulationSettings(RecordedSection):
    """Settings of a drop-and-drag simulation."""

    NAME = "simulation"

    vertices_per_side: int = Field(41, ge=5, le=401)
    """vertices per side of the 20 cm square"""
    time_step_s: float = Field(0.084, gt=0, le=0.1)
    """largest time step; the step used divides the time between frames"""
    steady_step_s: float = Field(0.42, gt=0, le=1)
    """largest time step where the motion is steady: several time steps are taken as one where its
    error, foreseen from the step before, is at most half of step_error_m"""
    step_error_m: float = Field(1.0e-4, gt=0)
    """a step whose discretisation error (root mean square over the vertices) is larger is halved,
    up to three times"""
    frames: int = Field(300, ge=1, le=100_000)
    """number of recorded frames, the first at 0 s"""
    frame_rate_hz: float = Field(2.4, gt=0, le=1000)
    """frame k is at k / this rate"""
    stage: StageSettings = Field(default_factory=StageSettings)
    friction_tolerance: float = Field(5.0e-4, gt=0, lt=1)
    """largest out-of-balance force on a vertex in an accepted step, divided by the friction
    coefficient times the weight of a vertex"""
    newton_iterations_max: int = Field(30, ge=1, le=1000)
    """limit of Newton iterations; a step that needs more is halved"""
    bending_stiffness_at: Literal["start", "end", "rising"] = "rising"
    """the end of a step whose curvature the stiffness of a fold follows: the start, as ARCSim does,
    implicitly the end, or (rising) the end while the moment grows with curvature, the moment held
    where it would fall"""
    damping_s: float = Field(0.002, ge=0, le=1)
    """stiffness-proportional damping time (the paper's 0.002)"""
    self_contact: bool = True
    """contact between layers of the cloth; otherwise they pass through each other"""
    thickness_m: float = Field(0.001, ge=1e-5, le=0.01)
    """distance between the mid-surfaces of layers in contact"""
    layer_friction: float | None = Field(None, ge=0)
    """friction coefficient between layers of the cloth; null: the same as with the floor"""
    model: str | None = None
    """file of an extended model (slipstitch criticise --model): its mechanisms, tilt and errors of
    mass and bending apply to every simulation; null: plain Coulomb"""
    pins: Literal["tabs", "corner"] = "tabs"
    """clamped vertices: the upper edge within 1 cm of each corner, or only the corners"""
    warp: Literal["u", "v"] = "u"
    """rest direction that counts as the fabric's warp, which extended friction laws ask for: u
    along the upper edge, v down from it"""
    settle_s: float = Field(2.0, ge=0, le=60)
    """rest before the stage starts"""
    yaw_sd_deg: float = Field(1.0, ge=0, le=45)
    """replicates: standard deviation of the clamps' yaw"""
    height_sd_m: float = Field(0.0005, ge=0, le=0.005)
    """replicates: standard deviation of the clamps' height"""
    fabric_sd_rel: float = Field(0.03, ge=0, le=1)
    """replicates: relative standard deviation of areal density, stretching and bending"""
    natural_curl_per_m: float = Field(0.5, ge=0, le=20)
    """natural curvature of the cloth, which determines to which side the hanging cloth sags"""
    curl_side: Literal["drawn", "same", "alternating"] = "drawn"
    """sign of the curvature: drawn per replicate, the same in all simulations, or changing from one
    replicate to the next"""
    ideal_replicates: int = Field(0, ge=0, le=100)
    """replicates: so many, the first, have straight clamps at their height and the fabric as
    measured, at every coefficient"""

    def of_fabric(self, material: str) -> "SimulationSettings":
        """The settings that a fabric is simulated with."""
        at_end = {"bending_stiffness_at": "end"} if material in BENT_AT_END else {}
        return self.model_copy(update=at_end)

    @property
    def steps_a_frame(self) -> int:
        """Number of time steps between frames."""
        return ceil(1.0 / self.frame_rate_hz / self.time_step_s - 1e-9)

    @property
    def step_used_s(self) -> float:
        """Time step that divides the time between frames."""
        return 1.0 / self.frame_rate_hz / self.steps_a_frame

    @property
    def settle_steps(self) -> int:
        """Number of time steps before the stage starts."""
        return ceil(self.settle_s / self.step_used_s - 1e-9)

    @property
    def recorded_steps(self) -> int:
        """Number of time steps from the first frame to the last."""
        return (self.frames - 1) * self.steps_a_frame

    @property
    def steps_at_once(self) -> int:
        """Number of time steps that may be taken as one where the motion is steady."""
        return max(1, floor(self.steady_step_s / self.step_used_s + 1e-9))

    @property
    def recorded_s(self) -> float:
        """Time of the last recorded frame, from the start of the stage."""
        return (self.frames - 1) / self.frame_rate_hz


class ComputeSettings(Section):
    """Device of simulations, and those that are not computed: results are equal up to rounding."""

    device: str = Field("cpu", pattern=r"^(cpu|cuda(:\d+)?)$")
    """where forces and stiffness are evaluated: cpu, cuda, cuda:1 ...; linear systems are always
    solved on the CPU"""
    handed_out: str | None = None
    """folder of simulations, or a release: what is there with the same fabric, coefficient, seed
    and settings is taken instead of being simulated; null: none"""


class CalibrateSettings(Section):
    """Settings to sweep with the pushed strip.

    The strip experiment is run with the settings of the section ``simulation`` and with one of them
    changed at a time; the cheapest that meet the requirements are used, never looser ones than
    ``simulation`` says. With them the other known-answer experiments are checked.
    """

    strip_frictions: tuple[Annotated[float, Field(gt=0.0, le=10.0)], ...] = Field(
        (0.05, 0.2, 0.35, 0.4, 0.6), min_length=1
    )
    """pushed strip: friction coefficients"""
    strip_vertices: int = Field(149, ge=8, le=1000)
    """pushed strip: vertices along its 20 cm"""
    sweep_time_step_s: tuple[Annotated[float, Field(ge=1e-4, le=2.0)], ...] = (0.01, 0.1, 0.4)
    """time steps tried in addition to simulation.time_step_s"""
    sweep_vertices: tuple[Annotated[int, Field(ge=8, le=1000)], ...] = (8, 15, 41)
    """vertices tried in addition to strip_vertices"""
    sweep_friction_tolerance: tuple[Annotated[float, Field(gt=0.0, le=100.0)], ...] = TOLERANCES
    """tolerances tried in addition to simulation.friction_tolerance"""
    sweep_newton_iterations_max: tuple[Annotated[int, Field(ge=1, le=1000)], ...] = (3, 10)
    """limits tried in addition to simulation.newton_iterations_max"""
    sweep_damping_s: tuple[Annotated[float, Field(ge=0.0, le=1.0)], ...] = (0.0, 0.1)
    """damping times tried in addition to simulation.damping_s"""


class ConvergenceSettings(Section):
    """Runs of drop-and-drag to compare, and the criterion of convergence.

    Every fabric and coefficient is simulated at the settings of the section ``simulation``, on
    finer meshes, and with everything finer that stepping in time depends on: the time step a
    quarter as long and never longer where the motion is steady, the error allowed to a step and
    the tolerance a sixteenth, and the stiffness of folds implicit.
    """

    materials: Fabrics = Field(STUDIED_FABRICS, min_length=1)
    """fabrics of the catalogue"""
    frictions: Frictions = Field((0.1, 0.5, 1.5), min_length=1)
    """friction coefficients, increasing, multiples of 0.001; between two, the worse of them is
    said"""
    vertices_per_side: tuple[int, ...] = Field((41, 81), min_length=1)
    """vertices per side of the meshes, increasing, with vertices at common positions on the
    cloth"""
    window_s: float = Field(56.0, gt=0, le=131)
    """simulated part of the protocol; 56 s cover the drop, the first stroke and the first
    reversal"""

    @field_validator("vertices_per_side")
    @classmethod
    def _share_places(cls, sides: tuple[int, ...]) -> tuple[int, ...]:
        if any(after <= before for before, after in pairwise(sides)) or sides[0] < 5:
            raise ValueError("meshes must increase along the list, from 5 vertices per side")
        if gcd(*(side - 1 for side in sides)) < 4:
            raise ValueError(
                f"meshes of {', '.join(map(str, sides))} vertices per side have too few positions "
                "in common: one less than each must be a multiple of 4 or more, e.g. 41, 61, 81"
            )
        return sides
