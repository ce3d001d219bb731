"""The friction law in Warp: the formulas of :mod:`slipstitch.physics.friction_law`, translated.

There is one source of each mechanism: a plain function that NumPy evaluates. Its syntax tree,
with NumPy's functions replaced by Warp's of the same meaning and every number made a float64, is
the Warp function that the contact of the cloth evaluates.
"""

from __future__ import annotations

import ast
import inspect
import linecache
import textwrap
from functools import cache

import warp as wp

from slipstitch.physics.friction_law import CONTACT_MECHANISMS
from slipstitch.physics.friction_law.contact import REFERENCE_PRESSURE_PA
from slipstitch.physics.friction_law.curve import CURVE_QUANTITIES, MOST_KNOTS
from slipstitch.physics.friction_law.mechanism import Formula, arguments_of
from slipstitch.physics.friction_law.mechanisms import LEAST_RATIO, SLOWEST_M_S

WARP_NAMES = {"maximum": "max", "minimum": "min"}  # the others are called the same
QUANTITIES = (
    "normal_force_N",
    "area_m2",
    "direction_rad",
    "dwell_s",
    "speed_m_s",
    "repeats",
    "relative_humidity_pct",
    "place_m",
)


class _Translation(ast.NodeTransformer):
    """One formula's source, from NumPy's names to Warp's."""

    def __init__(self, constants: dict):
        self.constants = constants

    def visit_Constant(self, node):
        return _number(node.value)

    def visit_Name(self, node):
        value = self.constants.get(node.id)
        return _number(value) if isinstance(value, int | float) else node

    def visit_Attribute(self, node):
        name = WARP_NAMES.get(node.attr, node.attr)
        return ast.parse(f"wp.{name}", mode="eval").body


def _number(value: float) -> ast.expr:
    return ast.parse(f"wp.float64({float(value)!r})", mode="eval").body


def translated(formula: Formula, name: str) -> str:
    """Source of the Warp function ``name`` that computes what a formula computes."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(formula)))
    result = next(line for line in tree.body[0].body if isinstance(line, ast.Return))
    value = ast.unparse(_Translation(formula.__globals__).visit(result.value))
    arguments = ", ".join(f"{one}: wp.float64" for one in arguments_of(formula))
    return f"def {name}({arguments}) -> wp.float64:\n    return {value}\n"


def _law_source() -> tuple[dict[str, str], str]:
    """Sources of the formulas by name, and of the law that calls them in turn.

    The same order as in :meth:`slipstitch.physics.friction_law.FrictionLaw.force_limit`.
    """
    formulas: dict[str, str] = {}
    place = {}
    for mechanism in CONTACT_MECHANISMS.values():
        for parameter in mechanism.parameters:
            place[parameter.name] = f"values[{len(place)}]"

    def call(mechanism, kind) -> str:
        formula = getattr(mechanism, kind)
        name = f"{mechanism.identifier}_{kind}"
        formulas[name] = translated(formula, name)
        return f"{name}({', '.join(place.get(one, one) for one in arguments_of(formula))})"

    body = []
    for mechanism in CONTACT_MECHANISMS.values():
        if mechanism.factor:
            body.append(f"    force = force * {call(mechanism, 'factor')}")
        for kind, condition in (("static_factor", "at_rest"), ("kinetic_factor", "not at_rest")):
            if getattr(mechanism, kind):
                body += [f"    if {condition}:", f"        force = force * {call(mechanism, kind)}"]
        if mechanism.added_force:
            body.append(f"    added = added + {call(mechanism, 'added_force')}")
    body.append(
        f"    force = force * curve_factor(values, {len(place)}, at_rest, speed_m_s, load_ratio,"
        " place_m)"
    )
    arguments = ", ".join(f"{one}: wp.float64" for one in QUANTITIES)
    head = [
        "def force_limit(coefficient: wp.float64, values: wp.array(dtype=wp.float64),"
        f" at_rest: bool, {arguments}) -> wp.float64:",
        f"    load_ratio = normal_force_N / area_m2 / wp.float64({REFERENCE_PRESSURE_PA!r})",
        "    force = coefficient * normal_force_N",
        "    added = wp.float64(0.0)",
    ]
    tail = ["    return wp.max(force + added, wp.float64(0.0))", ""]
    return formulas, "\n".join(head + body + tail)


SPEED, LOAD, _ = (wp.constant(k + 1) for k in range(len(CURVE_QUANTITIES)))
KNOTS = wp.constant(MOST_KNOTS)
SLOWEST, LEAST = wp.constant(wp.float64(SLOWEST_M_S)), wp.constant(wp.float64(LEAST_RATIO))


@wp.func
def curve_factor(
    values: wp.array(dtype=wp.float64),  # type: ignore[valid-type]
    first: int,
    at_rest: bool,
    speed_m_s: wp.float64,
    load_ratio: wp.float64,
    place_m: wp.float64,
) -> wp.float64:
    """:meth:`slipstitch.physics.friction_law.Curve.factor`; its values stand from ``first``."""
    quantity = int(values[first])
    if quantity == 0 or (quantity == SPEED and at_rest):
        return wp.float64(1.0)
    x = place_m
    if quantity == SPEED:
        x = wp.log(wp.max(speed_m_s, SLOWEST))
    if quantity == LOAD:
        x = wp.log(wp.max(load_ratio, LEAST))
    logs = first + 1 + KNOTS
    result = values[logs]
    for k in range(KNOTS - 1):
        low = values[first + 1 + k]
        width = values[first + 2 + k] - low
        if width > wp.float64(0.0) and x > low:
            share = wp.min((x - low) / width, wp.float64(1.0))
            result = values[logs + k] + share * (values[logs + k + 1] - values[logs + k])
    return wp.exp(result)


def _compiled(name: str, source: str, namespace: dict) -> wp.Function:
    """Make a Warp function of a source text (Warp reads it back through ``linecache``)."""
    file = f"<friction law: {name}>"
    linecache.cache[file] = (len(source), None, source.splitlines(True), file)
    exec(compile(source, file, "exec"), namespace)  # our own text, made above
    return wp.func(namespace[name])


@cache
def force_limit() -> wp.Function:
    """The whole law as one Warp function.

    Its arguments are the coefficient, the parameters of every mechanism
    (:meth:`FrictionLaw.parameter_values`), whether the contact is at rest, then ``QUANTITIES``.
    """
    formulas, law = _law_source()
    namespace = {"wp": wp, "__name__": __name__, "curve_factor": curve_factor}
    for name, source in formulas.items():
        namespace[name] = _compiled(name, source, namespace)
    return _compiled("force_limit", law, namespace)
