"""The state of a contact, and the mechanisms that act on its friction.

Protocols and fits evaluate the formulas of `CONTACT_MECHANISMS` with NumPy; the cloth simulator has
the same in Warp (:mod:`slipstitch.physics.cloth.friction`), and a test holds both together.
"""

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cache
from inspect import signature
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

REFERENCE_PRESSURE_PA = 50.0
REFERENCE_EDGE_FORCE_N = 2.0e-3
REFERENCE_DWELL_S = 1.0
REFERENCE_SPEED_M_S = 0.010
REFERENCE_HUMIDITY_PCT = 50.0
LEAST_RATIO = 1.0e-9  # of the load to the reference: below, the power is cut off
# Below, the logarithm is cut off: a node's elastic microslip over a time step is of this size.
SLOWEST_M_S = 1.0e-5

Formula = Callable[..., float | np.ndarray]


@dataclass(frozen=True)
class Contact:
    """State of one contact or an array of contacts; all fields broadcast together.

    A NaN means *not recorded*: a mechanism that needs it then leaves the friction as it is.
    """

    normal_force_N: ArrayLike  # forces per width with areas per width do as well
    area_m2: ArrayLike = 1.0  # apparent
    direction_rad: ArrayLike = 0.0  # from the warp to the sliding: pi/2 along the weft
    dwell_s: ArrayLike = np.nan  # rest in contact before the pull
    speed_m_s: ArrayLike = np.nan  # of sliding
    repeats: ArrayLike = 0.0  # slides that this place has made before, from 0
    relative_humidity_pct: ArrayLike = np.nan  # of the air
    place_m: ArrayLike = np.nan  # on the substrate, along the track
    edge: bool = False  # the contact is the edge of a sheet (strip), not its face

    def with_load(self, normal_force_N: ArrayLike, area_m2: ArrayLike | None = None) -> "Contact":
        """The same contact under another load (and on another area, if given)."""
        area = self.area_m2 if area_m2 is None else area_m2
        return replace(self, normal_force_N=normal_force_N, area_m2=area)

    def load_ratio(self) -> np.ndarray:
        """Load over the reference: pressure / 50 Pa for a face, force / 2 mN for an edge."""
        if self.edge:
            return np.asarray(self.normal_force_N) / REFERENCE_EDGE_FORCE_N
        return np.asarray(self.normal_force_N) / np.asarray(self.area_m2) / REFERENCE_PRESSURE_PA

    def quantity(self, name: str) -> np.ndarray:
        """A field, or ``load_ratio``, as a formula asks for it by the name of its argument."""
        if name == "load_ratio":
            return self.load_ratio()
        return np.asarray(getattr(self, name), dtype=float)


@dataclass(frozen=True)
class Parameter:
    """One number of a mechanism; the null value is the one at which the mechanism is absent."""

    name: str
    unit: str
    null: float
    scale: float  # size of a change that matters; finite differences and priors use it
    lower: float  # bounds of a fit
    upper: float
    kinked: bool = False  # the readings have a kink at the null: either side has its own descent
    prior_sd: float | None = None  # about the null; None: thirty scales
    relative: bool = False  # true = nominal (1 + parameter); interval symmetric in the logarithm
    coefficient: bool = False  # a friction coefficient, fitted as its natural logarithm

    @property
    def prior_width(self) -> float:
        """Standard deviation of the weak prior of a fit."""
        return 30 * self.scale if self.prior_sd is None else self.prior_sd


@dataclass(frozen=True)
class Mechanism:
    """A departure from plain Coulomb friction, or from the nominal bench or fabric."""

    identifier: str  # name in verdicts
    title: str  # what is said after "the model is wrong because"
    parameters: tuple[Parameter, ...]
    _: KW_ONLY
    # Column of a feature that drives it; None if it acts alike everywhere. Where the column is
    # empty, the mechanism may not be blamed.
    covariate: str | None = None
    # Mechanism that would do the same where that one's covariate was not recorded.
    aliased_if_unrecorded: str | None = None
    # Values of parameters that mean nothing at the null (an onset, a place), at each of which the
    # others are tested.
    tested_at: tuple[Mapping[str, float], ...] = ()
    starts: tuple[Mapping[str, float], ...] = ()  # of a fit; without any, at the null
    # Names under which two parameters, components of a vector along 0 and 90 degrees, are reported:
    # its size and its direction.
    components: tuple[str, str] | None = None
    # A measurement of the mechanism itself, and the standard deviation to which it tells each
    # parameter.
    direct_check: tuple[str, Mapping[str, float]] | None = None

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

    The arguments of a formula are named after parameters and quantities of :class:`Contact`.
    """

    _: KW_ONLY
    factor: Formula | None = None  # on the Coulomb force, always
    static_factor: Formula | None = None  # at rest only
    kinetic_factor: Formula | None = None  # in motion only
    added_force: Formula | None = None  # beside it, in N
    # Quantity -> what stands in for it where it was not recorded: a value at which the formula does
    # nothing.
    unrecorded: Mapping[str, float] = field(default_factory=dict)

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


_ENTRIES = (
    ContactMechanism(
        "load_power",
        "friction grows less (or more) than in proportion to the load",
        (Parameter("load_power", "1", 0.0, 0.05, -0.9, 0.9),),
        covariate="load_ratio",
        # (p / p0)^m, p0 = 50 Pa; at an edge (N / 2 mN)^m (Howell; Bowden and Young: n = 1 + m).
        factor=lambda load_power, load_ratio: np.maximum(load_ratio, LEAST_RATIO) ** load_power,
    ),
    ContactMechanism(
        "adhesion",
        "part of the friction grows with the area, not the load",
        (Parameter("adhesion", "Pa", 0.0, 1.0, -30.0, 200.0),),
        covariate="load_ratio",
        # A shear stress times the apparent area, at no load (Bowden and Tabor).
        added_force=lambda adhesion, area_m2: adhesion * area_m2,
    ),
    ContactMechanism(
        "static_kinetic",
        "static friction exceeds kinetic friction",
        (Parameter("static_kinetic", "1", 0.0, 0.1, 0.0, 3.0, kinked=True),),
        # Whether an excess at rest grows with the rest cannot be told without the rests.
        aliased_if_unrecorded="ageing",
        static_factor=lambda static_kinetic: 1.0 + static_kinetic,
    ),
    ContactMechanism(
        "ageing",
        "static friction grows with the rest time before the pull",
        (Parameter("ageing", "1/decade", 0.0, 0.05, 0.0, 2.0, kinked=True),),
        covariate="dwell_s",
        # Dieterich.
        static_factor=lambda ageing, dwell_s: (
            1.0 + ageing * np.log10(1.0 + dwell_s / REFERENCE_DWELL_S)
        ),
        unrecorded={"dwell_s": 0.0},
    ),
    ContactMechanism(
        "rate",
        "kinetic friction changes with the sliding speed",
        (Parameter("rate", "1/decade", 0.0, 0.05, -0.9, 0.9, kinked=True),),
        covariate="speed_mm_s",
        kinetic_factor=lambda rate, speed_m_s: (
            1.0 + rate * np.log10(np.maximum(speed_m_s, SLOWEST_M_S) / REFERENCE_SPEED_M_S)
        ),
        unrecorded={"speed_m_s": REFERENCE_SPEED_M_S},
    ),
    ContactMechanism(
        "anisotropy",
        "friction along the warp differs from friction along the weft",
        (Parameter("anisotropy", "1", 0.0, 0.05, -0.9, 0.9),),
        covariate="orientation_deg",
        # The same forth and back.
        factor=lambda anisotropy, direction_rad: 1.0 + anisotropy * np.cos(2.0 * direction_rad),
        unrecorded={"direction_rad": np.pi / 4},
    ),
    ContactMechanism(
        "nap",
        "friction with the nap differs from friction against it",
        (Parameter("nap", "1", 0.0, 0.05, -0.9, 0.9),),
        covariate="orientation_deg",
        # Sliding back has the other sign.
        factor=lambda nap, direction_rad: 1.0 + nap * np.cos(direction_rad),
        unrecorded={"direction_rad": np.pi / 2},
    ),
    ContactMechanism(
        "wear",
        "friction changes with the number of slides of a specimen",
        (
            Parameter("wear", "1", 0.0, 0.1, -0.9, 3.0),
            Parameter("wear_r0", "slides", 3.0, 2.0, 0.3, 40.0, prior_sd=4.0),
        ),
        covariate="repeat_index",
        tested_at=({"wear_r0": 1.0}, {"wear_r0": 2.5}, {"wear_r0": 6.0}),
        starts=({"wear": 0.02, "wear_r0": 1.5}, {"wear": 0.02, "wear_r0": 5.0}),
        factor=lambda wear, wear_r0, repeats: 1.0 + wear * (1.0 - np.exp(-repeats / wear_r0)),
        unrecorded={"repeats": 0.0},
    ),
    ContactMechanism(
        "humidity",
        "friction changes with the humidity of the air",
        (Parameter("humidity", "1 per 10 % RH", 0.0, 0.05, -0.15, 0.15),),
        covariate="rh_pct",
        factor=lambda humidity, relative_humidity_pct: (
            1.0 + humidity * (relative_humidity_pct - REFERENCE_HUMIDITY_PCT) / 10.0
        ),
        unrecorded={"relative_humidity_pct": REFERENCE_HUMIDITY_PCT},
    ),
)
CONTACT_MECHANISMS: Mapping[str, ContactMechanism] = MappingProxyType(
    {mechanism.identifier: mechanism for mechanism in _ENTRIES}
)
