"""The experiments by name, and running one with validated options."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import provenance_record, start_clock, write_json
from slipstitch.config.section import FRICTION_MAX
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics.experiments.cantilever import cantilever
from slipstitch.physics.experiments.capstan import capstan
from slipstitch.physics.experiments.demands import verdict
from slipstitch.physics.experiments.flat_drag import flat_drag
from slipstitch.physics.experiments.incline import incline
from slipstitch.physics.experiments.landed_strip import landed_strip
from slipstitch.physics.experiments.lateral_buckling import lateral_buckling
from slipstitch.physics.experiments.strip import LARGEST_STRAIN, strip
from slipstitch.physics.experiments.strip_drag import strip_drag
from slipstitch.physics.experiments.tilt import tilt


@dataclass(frozen=True)
class KnownAnswer:
    """An experiment and its options: name to (default, meaning); default None: required."""

    run: Callable[..., dict[str, Any]]
    options: Mapping[str, tuple[float | None, str]]


_FRICTION = (None, "friction coefficient")
_GRAVITY_LENGTH = (0.02, "(B/w)^(1/3): bending rigidity over weight per area, in m")
PROTOCOLS: dict[str, KnownAnswer] = {
    "incline": KnownAnswer(
        incline, {"friction": _FRICTION, "slope_deg": (None, "slope in degrees")}
    ),
    "tilt": KnownAnswer(
        tilt,
        {
            "friction": (None, "kinetic friction coefficient"),
            "static_kinetic": (0.0, "static coefficient over the kinetic, less 1"),
        },
    ),
    "flat-drag": KnownAnswer(flat_drag, {"friction": _FRICTION}),
    "strip-drag": KnownAnswer(
        strip_drag, {"friction": _FRICTION, "gravity_length_m": _GRAVITY_LENGTH}
    ),
    "strip": KnownAnswer(
        strip,
        {
            "friction": _FRICTION,
            "vertices": (149, "vertices along the strip"),
            "gamma": (0.0, "weight over rigidity, areal density x gravity x length^3 / B"),
            "strain": (LARGEST_STRAIN, "displacement of the push, relative to its length"),
        },
    ),
    "landed-strip": KnownAnswer(
        landed_strip,
        {
            "friction": _FRICTION,
            "gravity_length_m": _GRAVITY_LENGTH,
            "vertices": (149, "vertices along the strip"),
        },
    ),
    "cantilever": KnownAnswer(
        cantilever, {"gamma": (None, "areal density x gravity x length^3 / B")}
    ),
    "lateral-buckling": KnownAnswer(
        lateral_buckling, {"width_over_length": (None, "width of the strip over its length")}
    ),
    "capstan": KnownAnswer(
        capstan, {"friction": _FRICTION, "wrap_deg": (None, "contact angle in degrees")}
    ),
}


def run_protocol(
    name: str, options: Mapping[str, float], settings: SimulationSettings | None = None
) -> dict[str, Any]:
    """Run one experiment.

    Parameters
    ----------
    name : str
        A key of ``PROTOCOLS``.
    options : mapping
        Its options, by name.
    settings : SimulationSettings, optional
        Numerical settings (time step, tolerance, damping ...).

    Raises
    ------
    BadInput
        Unknown experiment or option, a missing one, or a value out of range.
    NotConverged
        The solver did not converge.
    """
    if name not in PROTOCOLS:
        raise BadInput(f"unknown protocol {name!r}; allowed: {', '.join(PROTOCOLS)}")
    protocol = PROTOCOLS[name]
    unknown = set(options) - set(protocol.options)
    if unknown:
        raise BadInput(
            f"protocol {name}: unknown option {min(unknown)!r}; "
            f"allowed: {', '.join(protocol.options)}"
        )
    values = {}
    for option, (default, _) in protocol.options.items():
        value = options.get(option, default)
        if value is None:
            raise BadInput(f"protocol {name}: {option} is missing")
        if not isfinite(value) or value < 0:
            raise BadInput(f"protocol {name}: {option} {value}: must be finite and at least 0")
        if option == "friction" and value > FRICTION_MAX:
            raise BadInput(f"protocol {name}: {option} {value}: must be at most {FRICTION_MAX:g}")
        values[option] = float(value)
    return protocol.run(settings or SimulationSettings(), **values)


def run_protocol_to_file(
    name: str, options: Mapping[str, float], settings: SimulationSettings, out: str | os.PathLike
) -> dict[str, Any]:
    """Run one experiment and write its result as JSON, with its provenance beside it.

    Parameters and errors as for `run_protocol`.
    """
    started = start_clock()
    result = run_protocol(name, options, settings)
    result |= verdict(name, result)
    config = {"options": dict(options), "simulation": settings}
    record = provenance_record("protocol", config=config, started=started)
    write_json(out, result, record, allow_nan=True)
    return result
