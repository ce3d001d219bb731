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
from slipstitch.physics.experiments import (
    cantilever,
    capstan,
    landed_strip,
    lateral_buckling,
    plane,
    strip,
    strip_drag,
)
from slipstitch.physics.experiments.specimen import Demand


@dataclass(frozen=True)
class KnownAnswer:
    """An experiment, what it must meet, its options: name to default (None: required)."""

    run: Callable[..., dict[str, Any]]
    demands: tuple[Demand, ...]
    options: Mapping[str, float | None]

    def verdict(self, result: Mapping[str, Any]) -> dict[str, Any]:
        """``passed``, and ``demands``: the verdict on each (`Demand.verdict`), by key."""
        rows = {demand.key: demand.verdict(result) for demand in self.demands}
        return {"passed": all(row["met"] for row in rows.values()), "demands": rows}


PROTOCOLS: dict[str, KnownAnswer] = {
    "incline": KnownAnswer(
        plane.incline, plane.INCLINE_DEMANDS, {"friction": None, "slope_deg": None}
    ),
    "tilt": KnownAnswer(plane.tilt, plane.TILT_DEMANDS, {"friction": None, "static_kinetic": 0.0}),
    "flat-drag": KnownAnswer(plane.flat_drag, plane.FLAT_DRAG_DEMANDS, {"friction": None}),
    "strip-drag": KnownAnswer(
        strip_drag.strip_drag, strip_drag.DEMANDS, {"friction": None, "gravity_length_m": 0.02}
    ),
    "strip": KnownAnswer(
        strip.strip,
        strip.DEMANDS,
        {"friction": None, "vertices": 149, "gamma": 0.0, "strain": strip.LARGEST_STRAIN},
    ),
    "landed-strip": KnownAnswer(
        landed_strip.landed_strip,
        landed_strip.DEMANDS,
        {"friction": None, "gravity_length_m": 0.02, "vertices": 149},
    ),
    "cantilever": KnownAnswer(cantilever.cantilever, cantilever.DEMANDS, {"gamma": None}),
    "lateral-buckling": KnownAnswer(
        lateral_buckling.lateral_buckling, lateral_buckling.DEMANDS, {"width_over_length": None}
    ),
    "capstan": KnownAnswer(capstan.capstan, capstan.DEMANDS, {"friction": None, "wrap_deg": None}),
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
    for option, default in protocol.options.items():
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
    result |= PROTOCOLS[name].verdict(result)
    config = {"options": dict(options), "simulation": settings}
    record = provenance_record("protocol", config=config, started=started)
    write_json(out, result, record, allow_nan=True)
    return result
