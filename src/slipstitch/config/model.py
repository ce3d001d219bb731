"""The configuration as a type, composed of sections in separate files."""

import json

from pydantic import Field, model_validator

from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.config.dataset import (
    CaptureSettings,
    CriticiseSettings,
    PublishSettings,
    ReleaseSettings,
    SampleSettings,
)
from slipstitch.config.render import RenderSettings
from slipstitch.config.section import Section
from slipstitch.config.simulation import (
    CalibrateSettings,
    ComputeSettings,
    ConvergenceSettings,
    GridSettings,
    SimulationSettings,
)
from slipstitch.config.train import (
    BY_SIMULATION,
    REFLECTIVE,
    AblateSettings,
    InstrumentSettings,
    TrainSettings,
)


class Config(Section):
    """The whole configuration, every key with its value."""

    seed: int = Field(1, ge=0, lt=2**31)
    """seed of all random numbers of the chain"""
    grid: GridSettings = Field(default_factory=GridSettings)
    simulation: SimulationSettings = Field(default_factory=SimulationSettings)
    compute: ComputeSettings = Field(default_factory=ComputeSettings)
    calibrate: CalibrateSettings = Field(default_factory=CalibrateSettings)
    convergence: ConvergenceSettings = Field(default_factory=ConvergenceSettings)
    render: RenderSettings = Field(default_factory=RenderSettings)
    sample: SampleSettings = Field(default_factory=SampleSettings)
    train: TrainSettings = Field(default_factory=TrainSettings)
    instrument: InstrumentSettings = Field(default_factory=InstrumentSettings)
    ablate: AblateSettings = Field(default_factory=AblateSettings)
    criticise: CriticiseSettings = Field(default_factory=CriticiseSettings)
    publish: PublishSettings = Field(default_factory=PublishSettings)
    release: ReleaseSettings = Field(default_factory=ReleaseSettings)
    captures: CaptureSettings = Field(default_factory=CaptureSettings)

    @model_validator(mode="after")
    def _sections_agree(self) -> "Config":
        if self.sample.frames_kept > self.simulation.frames:
            raise ValueError(
                f"sample.frames: {self.sample.frames_kept} frames cannot be sampled from "
                f"{self.simulation.frames} (simulation.frames)"
            )
        for key, kind, purpose in (
            ("validation_materials", "materials", "train"),
            ("train_only_frictions", "frictions", "test"),
        ):
            apart, whole = getattr(self.sample, key), getattr(self.grid, kind)
            if others := [value for value in apart if value not in whole]:
                known = ", ".join(map(str, whole))
                raise ValueError(f"sample.{key}: {others[0]} is not in grid.{kind} ({known})")
            if set(apart) == set(whole):
                raise ValueError(
                    f"sample.{key}: has all of grid.{kind}; at least one must be left to {purpose}"
                )
        self._benches_tell_no_coefficient()
        if REFLECTIVE in self.train.splits and not self.render.reflective_floors:
            raise ValueError(f"train.splits: {REFLECTIVE} needs render.reflective_floors")
        return self

    def _benches_tell_no_coefficient(self) -> None:
        """A camera of a family stands elsewhere in every simulation, which tells them apart."""
        for name in (one for one in self.render.test_viewpoints if VIEWPOINTS[one].drawn):
            raise ValueError(
                f"render.test_viewpoints: {name!r} is another camera in every simulation; put it "
                "in render.viewpoints, whole simulations are held out for testing"
            )
        drawn = [name for name in self.render.viewpoints if VIEWPOINTS[name].drawn]
        if self.grid.own_benches and len(drawn) < len(self.render.viewpoints):
            raise ValueError(
                "grid.own_benches: a bench of one coefficient tells it; allowed only with "
                "render.viewpoints of the family bench_1 ..., where whole simulations are held out"
            )
        if self.render.interpolation.share and not drawn:
            raise ValueError(
                "render.interpolation.share: only films of the family bench_1 ... show "
                "interpolated cloths, and render.viewpoints has none of it "
                f"({', '.join(self.render.viewpoints)})"
            )
        others = [split for split in self.train.splits if split != BY_SIMULATION]
        if drawn and others:
            raise ValueError(
                f"train.splits: {others[0]!r} tests on simulations that it trains on, and "
                f"{drawn[0]!r} (render.viewpoints) is another camera in every simulation, which "
                f"would tell its coefficient; allowed is {BY_SIMULATION!r} alone"
            )


def schema_text() -> str:
    """The JSON schema of the configuration, for editors and readers: keys, meaning, bounds.

    ``slipstitch schema > workflow/schemas/config.schema.json`` regenerates the file.
    """
    schema = Config.model_json_schema()
    for section in (schema, *schema["$defs"].values()):
        for key in section["properties"].values():
            if "description" in key:  # a text of several lines in the sources
                key["description"] = " ".join(key["description"].split())
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"
