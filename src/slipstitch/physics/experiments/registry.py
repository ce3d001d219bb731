"""The experiments by name, and running one with validated options."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from inspect import signature
from math import inf
from typing import Any

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import provenance_record, start_clock, write_json
from slipstitch.config.section import FRICTION_MAX
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics.experiments import (
    cantilever,
    capstan,
    landed_strip,
    lateral_buckling,
    plane,
    strip,
    strip_drag,
)
from slipstitch.physics.experiments.specimen import Demand, require


@dataclass(frozen=True)
class KnownAnswer:
    """An experiment, what it must meet, and the bounds of its options (else 0 and infinity).

    Its options are the arguments of the function after the settings.
    """

    run: Callable[..., dict[str, Any]]
    demands: tuple[Demand, ...]
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def verdict(self, result: Mapping[str, Any]) -> dict[str, Any]:
        """``passed``, and ``demands``: the verdict on each (`Demand.verdict`), by key."""
        rows = {demand.key: demand.verdict(result) for demand in self.demands}
        return {"passed": all(row["met"] for row in rows.values()), "demands": rows}


PROTOCOLS: dict[str, KnownAnswer] = {
    "incline": KnownAnswer(plane.incline, plane.INCLINE_DEMANDS, {"slope_deg": (0, 89.99)}),
    "tilt": KnownAnswer(plane.tilt, plane.TILT_DEMANDS),
    "flat-drag": KnownAnswer(plane.flat_drag, plane.FLAT_DRAG_DEMANDS),
    "strip-drag": KnownAnswer(strip_drag.strip_drag, strip_drag.DEMANDS, strip_drag.BOUNDS),
    "strip": KnownAnswer(strip.strip, strip.DEMANDS, strip.BOUNDS),
    "landed-strip": KnownAnswer(
        landed_strip.landed_strip, landed_strip.DEMANDS, landed_strip.BOUNDS
    ),
    "cantilever": KnownAnswer(cantilever.cantilever, cantilever.DEMANDS, cantilever.BOUNDS),
    "lateral-buckling": KnownAnswer(
        lateral_buckling.lateral_buckling, lateral_buckling.DEMANDS, lateral_buckling.BOUNDS
    ),
    "capstan": KnownAnswer(capstan.capstan, capstan.DEMANDS, capstan.BOUNDS),
}


def run_protocol(
    name: str, options: Mapping[str, float], settings: SimulationSettings | None = None
) -> dict[str, Any]:
    """Run one experiment, a key of `PROTOCOLS`, with options by name.

    BadInput if experiment or option is unknown, an option is missing, or a value out of range.
    """
    if name not in PROTOCOLS:
        raise BadInput(f"unknown protocol {name!r}; allowed: {', '.join(PROTOCOLS)}")
    protocol = PROTOCOLS[name]
    _, *known = signature(protocol.run).parameters.values()
    unknown = set(options) - {one.name for one in known}
    if unknown:
        allowed = ", ".join(one.name for one in known)
        raise BadInput(f"protocol {name}: unknown option {min(unknown)!r}; allowed: {allowed}")
    bounds = {"friction": (0.0, FRICTION_MAX), **protocol.bounds}
    values = {}
    for option in known:
        value = options.get(option.name, option.default)
        if value is option.empty:
            raise BadInput(f"protocol {name}: {option.name} is missing")
        lowest, highest = bounds.get(option.name, (0.0, inf))
        values[option.name] = require(f"protocol {name}: {option.name}", value, lowest, highest)
    return protocol.run(settings or SimulationSettings(), **values)


def run_protocol_to_file(
    name: str, options: Mapping[str, float], settings: SimulationSettings, out: str | os.PathLike
) -> dict[str, Any]:
    """Run one experiment and write its result as JSON, with its provenance beside it."""
    started = start_clock()
    result = run_protocol(name, options, settings)
    result |= PROTOCOLS[name].verdict(result)
    config = {"options": dict(options), "simulation": settings}
    record = provenance_record("protocol", config=config, started=started)
    write_json(out, result, record, allow_nan=True)
    return result
