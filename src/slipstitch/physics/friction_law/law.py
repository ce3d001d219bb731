"""The friction law as an object: Coulomb friction, mechanisms beside it, a tabulated factor."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.physics.friction_law.mechanisms import (
    CONTACT_MECHANISMS,
    LEAST_RATIO,
    SLOWEST_M_S,
    Contact,
)

MOST_KNOTS = 16
# Quantity of the contact -> least value, of a quantity that is tabulated along its logarithm.
# The order is the numbering of the cloth simulator.
CURVE_QUANTITIES: Mapping[str, float | None] = MappingProxyType(
    {"speed_m_s": SLOWEST_M_S, "load_ratio": LEAST_RATIO, "place_m": None}
)


@dataclass(frozen=True)
class Curve:
    """Factor on the friction force: knots of a quantity and factors there.

    Its logarithm is linear between knots (in the logarithm of speed and load), constant beyond.
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
        """Number of the quantity from 1, knots as searched, and logarithms, filled by the last."""
        missing = MOST_KNOTS - len(self.knots)
        knots = self._searched(np.array(self.knots))
        logs = np.log(self.factors)
        number = list(CURVE_QUANTITIES).index(self.quantity) + 1
        return [number, *knots, *[knots[-1]] * missing, *logs, *[logs[-1]] * missing]


@dataclass(frozen=True)
class FrictionLaw:
    """Largest friction force of a contact: N mu (product of factors) + (sum of added forces)."""

    coefficient: float  # mu of the null law
    # Identifier -> parameter values by name.
    mechanisms: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    curve: Curve | None = None  # a tabulated factor beside them

    def __post_init__(self) -> None:
        for identifier, values in self.mechanisms.items():
            if identifier not in CONTACT_MECHANISMS:
                known = " ".join(CONTACT_MECHANISMS)
                raise BadInput(f"friction law: unknown mechanism '{identifier}'; known: {known}")
            names = {p.name for p in CONTACT_MECHANISMS[identifier].parameters}
            if set(values) != names:
                raise BadInput(
                    f"friction law: mechanism '{identifier}' requires exactly the parameters "
                    f"{', '.join(sorted(names))}; given: {', '.join(sorted(values)) or 'none'}"
                )

    @property
    def differs_at_rest(self) -> bool:
        """Does any mechanism, or the curve, tell friction at rest from friction in motion?"""
        if self.curve and not self.curve.acts_at_rest:
            return True
        return any(
            CONTACT_MECHANISMS[name].factors(True) != CONTACT_MECHANISMS[name].factors(False)
            for name in self.mechanisms
        )

    def force_limit(self, contact: Contact, static: bool) -> np.ndarray:
        """Friction force (N) at which the contact slips (static) or with which it slides."""
        force = self.coefficient * np.asarray(contact.normal_force_N, dtype=float)
        added = 0.0
        for identifier, values in self.mechanisms.items():
            mechanism = CONTACT_MECHANISMS[identifier]
            for factor in mechanism.factors(static):
                force = force * mechanism.value(factor, values, contact)
            if mechanism.added_force is not None:
                added = added + mechanism.value(mechanism.added_force, values, contact)
        if self.curve:
            force = force * self.curve.factor(contact, static)
        return np.maximum(force + added, 0.0)

    def parameter_values(self) -> np.ndarray:
        """Every parameter of ``CONTACT_MECHANISMS``, absent ones at their null; then the curve."""
        own = [
            self.mechanisms.get(identifier, {}).get(parameter.name, parameter.null)
            for identifier, mechanism in CONTACT_MECHANISMS.items()
            for parameter in mechanism.parameters
        ]
        return np.array(own + (self.curve.values() if self.curve else [0.0] * (1 + 2 * MOST_KNOTS)))

    def to_dict(self) -> dict:
        """Plain data from which :meth:`from_dict` makes the same law."""
        mechanisms = {name: dict(values) for name, values in self.mechanisms.items()}
        return {"coefficient": self.coefficient, "mechanisms": mechanisms}

    @classmethod
    def from_dict(cls, data: Mapping) -> "FrictionLaw":
        """The law that ``to_dict`` wrote."""
        return cls(float(data["coefficient"]), dict(data.get("mechanisms", {})))
