"""What every extension of the model has: a name, parameters, and what it needs to know."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from inspect import signature

import numpy as np

from slipstitch.friction_law.contact import Contact

Formula = Callable[..., float | np.ndarray]


@dataclass(frozen=True)
class Parameter:
    """One number of a mechanism; the null value is the one at which the mechanism is absent.

    ``scale`` is the size of a change that matters (finite differences and priors use it).
    """

    name: str
    unit: str
    null: float
    scale: float
    lower: float
    upper: float


@dataclass(frozen=True)
class Mechanism:
    """A departure from plain Coulomb friction, or from the nominal bench or fabric.

    ``needs`` names the recorded covariates without which it cannot be told from anything.
    """

    identifier: str
    title: str
    parameters: tuple[Parameter, ...]
    needs: tuple[str, ...] = ()

    def null_values(self) -> dict[str, float]:
        """Parameter values at which the mechanism does nothing."""
        return {parameter.name: parameter.null for parameter in self.parameters}


@dataclass(frozen=True)
class ContactMechanism(Mechanism):
    """A mechanism of the contact: it scales the friction force, or adds to it.

    A formula is a plain function whose arguments are named after the mechanism's parameters and
    after quantities of :class:`Contact`: one return statement, NumPy's functions only. NumPy
    evaluates it here; the cloth simulator evaluates a translation of the same source.

    Attributes
    ----------
    factor, static_factor, kinetic_factor
        Factor on the Coulomb force: always, at rest only, in motion only.
    added_force
        Force beside it, in N.
    unrecorded
        Quantity -> what stands in for it where it was not recorded: a value at which the formula
        does nothing.
    """

    factor: Formula | None = None
    static_factor: Formula | None = None
    kinetic_factor: Formula | None = None
    added_force: Formula | None = None
    unrecorded: Mapping[str, float] = field(default_factory=dict)

    def factors(self, static: bool) -> list[Formula]:
        """The formulas that scale the friction at rest (``static``) or in motion."""
        found = (self.factor, self.static_factor if static else self.kinetic_factor)
        return [formula for formula in found if formula is not None]

    def value(self, formula: Formula, values: Mapping[str, float], contact: Contact):
        """A formula of this mechanism at parameter values, for every contact."""
        arguments = []
        for name in arguments_of(formula):
            if name in values:
                arguments.append(values[name])
                continue
            quantity = contact.quantity(name)
            if name in self.unrecorded:
                quantity = np.where(np.isnan(quantity), self.unrecorded[name], quantity)
            arguments.append(quantity)
        return formula(*arguments)


@cache
def arguments_of(formula: Formula) -> tuple[str, ...]:
    """Names of a formula's arguments."""
    return tuple(signature(formula).parameters)
