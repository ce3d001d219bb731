"""What a design could have seen: the smallest effect of every mechanism.

An effect is seen where its likelihood ratio is beyond what the maxima simulated for this design and
noise leave at the limit of the family-wise p, which a non-central chi-squared gives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtri
from scipy.stats import ncx2

from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.inference.alternatives import alternatives
from slipstitch.criticise.inference.fit import Fit, jacobian
from slipstitch.criticise.inference.mixed_model import KAPPA_LIMITS, Scatter, make_groups
from slipstitch.criticise.inference.ratio import Ratios
from slipstitch.criticise.inference.structure import ERROR_WEIGHTS, Outcome
from slipstitch.criticise.measurements import Measurements

POWER = 0.8
# Logarithm of the largest change of friction for which an effect counts as one that could be seen:
# none is known to change it tenfold, and tests that are linear in the effect say nothing there.
LARGEST_CHANGE = np.log(10.0)


@dataclass(frozen=True)
class Detectable:
    """The smallest effect of a mechanism that is seen at :data:`POWER`.

    ``size`` in ``unit`` of the mechanism's ``parameter``; infinite where nothing would show it.
    ``on_friction`` is the largest change of a feature's friction that it makes, as a logarithm.
    """

    parameter: str
    size: float
    unit: str
    on_friction: float


def smallest_detectable(outcome: Outcome, fitted: Fit, limit: float) -> dict[str, Detectable]:
    """The smallest effect of every mechanism beside a fitted model, at a family-wise limit."""
    sensitivity = fitted.sensitivity()
    acting = sensitivity != 0
    found: dict[str, Detectable] = {}
    largest = outcome.largest.get("mechanism")
    if largest is None or outcome.information is None:
        return found
    critical = float(np.quantile(largest, 1.0 - limit * ERROR_WEIGHTS["mechanism"]))
    noncentrality: dict[tuple[int, float], float] = {}
    for i, test in enumerate(outcome.tests):
        information, degrees = outcome.information[i], int(outcome.degrees[i])
        if test.mechanism is None:
            continue
        parameter = MECHANISMS[test.mechanism].tested_parameters()[0]
        size, change = np.inf, np.inf
        if information > 1e-12:  # less is the rounding of a derivative that is zero
            threshold = float(chdtri(degrees, 10.0**-critical) * outcome.inflation[i])
            key = (degrees, round(threshold, 3))
            if key not in noncentrality:
                noncentrality[key] = _needed(threshold, degrees)
            steps = np.sqrt(noncentrality[key] / information)
            size = float(steps * parameter.scale)
            relative = np.abs(test.columns[acting]) / np.abs(sensitivity[acting])[:, None]
            change = float(steps * relative.max(initial=0.0))
            size = size if change < LARGEST_CHANGE else np.inf
        known = found.get(test.mechanism)
        if known is None or size < known.size:
            found[test.mechanism] = Detectable(parameter.name, size, parameter.unit, change)
    return found


def _needed(threshold: float, degrees: int) -> float:
    """Noncentrality that exceeds a threshold of chi squared at :data:`POWER`."""

    def missing(value):
        return ncx2.sf(threshold, degrees, value) - POWER

    return float(brentq(missing, 1e-9, 50.0 + 4.0 * threshold))


def plain_model(
    design: Measurements, assumed: Mapping[str, float]
) -> tuple[Fit, dict[str, Scatter]]:
    """The null of a campaign that is still to be made, and the scatter of each protocol.

    Parameters
    ----------
    design : its features, with the errors expected of them.
    assumed : the coefficients, ``scatter_specimen``, ``scatter_run`` and ``noise_factor``.
    """
    parameters = list(design.null_parameters)
    values = np.array([np.log(assumed[p.name]) for p in parameters])
    named = {p.name: float(value) for p, value in zip(parameters, values, strict=True)}
    prediction = design.predict(named, ())
    columns = jacobian(design, (), parameters, values, prediction)
    none = np.zeros((0, 0))
    scatters = {}
    for block in design.blocks:
        # What the traces themselves tell of the noise is in the features' uncertainties already.
        told = max((noise.allowance for noise in block.trace_noises), default=1.0)
        factor = float(np.clip(assumed["noise_factor"] / told, *KAPPA_LIMITS))
        scatters[block.protocol] = Scatter(
            assumed["scatter_specimen"], assumed["scatter_run"], factor
        )
    return Fit((), parameters, values, 0.0, prediction, columns, none), scatters


def of_design(
    design: Measurements,
    plain: Fit,
    scatters: dict[str, Scatter],
    limit: float,
    seed: int,
    replicates: int,
) -> dict[str, Detectable]:
    """The same for a campaign that is still to be made, at its plain model."""
    tests = alternatives(design, plain, np.ones(len(design.y), bool)).tests
    groups = make_groups(design, plain.sensitivity(), ~design.lower_bound)
    nothing = np.zeros(len(design.y))
    ratios = Ratios(tests, plain.jacobian, nothing, groups, scatters, design.zero_columns)
    outcome = ratios.outcome(np.random.default_rng(seed), replicates)
    return smallest_detectable(outcome, plain, limit)


def certificate(detectable: dict[str, Detectable], limit: float) -> dict:
    """What this design could have seen; sizes are None where nothing would show the mechanism."""
    return {
        "false_alarm_limit": limit,
        "false_alarm_rate": None,
        "power": POWER,
        "smallest_detectable": {
            name: {
                "parameter": found.parameter,
                "size": float(f"{found.size:.3g}") if np.isfinite(found.size) else None,
                "unit": found.unit,
            }
            for name, found in sorted(detectable.items())
        },
    }
