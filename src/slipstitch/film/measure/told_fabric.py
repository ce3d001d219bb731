"""A fabric as it was weighed and bent, beside those that an instrument was tested on."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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


QUANTITIES = {
    "areal_density_g_m2": Quantity(
        "areal density", "g/m²", (10.0, 2000.0), ("too light", "too heavy"), SPREAD
    ),
    "bending_length_mm": Quantity(
        "bending length", "mm", (2.0, 150.0), ("too limp", "too stiff"), math.sqrt(2) * SPREAD / 3
    ),
}


@dataclass(frozen=True)
class ToldFabric:
    """Areal density and bending length, where they were told."""

    told: Mapping[str, float]  # by the names of `QUANTITIES`
    tested: Mapping[str, tuple[float, float]]  # least and largest

    @classmethod
    def beside(cls, materials: Sequence[str], told: Mapping[str, float | None]) -> "ToldFabric":
        """Compare with those of the catalogue that trained; BadInput if a number is of no cloth."""
        given = {name: value for name, value in told.items() if value is not None}
        for name, value in given.items():
            low, high = QUANTITIES[name].allowed
            if not low <= value <= high:
                of_cloth = f"must be from {low:g} to {high:g} {QUANTITIES[name].unit}"
                raise BadInput(f"{QUANTITIES[name].title} {value:g}: {of_cloth}")
        fabrics = [load_fabric(name) for name in materials if name in fabric_names()]
        known = {
            "areal_density_g_m2": [1e3 * one.areal_density_kg_m2 for one in fabrics],
            "bending_length_mm": [1e3 * bending_length_m(one) for one in fabrics],
        }
        tested = {
            name: (
                min(values, default=0.0) * math.exp(-QUANTITIES[name].spread),
                max(values, default=math.inf) * math.exp(QUANTITIES[name].spread),
            )
            for name, values in known.items()
        }
        return cls(given, tested)

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
        return "; ".join(
            f"the fabric is {QUANTITIES[name].words[value > self.tested[name][1]]}: "
            f"{QUANTITIES[name].title} {value:g} {QUANTITIES[name].unit} "
            f"(tested on {self._range(name)})"
            for name, value in self.told.items()
            if not self.tested[name][0] <= value <= self.tested[name][1]
        )

    def _range(self, name: str) -> str:
        return " ... ".join(f"{limit:.0f}" for limit in self.tested[name])
