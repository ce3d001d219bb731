"""Settings of the simulate stage. Pydantic and the standard library only."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class SimulationSettings(BaseModel):
    """How one drop-and-drag run is simulated."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    vertices_per_side: int = Field(
        41, ge=5, le=401, description="vertices along a side of the 20 cm square"
    )
    time_step_s: float = Field(
        0.084,
        gt=0,
        le=0.1,
        description="largest time step; the step used divides the time between frames",
    )
    step_error_m: float = Field(
        1.0e-4,
        gt=0,
        description="a step whose discretisation moves the vertices by more (root mean square) "
        "is halved, up to three times; .inf: never",
    )
    frames: int = Field(300, ge=1, le=100_000, description="recorded frames, the first at 0 s")
    frame_rate_hz: float = Field(2.4, gt=0, le=1000, description="frame k is at k / this rate")
    friction_tolerance: float = Field(
        5.0e-4,
        gt=0,
        lt=1,
        description="largest out-of-balance force on a vertex in an accepted step, over "
        "friction coefficient times the weight of a vertex",
    )
    newton_iterations_max: int = Field(
        30, ge=1, le=1000, description="a step that needs more is halved"
    )
    halvings_max: int = Field(8, ge=0, le=20, description="halvings of a step before giving up")
    bending_stiffness_at: Literal["start", "end", "rising"] = Field(
        "rising",
        description="the end of a step whose curvature the stiffness of a fold follows: the start, "
        "as ARCSim does, implicitly the end, or (rising) the end where it grows with curvature and "
        "the start where it falls",
    )
    damping_s: float = Field(
        0.002, ge=0, le=1, description="stiffness-proportional damping time (the paper's 0.002)"
    )
    self_contact: bool = Field(
        True, description="layers of the cloth touch one another instead of passing through"
    )
    thickness_m: float = Field(
        0.001, ge=1e-5, le=0.01, description="distance of the middle surfaces of touching layers"
    )
    layer_friction: float | None = Field(
        None,
        ge=0,
        allow_inf_nan=False,
        description="friction coefficient between layers of the cloth; null: that of the floor",
    )
    model: str | None = Field(
        None,
        description="file of an extended model (slipstitch criticise --model): its mechanisms, "
        "tilt and errors of mass and bending apply to every simulation; null: plain Coulomb",
    )
    pins: Literal["tabs", "corner"] = Field(
        "tabs", description="held: the upper edge within 1 cm of each corner, or the corners only"
    )
    settle_s: float = Field(2.0, ge=0, le=60, description="rest before the stage starts")
    yaw_sd_deg: float = Field(1.0, ge=0, le=45, description="replicates: spread of the clamps' yaw")
    height_sd_m: float = Field(
        0.0005, ge=0, le=0.005, description="replicates: spread of the clamps' height"
    )
    fabric_sd_rel: float = Field(
        0.03,
        ge=0,
        le=0.3,
        description="replicates: relative spread of areal density, stretching and bending",
    )
    natural_curl_per_m: float = Field(
        0.5,
        ge=0,
        le=20,
        description="natural curvature of the cloth; its side, drawn per replicate, decides "
        "to which side the hanging cloth sags",
    )


class ComputeSettings(BaseModel):
    """Where simulations run, and how many at once: to rounding, they are the same."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    device: str = Field(
        "cpu",
        pattern=r"^(cpu|cuda(:\d+)?)$",
        description="where forces and stiffness are evaluated: cpu, cuda, cuda:1 ...; the linear "
        "systems are solved on the CPU in any case",
    )
    batch: int = Field(
        1,
        ge=1,
        le=256,
        description="simulations in one job, evaluated at once: for cuda; on the cpu a job each "
        "is faster, as jobs run side by side",
    )
