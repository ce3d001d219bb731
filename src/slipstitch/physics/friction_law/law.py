"""The friction law as an object: plain Coulomb friction and the mechanisms that extend it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.physics.friction_law.contact import Contact
from slipstitch.physics.friction_law.curve import MOST_KNOTS, Curve
from slipstitch.physics.friction_law.mechanisms import CONTACT_MECHANISMS


@dataclass(frozen=True)
class FrictionLaw:
    """Largest friction force of a contact.

    ``F = N mu (product of factors) + (sum of added forces)``; with no mechanism and no curve,
    Coulomb's law.

    Parameters
    ----------
    coefficient
        Friction coefficient mu of the null law.
    mechanisms
        Mechanism identifier -> its parameter values by name.
    curve
        A tabulated factor beside them.

    Raises
    ------
    BadInput
        If a mechanism or one of its parameters is unknown or missing.
    """

    coefficient: float
    mechanisms: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    curve: Curve | None = None

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
        """Friction force at which the contact slips (static) or with which it slides (kinetic).

        Returns
        -------
        numpy.ndarray
            In newtons (or newtons per metre, if the loads are per width), shape of the contact's
            fields broadcast together; never negative.
        """
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
        """Every parameter of every mechanism there is, those that are absent at their null.

        Returns
        -------
        numpy.ndarray
            In the order of ``CONTACT_MECHANISMS`` and of their parameters, then
            :meth:`Curve.values`, zeros without a curve.
        """
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
    def from_dict(cls, data: Mapping) -> FrictionLaw:
        """The law that ``to_dict`` wrote."""
        return cls(float(data["coefficient"]), dict(data.get("mechanisms", {})))
