"""A fabric as it was weighed and bent, beside those that an instrument was tested on."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.config.catalogue import fabric_names
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.fabric import Fabric, load_fabric

# Standard deviation of the logarithms of areal density and bending rigidity, about those of the
# catalogue, in the simulations that calibrate the shipped intervals (config/error_bars.yaml).
SPREAD = 0.25


def bending_length_m(fabric: Fabric) -> float:
    """Return Peirce's bending length (B / w)^(1/3), of weight per area w, mean of warp and weft.

    The rigidity B of a unit width, a quarter of the hinges' stiffness, is that of the strongest
    curvature measured: a strip that hangs over is bent more. F. T. Peirce, J. Text. Inst. 21 (1930)
    T377; ISO 9073-7.
    """
    rigidity_N_m = fabric.bending_N_m[[0, -1], -1] / 4
    return float(np.cbrt(rigidity_N_m / (GRAVITY_M_S2 * fabric.areal_density_kg_m2)).mean())


@dataclass(frozen=True)
class Quantity:
    """What can be told of a fabric."""

    title: str
    unit: str
    allowed: tuple[float, float]  # of any cloth; what lies outside is of another unit
    words: tuple[str, str]  # of a fabric below and above the tested ones
    spread: float  # of its logarithm, tested about each fabric
    of: Callable[[Fabric], float]  # in the unit

    def tested(self, fabrics: Sequence[Fabric]) -> tuple[float, float]:
        """Return between which values an instrument of these fabrics was tested."""
        values, factor = [self.of(one) for one in fabrics], math.exp(self.spread)
        return min(values, default=0.0) / factor, max(values, default=math.inf) * factor


QUANTITIES = {
    "areal_density_g_m2": Quantity(
        "areal density",
        "g/m²",
        (10.0, 2000.0),
        ("too light", "too heavy"),
        SPREAD,
        lambda fabric: 1e3 * fabric.areal_density_kg_m2,
    ),
    "bending_length_mm": Quantity(
        "bending length",
        "mm",
        (2.0, 150.0),
        ("too limp", "too stiff"),
        math.sqrt(2) * SPREAD / 3,
        lambda fabric: 1e3 * bending_length_m(fabric),
    ),
}


@dataclass(frozen=True)
class ToldFabric:
    """Areal density and bending length, where they were told; BadInput if of no cloth."""

    materials: Sequence[str]  # fabrics that trained; those of the catalogue count
    told: Mapping[str, float] = field(default_factory=dict)  # by the names of `QUANTITIES`

    def __post_init__(self):
        for name, value in self.told.items():
            one = QUANTITIES[name]
            low, high = one.allowed
            if not low <= value <= high:
                raise BadInput(
                    f"{one.title} {value:g}: must be from {low:g} to {high:g} {one.unit}"
                )

    def __str__(self) -> str:
        told = (
            f"{QUANTITIES[name].title} {value:g} {QUANTITIES[name].unit}"
            for name, value in self.told.items()
        )
        return ", ".join(told) or "nothing"

    @cached_property
    def tested(self) -> dict[str, tuple[float, float]]:
        """Least and largest of each quantity that was tested."""
        fabrics = [load_fabric(name) for name in self.materials if name in fabric_names()]
        return {name: one.tested(fabrics) for name, one in QUANTITIES.items()}

    @property
    def rows(self) -> list[tuple[str, str, str]]:
        """Of each quantity its name, where it was tested, and what was told."""
        return [
            (
                f"{one.title}, {one.unit}",
                self._range(name),
                f"{self.told[name]:g}" if name in self.told else "not told",
            )
            for name, one in QUANTITIES.items()
        ]

    @property
    def outside(self) -> str:
        """What is outside the tested fabrics, in words; empty if nothing is known to be."""
        found = []
        for name, value in self.told.items():
            one, (low, high) = QUANTITIES[name], self.tested[name]
            if not low <= value <= high:
                found.append(
                    f"the fabric is {one.words[value > high]}: {one.title} {value:g} {one.unit} "
                    f"(tested on {self._range(name)})"
                )
        return "; ".join(found)

    def _range(self, name: str) -> str:
        return " ... ".join(f"{limit:.0f}" for limit in self.tested[name])
