"""Dry friction as Warp functions: the law, and return mapping for floor and layers alike.

The law is that of :mod:`slipstitch.physics.friction_law`: the same formulas in the same order as in
:meth:`FrictionLaw.force_limit`, at the parameters of every mechanism in the order of
:meth:`FrictionLaw.parameter_values`. A test holds both against each other, mechanism by mechanism.

A contact hangs on what it remembers by a stiff tangential spring. While the spring's force is
below the friction law's limit the memory stays (stick); at the limit the force is the limit,
along the spring, and the memory is dragged after (slip). Simo and Hughes, Computational
Inelasticity (1998), ch. 1; Wriggers, Computational Contact Mechanics (2006).
"""

from typing import Any

import warp as wp

from slipstitch.physics.friction_law import CONTACT_MECHANISMS, mechanisms
from slipstitch.physics.friction_law.law import CURVE_QUANTITIES, MOST_KNOTS

wp.set_module_options({"enable_backward": False})

# Places of the parameters among the law's values; the curve's begin after the last one.
_NAMES = [one.name for each in CONTACT_MECHANISMS.values() for one in each.parameters]
LOAD_POWER, ADHESION, STATIC_KINETIC, AGEING, RATE, ANISOTROPY, NAP, WEAR, WEAR_R0, HUMIDITY = (
    wp.constant(_NAMES.index(name))
    for name in (
        *("load_power", "adhesion", "static_kinetic", "ageing", "rate"),
        *("anisotropy", "nap", "wear", "wear_r0", "humidity"),
    )
)
CURVE = wp.constant(len(_NAMES))
CURVE_SPEED, CURVE_LOAD, _ = (wp.constant(k + 1) for k in range(len(CURVE_QUANTITIES)))
KNOTS = wp.constant(MOST_KNOTS)
ZERO, ONE = wp.constant(wp.float64(0.0)), wp.constant(wp.float64(1.0))
TWO, TEN = wp.constant(wp.float64(2.0)), wp.constant(wp.float64(10.0))
SLOWEST = wp.constant(wp.float64(mechanisms.SLOWEST_M_S))
LEAST = wp.constant(wp.float64(mechanisms.LEAST_RATIO))
PRESSURE_PA = wp.constant(wp.float64(mechanisms.REFERENCE_PRESSURE_PA))
DWELL_S = wp.constant(wp.float64(mechanisms.REFERENCE_DWELL_S))
SPEED_M_S = wp.constant(wp.float64(mechanisms.REFERENCE_SPEED_M_S))
HUMIDITY_PCT = wp.constant(wp.float64(mechanisms.REFERENCE_HUMIDITY_PCT))


@wp.struct
class ContactState:
    """State of one contact, see :class:`slipstitch.physics.friction_law.Contact`."""

    normal_force_N: wp.float64
    area_m2: wp.float64
    direction_rad: wp.float64
    dwell_s: wp.float64
    speed_m_s: wp.float64
    repeats: wp.float64
    relative_humidity_pct: wp.float64
    place_m: wp.float64


@wp.func
def curve_factor(
    values: wp.array(dtype=wp.float64), at_rest: bool, load_ratio: wp.float64, contact: ContactState
) -> wp.float64:
    """:meth:`slipstitch.physics.friction_law.Curve.factor`."""
    quantity = int(values[CURVE])
    if quantity == 0 or (quantity == CURVE_SPEED and at_rest):
        return ONE
    x = contact.place_m
    if quantity == CURVE_SPEED:
        x = wp.log(wp.max(contact.speed_m_s, SLOWEST))
    if quantity == CURVE_LOAD:
        x = wp.log(wp.max(load_ratio, LEAST))
    knots = CURVE + 1
    logs = knots + KNOTS
    result = values[logs]
    for k in range(KNOTS - 1):
        low = values[knots + k]
        width = values[knots + 1 + k] - low
        if width > ZERO and x > low:
            share = wp.min((x - low) / width, ONE)
            result = values[logs + k] + share * (values[logs + k + 1] - values[logs + k])
    return wp.exp(result)


@wp.func
def force_limit(
    coefficient: wp.float64,
    values: wp.array(dtype=wp.float64),
    at_rest: bool,
    contact: ContactState,
) -> wp.float64:
    """Friction force (N) at which a contact at rest slips, or with which another one slides."""
    load_ratio = contact.normal_force_N / contact.area_m2 / PRESSURE_PA
    force = coefficient * contact.normal_force_N
    force = force * wp.max(load_ratio, LEAST) ** values[LOAD_POWER]
    added = values[ADHESION] * contact.area_m2
    if at_rest:
        force = force * (ONE + values[STATIC_KINETIC])
        force = force * (ONE + values[AGEING] * wp.log10(ONE + contact.dwell_s / DWELL_S))
    if not at_rest:
        speed_ratio = wp.max(contact.speed_m_s, SLOWEST) / SPEED_M_S
        force = force * (ONE + values[RATE] * wp.log10(speed_ratio))
    force = force * (ONE + values[ANISOTROPY] * wp.cos(TWO * contact.direction_rad))
    force = force * (ONE + values[NAP] * wp.cos(contact.direction_rad))
    force = force * (ONE + values[WEAR] * (ONE - wp.exp(-contact.repeats / values[WEAR_R0])))
    humid = contact.relative_humidity_pct - HUMIDITY_PCT
    force = force * (ONE + values[HUMIDITY] * humid / TEN)
    force = force * curve_factor(values, at_rest, load_ratio, contact)
    return wp.max(force + added, ZERO)


@wp.func
def returned_force(force: Any, limit: wp.float64):
    """Force of the spring (N), cut to the limit."""
    size = wp.length(force)
    if size > limit:
        force = force * (limit / size)
    return force


@wp.func
def kept_pull(pull_m: wp.float64, stiffness: wp.float64, limit: wp.float64) -> wp.float64:
    """Part of the spring's length that is left once the memory has been dragged after."""
    reach = limit / stiffness
    if pull_m > reach:
        return reach / pull_m
    return ONE


@wp.func
def returned_stiffness(
    pull_m: wp.float64,
    surface: wp.mat33d,
    sideways: wp.mat33d,
    stiffness: wp.float64,
    limit: wp.float64,
) -> wp.mat33d:
    """Symmetric part of the tangent (N/m): how the limit follows the load is left out.

    Projectors lead to the surface, and to its direction across the spring.
    """
    if pull_m * stiffness <= limit:
        return surface * stiffness
    return sideways * (limit / pull_m)
