"""Choice among the settings tried."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from slipstitch.base.errors import SlipstitchError
from slipstitch.config.calibrate import BASE

# Looser values than the configured ones are tried and shown, but never chosen: the strip does not
# tell what they do to the cloth (docs/how/physics.md). The strip's own mesh is not the cloth's.
NEVER_LOOSER = ("time_step_s", "friction_tolerance", "damping_s")
FREE = ("newton_iterations_max",)

# Largest errors of the strain at slip, and of the friction coefficient inferred from that strain.
STRIP_SLIP_STRAIN = 6e-3
STRIP_FRICTION = 5e-3

Trial = dict[str, Any]


class DemandNotMet(SlipstitchError):  # noqa: N818 - says what happened, as the other errors do
    """The simulator deviates from theory by more than the tolerances; exit code 1."""


def judge(trial: Mapping[str, Any]) -> Trial:
    """Sum up the runs with one choice of settings.

    Parameters
    ----------
    trial : mapping
        What `slipstitch.physics.calibration.sweep.run_settings` returns, with its ``key``.

    Returns
    -------
    dict
        The trial, with ``strain_error`` and ``friction_error`` (the largest of the runs that slip;
        None if none could be compared), ``wrong_regimes`` (count; a run that was not solved is
        wrong), ``meets``, ``distance`` (largest error over its limit, infinite with a wrong
        regime), ``newton_iterations`` x vertices as ``work``, and ``cpu_s``.
    """
    runs = trial["runs"]
    right = [run for run in runs if run["regime"] == run["theory_regime"]]
    slipped = [run for run in right if run["regime"] == "slipped"]
    strain = [abs(run["slip_strain"] - run["theory_slip_strain"]) for run in slipped]
    friction = [abs((run["friction_read_from_strain"] or 0.0) - run["friction"]) for run in slipped]
    wrong = len(runs) - len(right)
    distance = max(
        max(strain, default=0.0) / STRIP_SLIP_STRAIN, max(friction, default=0.0) / STRIP_FRICTION
    )
    return {
        **trial,
        "strain_error": max(strain, default=None),
        "friction_error": max(friction, default=None),
        "wrong_regimes": wrong,
        "distance": math.inf if wrong else distance,
        "meets": not wrong and distance <= 1.0,
        "work": sum(run["newton_iterations"] or 0 for run in runs) * trial["settings"]["vertices"],
        "cpu_s": round(sum(run["cpu_s"] for run in runs), 3),
    }


def choose(trials: Sequence[Trial]) -> Trial:
    """Return the configured settings if they meet the requirements, else the cheapest that do.

    What may be chosen instead of the configured settings is tighter, so that the grid costs more
    with it, whatever a single push costs: it is taken only where the configured settings fail.
    Cost is counted in Newton iterations times vertices, which is the same on every machine.

    Parameters
    ----------
    trials : sequence of dict
        What `judge` returns, for the configured settings and for each change.

    Raises
    ------
    DemandNotMet
        If no eligible settings meet the requirements; names the closest.
    """
    base = next(trial for trial in trials if trial["key"] == BASE)
    if base["meets"]:
        return base
    allowed = [trial for trial in trials if may_be_chosen(trial, base["settings"])]
    meeting = [trial for trial in allowed if trial["meets"]]
    if not meeting:
        raise DemandNotMet(_closest(allowed))
    return min(meeting, key=lambda trial: trial["work"])


def may_be_chosen(trial: Mapping[str, Any], base: Mapping[str, Any]) -> bool:
    """Whether a trial differs from the configured settings in nothing but allowed ways."""
    key = trial["key"]
    if key in (BASE, *FREE):
        return True
    return key in NEVER_LOOSER and trial["settings"][key] < base[key]


def _closest(allowed: Sequence[Trial]) -> str:
    demand = f"slip strain within {STRIP_SLIP_STRAIN:g}, friction within {STRIP_FRICTION:g}"
    best = min(allowed, key=lambda trial: (trial["wrong_regimes"], trial["distance"]))
    shown = describe(best)
    if best["strain_error"] is None:
        came = "no run slipped"
    else:
        came = (
            f"slip strain within {best['strain_error']:.2g}, friction within "
            f"{best['friction_error']:.2g}"
        )
    return (
        f"no settings meet the requirements ({demand}, correct regimes); closest: {shown} with "
        f"{came}, "
        f"{best['wrong_regimes']} of {len(best['runs'])} regimes wrong"
    )


def describe(trial: Mapping[str, Any]) -> str:
    """The distinguishing settings of a trial."""
    if trial["key"] == BASE:
        return "the configured settings"
    return f"{trial['key']} = {trial['settings'][trial['key']]:g}"
