"""Every mechanism that a verdict can name, in the order of the documentation.

A further mechanism of the bench is one file like ``backlash.py`` and its name below; one
of the contact goes into :mod:`slipstitch.friction_law`.
"""

from types import MappingProxyType

from slipstitch.criticise.mechanism import (
    backlash,
    bending_error,
    camera_scale,
    force_gain,
    force_offset,
    mass_error,
    tilt,
    time_lag,
)
from slipstitch.friction_law import CONTACT_MECHANISMS, Mechanism

BENCH_MECHANISMS = MappingProxyType(
    {
        module.MECHANISM.identifier: module.MECHANISM
        for module in (
            tilt,
            mass_error,
            bending_error,
            backlash,
            camera_scale,
            force_offset,
            force_gain,
            time_lag,
        )
    }
)
MECHANISMS: MappingProxyType[str, Mechanism] = MappingProxyType(
    {**CONTACT_MECHANISMS, **BENCH_MECHANISMS}
)
# Named in the specification, but no candidates: air drag is 1e-4 of friction at 10 mm/s, and no
# protocol of this version holds a quantity that a permanent set would change on its own.
NEVER_BLAMED = ("bending_set", "air_drag")
