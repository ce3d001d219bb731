"""Candidates: sets of causes fitted, scored against the null, and paired."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.stats import chi2 as chi_square

from slipstitch.criticise.inference.alternatives import alternatives, nuisance_columns
from slipstitch.criticise.inference.fit import Fit, fit
from slipstitch.criticise.inference.state import State
from slipstitch.criticise.inference.structure import Outcome, Test, run_tests
from slipstitch.criticise.measurements import Measurements
from slipstitch.criticise.mechanisms import MECHANISMS

# Of the family-wise error.
ERROR_WEIGHTS = {"mechanism": 0.6, "generic": 0.4}
PAIR_SIGNIFICANCE = 0.01
CHANCE_GAIN = 20.0


@dataclass
class Candidate:
    """A fitted set of causes with its standing: credit over the null, BIC relative to the null."""

    causes: tuple[str, ...]
    fitted: Fit
    credit: float
    bic: float


def number_of_runs(measurements: Measurements, keep: np.ndarray) -> int:
    """Runs of which any feature is kept: the observations that the BIC counts."""
    return len(np.unique(measurements.run[keep]))


def candidate(
    measurements: Measurements,
    state: State,
    causes: tuple[str, ...],
    null: Fit,
    inflation: dict[str, float],
    start: dict[str, float] | None = None,
) -> Candidate:
    """Fit a set of causes and score it against the null (with the same nuisance levels)."""
    unrecorded = np.zeros(len(measurements.y), bool)
    for cause in causes:
        unrecorded |= measurements.unrecorded(cause)
    weights, base = state.weights, null
    nuisance = nuisance_columns(measurements, unrecorded & state.keep, state.sensitivity)
    if nuisance is not None:
        weights = weights.with_nuisance(nuisance)
        base = fit(measurements, weights, null.causes, null.as_dict())
    values = null.as_dict() | (start or {})
    best = None
    for first in _starts(causes, start or {}):
        found = fit(measurements, weights, causes, values | first)
        if best is None or found.chi2 < best.chi2:
            best = found
    largest = max([inflation.get(cause, 1.0) for cause in causes] + [1.0])
    # The inflation corrects gains by chance, which are small: only the first part is deflated.
    gained = max(base.chi2 - best.chi2, 0.0)
    credit = gained - (1.0 - 1.0 / largest) * min(gained, CHANCE_GAIN)
    extra = len(best.parameters) - len(base.parameters)
    cost = extra * np.log(max(number_of_runs(measurements, state.keep), 2))
    return Candidate(causes, best, credit, cost - credit)


def _starts(causes: tuple[str, ...], known: dict[str, float]) -> list[dict[str, float]]:
    """Values to start fits from, for the mechanisms of which none are known."""
    choices = [
        MECHANISMS[cause].starts
        for cause in causes
        if not {p.name for p in MECHANISMS[cause].parameters} <= set(known)
    ]
    combined = product(*(choice for choice in choices if choice))
    return [{k: v for part in parts for k, v in part.items()} for parts in combined]


def combined_p(outcome: Outcome) -> float:
    """Family-wise p over mechanisms and shapes, Bonferroni-weighted between the two."""
    return float(
        min(
            1.0,
            *(outcome.family_p.get(name, 1.0) / weight for name, weight in ERROR_WEIGHTS.items()),
        )
    )


def explains(outcome: Outcome, chosen: Candidate, measurements, state) -> bool:
    """Does the chosen model beat the best generic shape (its place or period counted)?

    For moderate effects only: the score test of a shape says little far from the null, and a
    shape that beats a strong cause leaves structure behind.
    """
    runs = np.log(max(number_of_runs(measurements, state.keep), 2))
    best = np.inf
    for i, test in enumerate(outcome.tests):
        if test.family != "generic" or not np.isfinite(outcome.log_p[i]):
            continue
        best = min(best, (outcome.degrees[i] + test.scanned) * runs - outcome.statistic[i])
    return chosen.bic <= best + 2.0


def second_is_significant(pair: Candidate, singles: list[Candidate]) -> bool:
    """Is the second mechanism significant beside the better of the two alone (Bonferroni)?"""
    alone = [c for c in singles if c.causes[0] in pair.causes]
    if not alone:
        return False
    top = max(alone, key=lambda c: c.credit)
    extra = len(pair.fitted.parameters) - len(top.fitted.parameters)
    threshold = chi_square.isf(PAIR_SIGNIFICANCE / max(len(singles) - 1, 1), max(extra, 1))
    return pair.credit - top.credit > threshold and pair.bic < top.bic


def fitted_pairs(measurements, state, base, singles, left, left_state, inflation, rng, most=5):
    """The most promising pairs, fitted: screened by score tests beside the leading singles."""
    promise: dict[tuple[str, ...], float] = {}
    testable = {c.causes[0] for c in singles}

    def offer(single, outcome):
        for i, test in enumerate(outcome.tests):
            if test.mechanism not in testable or not np.isfinite(outcome.log_p[i]):
                continue
            pair = tuple(sorted((single.causes[0], test.mechanism)))
            promise[pair] = max(promise.get(pair, 0.0), single.credit + outcome.statistic[i])

    offer(singles[0], left)
    beside_best = sorted(promise, key=lambda pair: -promise[pair])[:6]
    if combined_p(left) < 0.3:
        for single in singles[1:4]:
            other = mechanism_tests(measurements, single.fitted, state)
            outcome = run_tests(
                other,
                single.fitted.jacobian,
                measurements.y - single.fitted.prediction,
                state.groups,
                state.scatters,
                state.rich,
                rng,
                replicates=2,
            )
            outcome.statistic = outcome.statistic * outcome.inflation
            offer(single, outcome)
    else:
        beside_best, most = beside_best[:3], 0
    others = sorted(set(promise) - set(beside_best), key=lambda pair: (-promise[pair], pair))
    starts = {c.causes[0]: c.fitted.as_dict() for c in singles}
    fitted = []
    for pair in beside_best + others[:most]:
        first = max(pair, key=lambda name: next(c.credit for c in singles if c.causes[0] == name))
        fitted.append(candidate(measurements, state, pair, base, inflation, starts[first]))
    return sorted(fitted, key=lambda c: c.bic)


def mechanism_tests(measurements, fitted, state) -> list[Test]:
    """Mechanism tests beside another fitted model, at the scatter already known."""
    found = alternatives(measurements, fitted, state.keep)
    return [test for test in found.tests if test.family == "mechanism"]
