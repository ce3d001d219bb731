"""Candidates: sets of causes fitted, scored against the null, and paired."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np
from scipy.stats import chi2 as chi_square

from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.inference.fit import Fit, Weights, fit
from slipstitch.criticise.inference.mixed_model import Scatter
from slipstitch.criticise.inference.state import (
    Refit,
    State,
    alternatives,
    nuisance_columns,
    refit,
    scatters_of,
)
from slipstitch.criticise.inference.structure import Outcome, Test
from slipstitch.criticise.measurements import Measurements

LEFTOVER_SIGNIFICANCE, OWN_SIGNIFICANCE = 0.01, 0.005
# Simulated data sets at most, in units of those asked for, where a p is near its limit.
MOST_ROUNDS = 3
# Mechanisms whose ratio beside the null is far below the best one's are not fitted in full.
FITTED_SINGLES, FITTED_SHARE = 8, 0.5
# A mechanism's law is an idealisation: its effect on a feature is right to this share. What a
# strong effect leaves within it is no further structure; less than the least is not looked at.
LAW_ERROR, NOTICEABLE = 0.03, 4.0
# Prior odds of a mechanism relative to the others. A stage that is driven in one direction and
# back has its backlash removed as a rule, and what the reading of the turn leaves looks like it.
# From the seeds of the benchmark where it was named of null data (3 of 81); not tuned further.
HOW_COMMON = {"backlash": 0.25}
# Candidates within so many units of BIC of the best are not told apart.
TIE_BIC = 6.0
PAIR_SIGNIFICANCE = 0.01
CHANCE_GAIN = 20.0
# Credit below which a shape that is linear is worth comparing with a mechanism. A named law may be
# off in its form: a shape that beats it by this share of its credit is no better.
MODERATE, FORM_SHARE = 60.0, 0.05
# Minus twice the log prior odds of a shape outside the library and a mechanism: one to seven, as
# mechanisms are known because they are frequent.
SHAPE_ODDS = 4.0
# Credit that a cause must have beside the clearest shape that is left, to be named all the same.
STANDS_BESIDE = 60.0
# A rival by design explains at least this share of what the chosen model does.
EQUAL_SHARE = 0.5


@dataclass(frozen=True)
class Candidate:
    """A fitted set of causes with its standing: credit over the null, BIC relative to the null.

    The credit is twice the gain in log-likelihood, the scatter refitted in both.
    """

    causes: tuple[str, ...]
    fitted: Fit
    credit: float
    bic: float
    scatters: dict[str, Scatter]


def rarity(causes: tuple[str, ...]) -> float:
    """Minus twice the logarithm of the causes' prior odds."""
    return -2.0 * float(sum(np.log(HOW_COMMON.get(cause, 1.0)) for cause in causes))


@dataclass
class Judge:
    """Fits sets of causes, each with the scatter that suits it, and scores them against the null.

    Attributes
    ----------
    null : fit of the null, from which all start.
    scatters : of the null.
    inflation : of the mechanisms' test statistics.
    """

    measurements: Measurements
    null: Fit
    scatters: dict[str, Scatter]
    inflation: dict[str, float]
    bases: dict[bytes, Refit] = field(default_factory=dict)

    @cached_property
    def sensitivity(self) -> np.ndarray:
        """(n,) d(feature)/d(ln mu) of the null."""
        return self.null.sensitivity()

    def candidate(self, causes: tuple[str, ...], start: Fit | None = None) -> Candidate:
        """Fit a set of causes; ``start`` is the fit of a part of them."""
        m = self.measurements
        nuisance = self.nuisance(causes)
        base = self._base(nuisance)
        known = start.as_dict() if start is not None else {}
        weights = Weights(m, self.sensitivity, self.scatters, nuisance)
        best = None
        for first in _starts(causes, known):
            found = fit(m, weights, causes, self.null.as_dict() | known | first)
            if best is None or found.chi2 < best.chi2:
                best = found
        best = self._refitted(causes, best, self.scatters, nuisance)
        largest = max([self.inflation.get(cause, 1.0) for cause in causes] + [1.0])
        # Inflation corrects gains by chance, which are small: only the first part is deflated.
        gained = max(2 * (best.log_likelihood - base.log_likelihood), 0.0)
        credit = gained - (1.0 - 1.0 / largest) * min(gained, CHANCE_GAIN)
        extra = len(best.fitted.parameters) - len(base.fitted.parameters)
        cost = extra * np.log(max(m.runs, 2)) + rarity(causes)
        return Candidate(causes, best.fitted, credit, cost - credit, best.scatters)

    def ranked(self, candidates: list[Candidate], fitted: bool = False) -> list[Candidate]:
        """Fit candidates, by BIC; from their own fits if they are ``fitted``."""
        found = [self.candidate(c.causes, c.fitted if fitted else None) for c in candidates]
        return sorted(found, key=lambda c: c.bic)

    def credit_beside(self, chosen: Candidate, columns: np.ndarray) -> float:
        """Credit of a model over the null with columns (n, k) that are fitted freely in both."""
        base = self._refitted((), self.null, self.scatters, columns)
        best = self._refitted(chosen.causes, chosen.fitted, chosen.scatters, columns)
        return 2 * (best.log_likelihood - base.log_likelihood)

    def tested(
        self, chosen: Candidate, measurements: Measurements, rng, replicates: int
    ) -> tuple[Candidate, State, Outcome]:
        """A candidate under its restricted scatter, as it is reported, and tests of what is left.

        ``measurements`` are those without the law's own error.
        """
        m = with_law_error(measurements, chosen.fitted)
        sensitivity = chosen.fitted.sensitivity()
        scatters = scatters_of(m, chosen.fitted, sensitivity, chosen.scatters)
        weights = Weights(m, sensitivity, scatters, self.nuisance(chosen.causes))
        fitted = fit(m, weights, chosen.causes, chosen.fitted.as_dict())
        scatters = scatters_of(m, fitted, fitted.sensitivity(), scatters)
        state = State(m, fitted, scatters, *alternatives(m, fitted))
        left = state.outcome(rng, MOST_ROUNDS * replicates, (LEFTOVER_SIGNIFICANCE,))
        return replace(chosen, fitted=fitted, scatters=scatters), state, left

    def nuisance(self, causes: tuple[str, ...]) -> np.ndarray | None:
        """Free levels where what drives the causes was not recorded."""
        unrecorded = np.zeros(len(self.measurements.y), bool)
        for cause in causes:
            unrecorded |= self.measurements.unrecorded(cause)
        return nuisance_columns(self.measurements, unrecorded, self.sensitivity)

    def _base(self, nuisance: np.ndarray | None) -> Refit:
        key = b"" if nuisance is None else nuisance.tobytes()
        if key not in self.bases:
            self.bases[key] = self._refitted((), self.null, self.scatters, nuisance)
        return self.bases[key]

    def _refitted(self, causes, start: Fit, scatters: dict[str, Scatter], nuisance) -> Refit:
        return refit(self.measurements, causes, start, scatters, self.sensitivity, nuisance)


def with_law_error(measurements: Measurements, fitted: Fit) -> Measurements:
    """Uncertainties with the law's own error, where that makes a difference."""
    plain = measurements.predict(fitted.as_dict(), ())
    error = np.nan_to_num(LAW_ERROR * (fitted.prediction - plain))
    if np.sum((error / measurements.u) ** 2) < NOTICEABLE:
        return measurements
    return replace(measurements, u=np.hypot(measurements.u, error))


def linear_ranking(state: State, outcome: Outcome) -> list[Candidate]:
    """Every testable mechanism by its likelihood ratio beside the null, not fitted any further."""
    best: dict[str, float] = {}
    for test, ratio, log_p in zip(outcome.tests, outcome.statistic, outcome.log_p, strict=True):
        if test.mechanism is not None and np.isfinite(log_p):
            best[test.mechanism] = max(best.get(test.mechanism, 0.0), float(ratio))
    runs = np.log(max(state.measurements.runs, 2))
    costs = {name: len(MECHANISMS[name].parameters) * runs + rarity((name,)) for name in best}
    found = [
        Candidate((name,), state.fitted, ratio, costs[name] - ratio, state.scatters)
        for name, ratio in best.items()
    ]
    return sorted(found, key=lambda c: c.bic)


def promising(ranking: list[Candidate]) -> list[Candidate]:
    """The mechanisms that are worth a full fit."""
    least = FITTED_SHARE * max(c.credit for c in ranking)
    by_credit = sorted(ranking, key=lambda c: -c.credit)
    return [c for i, c in enumerate(by_credit) if i < FITTED_SINGLES or c.credit > least]


def _starts(causes: tuple[str, ...], known: dict[str, float]) -> list[dict[str, float]]:
    """Values to start fits from, for the mechanisms of which none are known."""
    choices = [
        MECHANISMS[cause].starts
        for cause in causes
        if not {p.name for p in MECHANISMS[cause].parameters} <= set(known)
    ]
    combined = product(*(choice for choice in choices if choice))
    return [{k: v for part in parts for k, v in part.items()} for parts in combined]


def explains(outcome: Outcome, chosen: Candidate, measurements: Measurements) -> bool:
    """Does the chosen model beat the best generic shape (its place or period counted)?

    For single moderate effects only: a shape says little far from the null. Two mechanisms along
    one covariate are but a curve in it unless they are clearly better than every free one.
    """
    runs = np.log(max(measurements.runs, 2))
    covariates = Counter(MECHANISMS[cause].covariate for cause in chosen.causes)
    shared = {name for name, number in covariates.items() if name is not None and number > 1}
    for i, test in enumerate(outcome.tests):
        if test.family != "generic" or not np.isfinite(outcome.log_p[i]):
            continue
        bic = (outcome.degrees[i] + test.scanned) * runs - outcome.statistic[i]
        if test.covariate in shared and chosen.bic > bic - TIE_BIC:
            return False
        allowed = SHAPE_ODDS + FORM_SHARE * chosen.credit
        if chosen.credit < MODERATE and chosen.bic > bic + allowed:
            return False
    return True


def stands_beside(chosen: Candidate, left: Outcome, judge: Judge) -> bool:
    """Is the evidence for a model overwhelming beside the clearest shape that it leaves?

    It must be more than that for the shape as well: the cause has to be the greater of the two.
    """
    strongest = left.strongest("generic")
    if strongest is None or chosen.credit < STANDS_BESIDE:
        return False
    shape = left.tests[strongest]
    columns = [shape.columns] if shape.nuisance is None else [shape.columns, shape.nuisance]
    beside = judge.credit_beside(chosen, np.column_stack(columns))
    return beside >= max(STANDS_BESIDE, float(left.statistic[strongest]))


def left_along_own(chosen: Candidate, left: Outcome) -> str | None:
    """The covariate of a cause along which a shape is left; None where there is none.

    Looked at by itself: a law that bends where the data do not is not the law.
    """
    for cause in chosen.causes:
        own = MECHANISMS[cause].covariate
        tests = [i for i, test in enumerate(left.tests) if own and test.covariate == own]
        tests = [i for i in tests if np.isfinite(left.log_p[i])]
        if not tests:
            continue
        best = max(tests, key=lambda i: left.log_p[i])
        significant = len(tests) * 10.0 ** -left.log_p[best] < OWN_SIGNIFICANCE
        if significant and left.statistic[best] > FORM_SHARE * chosen.credit:
            return own
    return None


def tied_with(
    chosen: Candidate, others: list[Candidate], judge: Judge, state: State
) -> list[Candidate]:
    """Those that the data do not tell from the chosen one, or the design could not.

    Evidence against a rival counts for no more than the design would give on average if the chosen
    model were exact: the rest comes of noise, of sensors or of the laws' own errors.
    """
    tied = []
    for other in others:
        if other.causes == chosen.causes or other.bic >= 0:
            continue
        gap = other.bic - chosen.bic
        evidence = chosen.credit - other.credit
        if gap >= TIE_BIC and other.credit > EQUAL_SHARE * chosen.credit:
            expected = _expected_evidence(chosen, other, judge, state)
            gap -= max(evidence - expected, 0.0)
        if gap < TIE_BIC:
            tied.append(other)
    return tied


def _expected_evidence(chosen: Candidate, other: Candidate, judge: Judge, state: State) -> float:
    """By how much twice the log-likelihood of another model falls short of an exact one."""
    exact = replace(state.measurements, y=chosen.fitted.prediction)
    nuisance = judge.nuisance(other.causes)
    weights = Weights(exact, state.sensitivity, state.scatters, nuisance)
    best = fit(exact, weights, other.causes, other.fitted.as_dict())
    return max(best.chi2 - weights.chi2(exact.y), 0.0)


def second_is_significant(pair: Candidate, singles: list[Candidate], left: Outcome) -> bool:
    """Is the second mechanism significant beside the better of the two alone (Bonferroni)?"""
    alone = [c for c in singles if c.causes[0] in pair.causes]
    if not alone:
        return False
    top = max(alone, key=lambda c: c.credit)
    extra = len(pair.fitted.parameters) - len(top.fitted.parameters)
    tried = max(len(testable(left)), 1)
    threshold = chi_square.isf(PAIR_SIGNIFICANCE / tried, max(extra, 1))
    return pair.credit - top.credit > threshold and pair.bic < top.bic


def fitted_pairs(judge: Judge, singles: list[Candidate], left: Outcome) -> list[Candidate]:
    """The most promising pairs, fitted; screened by ratios beside the leading singles."""
    promise: dict[tuple[str, ...], float] = {}
    # Beside a strong first mechanism a second one counts that explains little alone.
    known = testable(left) | {c.causes[0] for c in singles}

    def offer(single, tests, ratios):
        for test, ratio in zip(tests, ratios, strict=True):
            if test.mechanism in known and np.isfinite(ratio):
                pair = tuple(sorted((single.causes[0], test.mechanism)))
                promise[pair] = max(promise.get(pair, 0.0), single.credit + ratio)

    offer(singles[0], left.tests, np.where(np.isfinite(left.log_p), left.statistic, np.nan))
    beside_best = sorted(promise, key=lambda pair: (-promise[pair], pair))[:6]
    most = 5
    if left.global_p < 0.3:
        for single in singles[1:4]:
            offer(single, *_beside(judge, single))
    else:
        beside_best, most = beside_best[:3], 0
    others = sorted(set(promise) - set(beside_best), key=lambda pair: (-promise[pair], pair))
    fitted = []
    for pair in beside_best + others[:most]:
        first = max((c for c in singles if c.causes[0] in pair), key=lambda c: c.credit)
        fitted.append(judge.candidate(pair, first.fitted))
    return sorted(fitted, key=lambda c: c.bic)


def testable(left: Outcome) -> set[str]:
    """The mechanisms that can be tested beside a model."""
    return {
        test.mechanism
        for test, log_p in zip(left.tests, left.log_p, strict=True)
        if test.mechanism is not None and np.isfinite(log_p)
    }


def _beside(judge: Judge, single: Candidate) -> tuple[list[Test], np.ndarray]:
    """Tests of all further mechanisms beside a single one, and their likelihood ratios."""
    m, fitted = judge.measurements, single.fitted
    tests = [test for test in alternatives(m, fitted)[0] if test.family == "mechanism"]
    ratios = State(m, fitted, single.scatters, tests, {}).ratios()
    return tests, ratios.observed().max(axis=0)
