"""A tabulated factor on the friction: what no mechanism describes, along one quantity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.physics.friction_law.contact import Contact
from slipstitch.physics.friction_law.mechanisms import LEAST_RATIO, SLOWEST_M_S

MOST_KNOTS = 16
# Quantity of the contact -> least value, of a quantity that is tabulated along its logarithm.
# The order is the numbering of the cloth simulator.
CURVE_QUANTITIES: Mapping[str, float | None] = MappingProxyType(
    {"speed_m_s": SLOWEST_M_S, "load_ratio": LEAST_RATIO, "place_m": None}
)


@dataclass(frozen=True)
class Curve:
    """Factor on the friction force: knots of a quantity and factors there.

    Between knots the factor's logarithm is linear in the quantity (in its logarithm, for speed and
    load), beyond them constant. A factor along the speed acts in motion only.

    Raises
    ------
    BadInput
        Of another quantity, or of knots that do not increase or have no factor above 0.
    """

    quantity: str
    knots: tuple[float, ...]
    factors: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.quantity not in CURVE_QUANTITIES:
            known = " ".join(CURVE_QUANTITIES)
            raise BadInput(f"curve: unknown quantity '{self.quantity}'; known: {known}")
        if not 2 <= len(self.knots) <= MOST_KNOTS:
            raise BadInput(f"curve: {len(self.knots)} knots; must be 2 to {MOST_KNOTS}")
        if len(self.factors) != len(self.knots):
            raise BadInput(
                f"curve: {len(self.knots)} knots and {len(self.factors)} factors; must be as many"
            )
        if not np.isfinite([*self.knots, *self.factors]).all() or min(self.factors) <= 0:
            raise BadInput("curve: knots must be finite numbers, factors finite and above 0")
        if min(np.diff(self.knots)) <= 0:
            raise BadInput("curve: knots must increase")
        if CURVE_QUANTITIES[self.quantity] is not None and self.knots[0] <= 0:
            raise BadInput(f"curve: knots of {self.quantity} must be above 0")

    @property
    def acts_at_rest(self) -> bool:
        """Does it scale friction at rest as well?"""
        return self.quantity != "speed_m_s"

    def _searched(self, values: np.ndarray) -> np.ndarray:
        least = CURVE_QUANTITIES[self.quantity]
        return values if least is None else np.log(np.maximum(values, least))

    def factor(self, contact: Contact, static: bool) -> np.ndarray | float:
        """The factor for every contact, 1 where the quantity was not recorded."""
        if static and not self.acts_at_rest:
            return 1.0
        searched = self._searched(contact.quantity(self.quantity))
        found = np.interp(searched, self._searched(np.array(self.knots)), np.log(self.factors))
        return np.exp(np.where(np.isnan(searched), 0.0, found))

    def values(self) -> list[float]:
        """Number of the quantity from 1, knots as they are searched, logarithms of the factors.

        Filled to the same length by repeating the last knot.
        """
        missing = MOST_KNOTS - len(self.knots)
        knots = self._searched(np.array(self.knots))
        logs = np.log(self.factors)
        number = list(CURVE_QUANTITIES).index(self.quantity) + 1
        return [number, *knots, *[knots[-1]] * missing, *logs, *[logs[-1]] * missing]
