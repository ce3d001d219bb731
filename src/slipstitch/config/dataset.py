"""Settings of the dataset, of what is handed out, of captures, and of the criticised cases.

Pydantic and the standard library only.
"""

import re
from itertools import product
from pathlib import PurePath
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from slipstitch.config.catalogue import FLOORS, TEXTURES
from slipstitch.config.section import Fabric, Section, known


class SampleSettings(Section):
    """Number of frames per video, and the test videos."""

    frames: int = Field(30, ge=2, le=10000)
    """frames of a video, at regular intervals"""
    phases: int = Field(1, ge=1, le=100)
    """number of phases: this many times the frames are kept, at equal intervals; the instrument
    draws its phase at random in training, everything else uses the first"""
    validation_fraction: float = Field(0.1, ge=0.0, lt=1.0)
    """share of the videos (or replicates) for validation"""
    test_fraction: float = Field(0.1, gt=0.0, lt=1.0)
    """share of the videos (or replicates) for testing"""
    validation_materials: list[str] = []
    """fabrics of the grid that by_simulation keeps from training and testing: all their simulations
    are for validation, so that error bars allow for an unseen fabric"""
    train_only_frictions: list[float] = []
    """coefficients of the grid that by_simulation never holds out: they train, so that those next
    to them are not the end of what a network has seen"""
    hold_out: Literal["auto", "replicate", "pair"] = "auto"
    """what by_simulation holds out: the last replicates of every (material, friction) pair, or
    whole pairs; auto: replicates if there are at least two"""

    @property
    def frames_kept(self) -> int:
        """Frames of a video in the dataset."""
        return self.frames * self.phases

    @model_validator(mode="after")
    def _something_is_left_to_train_on(self) -> "SampleSettings":
        if self.validation_fraction + self.test_fraction >= 1.0:
            raise ValueError("validation_fraction + test_fraction must be below 1")
        return self


class ReleaseSettings(Section):
    """Name and layout of a released dataset."""

    name: str = Field("slipstitch-cloth-friction", pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")
    """name of the dataset: letters, digits, dot, dash, underscore"""
    version: str = Field("0.1.0", pattern=r"^\d+\.\d+\.\d+$")
    """version of the dataset, MAJOR.MINOR.PATCH"""
    shard_mb: float = Field(256.0, gt=0.0, le=5000.0)
    """maximum size of an image shard"""


class PublishSettings(Section):
    """What a published run is called."""

    name: str = Field("demo", pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")
    """folder below results/published: letters, digits, dot, dash, underscore"""


_CASES = (
    *("paper_on_paper", "block_on_wood_board", "block_on_other_board"),
    "surrogate_anisotropic",
)


class CriticiseSettings(Section):
    """The measured cases."""

    cases: tuple[str, ...] = tuple(f"data/cases/{name}" for name in _CASES)
    """case folders (docs/criticise-your-data.md), relative to the working folder, or included in
    the workflow; a folder's name is the case's id"""

    @field_validator("cases")
    @classmethod
    def _named_apart(cls, cases: tuple[str, ...]) -> tuple[str, ...]:
        names = [PurePath(case).name for case in cases]
        if odd := [name for name in names if not re.fullmatch(r"\w[\w-]*", name)]:
            raise ValueError(f"case folder {odd[0]!r}: may contain only letters, digits, - and _")
        if len(set(names)) != len(names):
            raise ValueError(f"case folders with the same name: {', '.join(sorted(names))}")
        return cases


class PairSettings(Section):
    """A surrogate fabric-substrate pair."""

    material: Fabric
    """a fabric of the catalogue"""
    substrate: Annotated[str, known("floor", lambda: FLOORS)]
    """a floor of the catalogue"""
    friction: float = Field(gt=0, le=3)
    """friction coefficient of the pair, off the training grid"""
    texture: Annotated[str, known("texture", lambda: TEXTURES)] = "chevron"
    """texture of the fabric"""


# Two fabrics of the demo's grid on three floors, one that is no class of it.
_PAIRS = [
    PairSettings(material=fabric, substrate=floor, friction=friction, texture=texture)
    for fabric, floor, friction, texture in (
        ("gray-interlock", "matte", 0.23, "chevron"),
        ("royal-target", "aluminium", 0.46, "linen"),
        ("gray-interlock", "ceramic", 0.78, "checks"),
        ("ivory-rib-knit", "smooth-glass", 0.37, "denim"),
    )
]


class CaptureSettings(Section):
    """Captures of the target `captures`, and the generation of surrogates."""

    table: str | None = None
    """captures table of a real bench; null: surrogates are generated"""
    angles: str | None = None
    """slip angles of a real bench, for rows of the table without mu_ref"""
    pairs: list[PairSettings] = Field(_PAIRS, min_length=1, max_length=100)
    """surrogates: the pairs"""
    repeats: int = Field(5, ge=1, le=99)
    """surrogates: videos of each pair"""
    vertices_per_side: int = Field(51, ge=5, le=401)
    """surrogates: vertices per side of the mesh"""
    time_step_s: float = Field(0.042, gt=0, le=0.1)
    """surrogates: largest time step"""
    width_px: int = Field(256, ge=64, le=1920)
    """surrogates: width of the video; its height is three quarters"""
    later_every: int = Field(4, ge=1, le=25)
    """surrogates: afterwards one frame in this many is recorded"""

    @model_validator(mode="after")
    def _pairs_differ(self) -> "CaptureSettings":
        names = [(pair.material, pair.substrate) for pair in self.pairs]
        if len(set(names)) != len(names):
            raise ValueError("pairs: duplicate fabric on the same substrate")
        return self

    def surrogate_ids(self) -> list[str]:
        """Ids of the videos, c00_r01 ... as in a captures table."""
        numbers = product(range(len(self.pairs)), range(1, self.repeats + 1))
        return [f"c{pair:02d}_r{repeat:02d}" for pair, repeat in numbers]
