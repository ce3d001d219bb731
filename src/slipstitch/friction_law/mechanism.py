"""What every extension of the model has: a name, parameters, and what it needs to know."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from slipstitch.friction_law.contact import Contact


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


class ContactMechanism(Mechanism):
    """A mechanism of the contact: it scales the friction force, or adds to it."""

    def factor(
        self, values: Mapping[str, float], contact: Contact, static: bool
    ) -> np.ndarray | float:
        """Factor on the Coulomb force, 1 where the mechanism is silent."""
        return 1.0

    def added_force(
        self, values: Mapping[str, float], contact: Contact, static: bool
    ) -> np.ndarray | float:
        """Force beside the Coulomb force, in newtons."""
        return 0.0


def recorded(value, otherwise: float) -> np.ndarray:
    """``value`` with every NaN (not recorded) replaced by what makes a factor of one."""
    array = np.asarray(value, dtype=float)
    return np.where(np.isnan(array), otherwise, array)
