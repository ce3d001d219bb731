"""Settings of the captures: real ones, or surrogates. Pydantic and the standard library only."""

from typing import Annotated

from pydantic import Field, model_validator

from slipstitch.config.catalogue import FLOORS, TEXTURES
from slipstitch.config.section import Fabric, Section, known


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
    """surrogates: vertices per side of the mesh; finer than in training"""
    time_step_s: float = Field(0.042, gt=0, le=0.1)
    """surrogates: largest time step; shorter than in training"""
    width_px: int = Field(256, ge=64, le=1920)
    """surrogates: width of the video; its height is three quarters"""
    later_every: int = Field(4, ge=1, le=6)
    """surrogates: afterwards one frame in this many is recorded"""

    @model_validator(mode="after")
    def _pairs_differ(self) -> "CaptureSettings":
        names = [(pair.material, pair.substrate) for pair in self.pairs]
        if len(set(names)) != len(names):
            raise ValueError("pairs: duplicate fabric on the same substrate")
        return self

    def surrogate_ids(self) -> list[str]:
        """Ids of the videos, c00_r01 ... as in a captures table."""
        return [
            f"c{pair:02d}_r{repeat:02d}"
            for pair in range(len(self.pairs))
            for repeat in range(1, self.repeats + 1)
        ]
