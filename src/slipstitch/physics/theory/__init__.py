"""Theoretical results for the cloth simulator: closed forms and elastica solutions.

Everything here is independent of the simulator's code: NumPy and SciPy only, no mesh, no contact
solver. The laws, their sources and the tests that check each are listed in ``docs/how/physics.md``.
"""

from slipstitch.physics.theory.cantilever import (
    HeavyCantilever,
    cantilever_rule_gamma,
    heavy_cantilever,
)
from slipstitch.physics.theory.drag import SteadyDrag, flexible_strip_drag, steady_strip_drag
from slipstitch.physics.theory.landed import LandedStrip, landed_strip, landed_strip_slip_strain
from slipstitch.physics.theory.lateral import lateral_buckling, lateral_buckling_of_beam
from slipstitch.physics.theory.rigid import Incline, capstan, flat_drag, incline
from slipstitch.physics.theory.strip import (
    StripState,
    strip_buckling_load,
    strip_slip_strain,
    strip_state,
    strip_state_at_foot_angle,
)

__all__ = [
    "HeavyCantilever",
    "Incline",
    "LandedStrip",
    "SteadyDrag",
    "StripState",
    "cantilever_rule_gamma",
    "capstan",
    "flat_drag",
    "flexible_strip_drag",
    "heavy_cantilever",
    "incline",
    "landed_strip",
    "landed_strip_slip_strain",
    "lateral_buckling",
    "lateral_buckling_of_beam",
    "steady_strip_drag",
    "strip_buckling_load",
    "strip_slip_strain",
    "strip_state",
    "strip_state_at_foot_angle",
]
