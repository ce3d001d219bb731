"""The configuration as a type: its sections, each defined in a file of its own beside this one."""

from itertools import pairwise
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from slipstitch.config.ablate import AblateSettings
from slipstitch.config.calibrate import CalibrateSettings
from slipstitch.config.captures import CaptureSettings
from slipstitch.config.convergence import ConvergenceSettings
from slipstitch.config.criticise import CriticiseSettings
from slipstitch.config.evaluate import EvaluateSettings
from slipstitch.config.instrument import InstrumentSettings
from slipstitch.config.release import ReleaseSettings
from slipstitch.config.render import RenderSettings
from slipstitch.config.sample import SampleSettings
from slipstitch.config.simulation import ComputeSettings, SimulationSettings
from slipstitch.config.train import TrainSettings
from slipstitch.material import fabric_names

Friction = Annotated[float, Field(ge=0.0, le=10.0, allow_inf_nan=False)]


class GridSettings(BaseModel):
    """The simulations: every material with every friction coefficient, some times over."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    materials: tuple[str, ...] = Field(
        ("gray-interlock", "11oz-black-denim", "ivory-rib-knit"),
        min_length=1,
        description="fabrics by name; ids m00..m09 are positions in the catalogue of ten",
    )
    frictions: tuple[Friction, ...] = Field(
        (0.1, 0.3, 0.6, 1.0),
        min_length=1,
        max_length=100,
        description="friction coefficients, increasing; ids f00.. are positions in this list",
    )
    replicates: int = Field(
        2, ge=1, le=100, description="simulations of each pair, differently perturbed; ids r00.."
    )
    test_frictions: tuple[Friction, ...] = Field(
        (),
        max_length=100,
        description="coefficients off the grid, increasing, simulated for testing only with every "
        "material; ids follow those of `frictions`",
    )
    test_materials: tuple[str, ...] = Field(
        (), description="fabrics for testing only, simulated with every coefficient of `frictions`"
    )
    test_replicates: int = Field(
        1, ge=1, le=100, description="simulations of each pair that is for testing only"
    )

    @field_validator("materials", "test_materials")
    @classmethod
    def _in_the_catalogue(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        for name in names:
            if name not in fabric_names():
                raise ValueError(f"no material {name!r}; there are: {', '.join(fabric_names())}")
        if len(set(names)) != len(names):
            raise ValueError(f"a material is named twice: {', '.join(names)}")
        return names

    @field_validator("frictions", "test_frictions")
    @classmethod
    def _increasing(cls, frictions: tuple[float, ...]) -> tuple[float, ...]:
        if any(after <= before for before, after in pairwise(frictions)):
            raise ValueError("friction coefficients must increase along the list")
        return frictions

    @model_validator(mode="after")
    def _training_and_testing_are_apart(self) -> "GridSettings":
        for kind in ("materials", "frictions"):
            both = set(getattr(self, kind)) & set(getattr(self, f"test_{kind}"))
            if both:
                raise ValueError(f"{kind} and test_{kind} share {', '.join(map(str, both))}")
        return self


class Config(BaseModel):
    """The whole configuration, every key with its value."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    seed: int = Field(
        1, ge=0, lt=2**31, description="every random number of the chain derives from it"
    )
    grid: GridSettings = Field(default_factory=GridSettings)
    simulation: SimulationSettings = Field(default_factory=SimulationSettings)
    compute: ComputeSettings = Field(default_factory=ComputeSettings)
    calibrate: CalibrateSettings = Field(default_factory=CalibrateSettings)
    convergence: ConvergenceSettings = Field(default_factory=ConvergenceSettings)
    render: RenderSettings = Field(default_factory=RenderSettings)
    sample: SampleSettings = Field(default_factory=SampleSettings)
    train: TrainSettings = Field(default_factory=TrainSettings)
    instrument: InstrumentSettings = Field(default_factory=InstrumentSettings)
    evaluate: EvaluateSettings = Field(default_factory=EvaluateSettings)
    ablate: AblateSettings = Field(default_factory=AblateSettings)
    criticise: CriticiseSettings = Field(default_factory=CriticiseSettings)
    release: ReleaseSettings = Field(default_factory=ReleaseSettings)
    captures: CaptureSettings = Field(default_factory=CaptureSettings)

    @model_validator(mode="after")
    def _sections_agree(self) -> "Config":
        for name in self.convergence.materials:
            if name not in fabric_names():
                raise ValueError(
                    f"convergence.materials: no material {name!r}; there are: "
                    f"{', '.join(fabric_names())}"
                )
        if self.sample.frames_kept > self.simulation.frames:
            raise ValueError(
                f"sample.frames: {self.sample.frames_kept} frames cannot be sampled from the "
                f"{self.simulation.frames} of simulation.frames"
            )
        for name in self.train.view_order or ():
            if name not in self.render.viewpoints:
                raise ValueError(
                    f"train.view_order: {name!r} is not in render.viewpoints "
                    f"({', '.join(self.render.viewpoints)})"
                )
        return self
