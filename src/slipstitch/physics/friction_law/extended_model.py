"""The extended model of a verdict, as read by the simulations."""

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import sin, sqrt
from typing import Any

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import read_yaml
from slipstitch.physics.friction_law import Curve, FrictionLaw

# Departures of the bench that change how the cloth moves; the others change readings only.
ACTING = ("mass_error", "bending_error", "tilt_along_rad", "tilt_across_rad")
# Covariate of a discrepancy -> quantity of the contact and factor to SI. Nothing simulated has a
# time in the session: a factor along it is left out.
CURVES: Mapping[str, tuple[str, float] | None] = {
    "speed_mm_s": ("speed_m_s", 1e-3),
    "load_ratio": ("load_ratio", 1.0),
    "pos_x_mm": ("place_m", 1e-3),
    "clock_min": None,
}


@dataclass(frozen=True)
class ExtendedModel:
    """A friction law, and how fabric and floor differ from what they are taken for."""

    law: FrictionLaw  # of the cloth's face
    mass_error: float = 0.0  # true = nominal x (1 + error)
    bending_error: float = 0.0
    # Slope of the floor towards lab azimuth 0 and 90 degrees, positive where it falls that way.
    tilt_along_rad: float = 0.0
    tilt_across_rad: float = 0.0
    readings: Mapping[str, float] = field(default_factory=dict)  # departures of the instruments

    def law_at(self, friction: float) -> FrictionLaw:
        """The law's mechanisms and curve on another friction coefficient."""
        return replace(self.law, coefficient=friction)

    def gravity_m_s2(self, standard_m_s2: float) -> tuple[float, float, float]:
        """Gravity as the floor sees it, the stage's +x at lab azimuth 0."""
        along, across = sin(self.tilt_along_rad), sin(self.tilt_across_rad)
        down = sqrt(1.0 - along**2 - across**2)
        return standard_m_s2 * along, standard_m_s2 * across, -standard_m_s2 * down


def read_extended_model(path: str | os.PathLike) -> ExtendedModel:
    """Read the file that ``slipstitch criticise --model`` writes."""
    return model_of(read_yaml(path), str(path))


def model_of(data: Any, source: str = "extended model") -> ExtendedModel:
    """The model that plain data state; ``source`` is named in errors."""
    laws = data.get("friction_law") if isinstance(data, dict) else None
    if not isinstance(laws, dict) or "face" not in laws:
        raise BadInput(
            f"{source}: friction_law.face: missing; must be a file written by slipstitch "
            "criticise --model"
        )
    given = data.get("bench") or {}
    try:
        law = FrictionLaw.from_dict(laws["face"])
        if data.get("discrepancy") is not None:
            law = replace(law, curve=curve_of(data["discrepancy"], source))
        bench = {str(name): float(value) for name, value in given.items()}
        numbers = [law.coefficient, *law.parameter_values(), *bench.values()]
        if not all(math.isfinite(number) for number in numbers) or law.coefficient < 0:
            raise ValueError("every value must be a finite number, the coefficient at least 0")
    except (TypeError, ValueError, KeyError, AttributeError) as error:
        raise BadInput(f"{source}: not an extended model ({error})") from None
    for name in ("mass_error", "bending_error"):
        if bench.get(name, 0.0) <= -1.0:
            raise BadInput(f"{source}: bench.{name} {bench[name]:g}: must be above -1")
    along, across = (bench.get(name, 0.0) for name in ("tilt_along_rad", "tilt_across_rad"))
    if abs(along) + abs(across) >= math.pi / 2:  # sin^2 + sin^2 >= 1: nothing points down
        raise BadInput(
            f"{source}: bench.tilt_along_rad {along:g} and tilt_across_rad {across:g}: their sizes "
            "must add up to less than pi/2, where the floor is upright"
        )
    acting = {name: value for name, value in bench.items() if name in ACTING}
    readings = {name: value for name, value in bench.items() if name not in ACTING}
    return ExtendedModel(law, **acting, readings=readings)


def curve_of(table: Any, source: str) -> Curve | None:
    """The table of a smooth factor on the coefficient, in SI units; None if by time."""
    if not isinstance(table, dict) or not {"covariate", "knots", "factors"} <= set(table):
        raise BadInput(f"{source}: discrepancy: must have covariate, knots and factors")
    name = table["covariate"]
    if name not in CURVES:
        raise BadInput(f"{source}: discrepancy.covariate: '{name}' is none of {', '.join(CURVES)}")
    quantity, to_si = CURVES[name] or ("place_m", 1.0)
    try:
        knots = tuple(to_si * float(knot) for knot in table["knots"])
        curve = Curve(quantity, knots, tuple(float(factor) for factor in table["factors"]))
    except (TypeError, ValueError):
        raise BadInput(f"{source}: discrepancy: knots and factors must be numbers") from None
    except BadInput as error:
        raise BadInput(f"{source}: discrepancy: {str(error).removeprefix('curve: ')}") from None
    return curve if CURVES[name] else None
