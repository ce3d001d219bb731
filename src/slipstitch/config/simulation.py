"""Settings of the simulate stage. Pydantic and the standard library only."""

from math import ceil, floor
from typing import Literal

from pydantic import Field, model_validator

from slipstitch.config.section import Fabrics, Section

SIDE_M = 0.20  # of the square of cloth


class StageSettings(Section):
    """Motion of the clamps: down, then forward and back (the paper, Sec. 4.1)."""

    start_height_m: float = Field(
        0.21,
        ge=SIDE_M,
        le=10,
        description="height of the clamps above the floor at the start, from where the cloth, "
        "0.2 m long, hangs down freely",
    )
    drop_m: float = Field(
        0.06,
        ge=0,
        le=10,
        description="distance lowered: less than start_height_m, and enough that the cloth "
        "touches the floor",
    )
    stroke_m: float = Field(0.30, gt=0, le=10, description="length of a stroke along the floor")
    strokes: int = Field(
        4, ge=0, le=100, description="number of strokes: forward, back, forward, back"
    )
    speed_m_s: float = Field(0.010, gt=0, le=1, description="largest speed")
    acceleration_m_s2: float = Field(
        0.010, gt=0, le=10, description="acceleration and deceleration of the stage"
    )

    @model_validator(mode="after")
    def _brings_the_cloth_to_the_floor(self) -> "StageSettings":
        if self.drop_m >= self.start_height_m:
            raise ValueError(
                "drop_m must be less than start_height_m; otherwise the clamps hit the floor"
            )
        if round(self.start_height_m - self.drop_m, 9) >= SIDE_M:
            raise ValueError(
                f"drop_m must be more than {self.start_height_m - SIDE_M:g}, not {self.drop_m:g}; "
                f"otherwise the cloth, {SIDE_M:g} m long, never touches the floor"
            )
        return self


class SimulationSettings(Section):
    """Settings of a drop-and-drag simulation."""

    vertices_per_side: int = Field(
        41, ge=5, le=401, description="vertices per side of the 20 cm square"
    )
    time_step_s: float = Field(
        0.084,
        gt=0,
        le=0.1,
        description="largest time step; the step used divides the time between frames",
    )
    steady_step_s: float = Field(
        0.42,
        gt=0,
        le=1,
        description="largest time step where the motion is steady: several time steps are taken as "
        "one where its error, foreseen from the step before, is at most half of step_error_m",
    )
    step_error_m: float = Field(
        1.0e-4,
        gt=0,
        description="a step whose discretisation error (root mean square over the vertices) is "
        "larger is halved, up to three times",
    )
    frames: int = Field(
        300, ge=1, le=100_000, description="number of recorded frames, the first at 0 s"
    )
    frame_rate_hz: float = Field(2.4, gt=0, le=1000, description="frame k is at k / this rate")
    stage: StageSettings = Field(default_factory=StageSettings)
    friction_tolerance: float = Field(
        5.0e-4,
        gt=0,
        lt=1,
        description="largest out-of-balance force on a vertex in an accepted step, divided by "
        "the friction coefficient times the weight of a vertex",
    )
    newton_iterations_max: int = Field(
        30,
        ge=1,
        le=1000,
        description="limit of Newton iterations; a step that needs more is halved",
    )
    halvings_max: int = Field(12, ge=0, le=20, description="halvings of a step before giving up")
    bending_stiffness_at: Literal["start", "end", "rising"] = Field(
        "rising",
        description="the end of a step whose curvature the stiffness of a fold follows: the start, "
        "as ARCSim does, implicitly the end, or (rising) the end while the moment grows with "
        "curvature, the moment held where it would fall",
    )
    bending_stiffness_at_end: Fabrics = Field(
        ("tango-red-jet-set",),
        description="fabrics for which it is the end whatever bending_stiffness_at says: those "
        "that the cheaper rules were measured to be wrong for (docs/how/physics.md)",
    )
    damping_s: float = Field(
        0.002, ge=0, le=1, description="stiffness-proportional damping time (the paper's 0.002)"
    )
    self_contact: bool = Field(
        True,
        description="contact between layers of the cloth; otherwise they pass through each other",
    )
    thickness_m: float = Field(
        0.001,
        ge=1e-5,
        le=0.01,
        description="distance between the mid-surfaces of layers in contact",
    )
    layer_friction: float | None = Field(
        None,
        ge=0,
        allow_inf_nan=False,
        description="friction coefficient between layers of the cloth; null: the same as with "
        "the floor",
    )
    model: str | None = Field(
        None,
        description="file of an extended model (slipstitch criticise --model): its mechanisms, "
        "tilt and errors of mass and bending apply to every simulation; null: plain Coulomb",
    )
    pins: Literal["tabs", "corner"] = Field(
        "tabs",
        description="clamped vertices: the upper edge within 1 cm of each corner, or "
        "only the corners",
    )
    warp: Literal["u", "v"] = Field(
        "u",
        description="rest direction that counts as the fabric's warp, which extended friction laws "
        "ask for: u along the upper edge, v down from it",
    )
    settle_s: float = Field(2.0, ge=0, le=60, description="rest before the stage starts")
    yaw_sd_deg: float = Field(
        1.0, ge=0, le=45, description="replicates: standard deviation of the clamps' yaw"
    )
    height_sd_m: float = Field(
        0.0005, ge=0, le=0.005, description="replicates: standard deviation of the clamps' height"
    )
    fabric_sd_rel: float = Field(
        0.03,
        ge=0,
        le=1,
        description="replicates: relative standard deviation of areal density, stretching and "
        "bending",
    )
    natural_curl_per_m: float = Field(
        0.5,
        ge=0,
        le=20,
        description="natural curvature of the cloth, which determines to which side the hanging "
        "cloth sags",
    )
    curl_side: Literal["drawn", "same", "alternating"] = Field(
        "drawn",
        description="sign of the curvature: drawn per replicate, the same in all simulations, or "
        "changing from one replicate to the next",
    )
    ideal_replicates: int = Field(
        0,
        ge=0,
        le=100,
        description="replicates: so many, the first, have straight clamps at their height and the "
        "fabric as measured, at every coefficient",
    )

    def of_fabric(self, material: str) -> "SimulationSettings":
        """The settings that a fabric is simulated with."""
        if material not in self.bending_stiffness_at_end:
            return self
        return self.model_copy(update={"bending_stiffness_at": "end"})

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
