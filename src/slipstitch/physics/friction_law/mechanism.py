"""Common parts of all extensions of the model: name, parameters, required quantities."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from inspect import signature
from typing import Any

import numpy as np

from slipstitch.physics.friction_law.contact import Contact

Formula = Callable[..., float | np.ndarray]


@dataclass(frozen=True)
class Parameter:
    """One number of a mechanism; the null value is the one at which the mechanism is absent.

    Attributes
    ----------
    scale : size of a change that matters; finite differences and priors use it.
    lower, upper : bounds of a fit.
    kinked : the readings have a kink at the null, so that either side has its own descent.
    prior_sd : standard deviation of the prior about the null; without one, thirty scales.
    relative : true = nominal (1 + parameter); the interval is symmetric in the logarithm.
    coefficient : a friction coefficient, fitted as its natural logarithm.
    """

    name: str
    unit: str
    null: float
    scale: float
    lower: float
    upper: float
    kinked: bool = False
    prior_sd: float | None = None
    relative: bool = False
    coefficient: bool = False

    @property
    def prior_width(self) -> float:
        """Standard deviation of the weak prior of a fit."""
        return 30 * self.scale if self.prior_sd is None else self.prior_sd


@dataclass(frozen=True)
class Mechanism:
    """A departure from plain Coulomb friction, or from the nominal bench or fabric.

    Attributes
    ----------
    identifier, title : name in verdicts, and what is said after "the model is wrong because".
    covariate : column of a feature that drives it; None if it acts alike everywhere. Where the
        column is empty, the mechanism may not be blamed.
    aliased_if_unrecorded : mechanism that would do the same where that one's covariate was not
        recorded.
    tested_at : values of parameters that mean nothing at the null (an onset, a place), at each of
        which the others are tested.
    starts : values at each of which a fit starts; without any, at the null.
    components : names under which two parameters, components of a vector along 0 and 90 degrees,
        are reported: its size and its direction.
    direct_check : a measurement of the mechanism itself, and the standard deviation to which it
        tells each parameter.
    """

    identifier: str
    title: str
    parameters: tuple[Parameter, ...]
    covariate: str | None = field(default=None, kw_only=True)
    aliased_if_unrecorded: str | None = field(default=None, kw_only=True)
    tested_at: tuple[Mapping[str, float], ...] = field(default=(), kw_only=True)
    starts: tuple[Mapping[str, float], ...] = field(default=(), kw_only=True)
    components: tuple[str, str] | None = field(default=None, kw_only=True)
    direct_check: tuple[str, Mapping[str, float]] | None = field(default=None, kw_only=True)

    def null_values(self) -> dict[str, float]:
        """Parameter values at which the mechanism does nothing."""
        return {parameter.name: parameter.null for parameter in self.parameters}

    def tested_parameters(self) -> list[Parameter]:
        """Parameters that a test can find off their null: all but those of ``tested_at``."""
        set_ones = {name for values in self.tested_at for name in values}
        return [parameter for parameter in self.parameters if parameter.name not in set_ones]

    def acts(self, static: bool) -> bool:
        """Can it change a reading of friction at rest (``static``) or in motion?"""
        return True


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

    factor: Formula | None = field(default=None, kw_only=True)
    static_factor: Formula | None = field(default=None, kw_only=True)
    kinetic_factor: Formula | None = field(default=None, kw_only=True)
    added_force: Formula | None = field(default=None, kw_only=True)
    unrecorded: Mapping[str, float] = field(default_factory=dict, kw_only=True)

    @property
    def needs(self) -> frozenset[str]:
        """Quantities of the contact that the formulas ask for."""
        formulas = (self.factor, self.static_factor, self.kinetic_factor, self.added_force)
        own = {parameter.name for parameter in self.parameters}
        asked = {name for formula in formulas if formula for name in arguments_of(formula)}
        return frozenset(asked - own)

    def acts(self, static: bool) -> bool:
        return self.added_force is not None or bool(self.factors(static))

    def factors(self, static: bool) -> list[Formula]:
        """The formulas that scale the friction at rest (``static``) or in motion."""
        found = (self.factor, self.static_factor if static else self.kinetic_factor)
        return [formula for formula in found if formula is not None]

    def value(self, formula: Formula, values: Mapping[str, float], contact: Contact):
        """A formula of this mechanism at parameter values, for every contact."""
        arguments: list[Any] = []
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
