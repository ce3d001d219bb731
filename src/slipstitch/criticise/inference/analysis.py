"""The whole inference: scatter, outliers, test of the null, fits, selection."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from slipstitch.criticise.inference.fit import Fit, fit
from slipstitch.criticise.inference.outliers import Excluded, fit_without_outliers
from slipstitch.criticise.inference.selection import (
    Candidate,
    candidate,
    combined_p,
    explains,
    fitted_pairs,
    number_of_runs,
    second_is_significant,
)
from slipstitch.criticise.inference.state import State, state_at, test_at
from slipstitch.criticise.inference.structure import Outcome
from slipstitch.criticise.measurements import Measurements
from slipstitch.criticise.mechanisms import MECHANISMS

SIGNIFICANCE = 0.04
LEFTOVER_SIGNIFICANCE = 0.01
TIE_BIC = 6.0
MODERATE = 60.0
# Stated uncertainties may be 1.5 times too small; readings of one run that disagree by more than
# this hold an effect that differs within runs.
LARGEST_INSTRUMENT_FACTOR = 1.8
# Fewer runs or specimens than these cannot clear the null; fewer than the least, nothing at all.
SMALLEST_RUNS, SMALLEST_SPECIMENS, LEAST_RUNS = 8, 3, 5


@dataclass
class Analysis:
    """Everything that verdict, report and prediction need."""

    measurements: Measurements
    verdict: str
    causes: tuple[str, ...]
    alternatives: list[tuple[str, ...]]
    null: Fit
    chosen: Candidate | None
    null_state: State
    state: State
    null_outcome: Outcome
    left_over: Outcome | None
    global_p: float
    ranking: list[Candidate]
    excluded: list[Excluded] = field(default_factory=list)
    reason: str = ""


def analyse(
    measurements: Measurements,
    seed: int = 1,
    replicates: int = 300,
    report: Callable[[str], None] = lambda text: None,
) -> Analysis:
    """Reach a verdict.

    Parameters
    ----------
    seed : of the simulated maxima; the same data and seed give the same verdict.
    replicates : simulated data sets behind every family-wise p.
    """
    rng = np.random.default_rng(seed)
    report("fit of the null")
    null, null_state, excluded = fit_without_outliers(measurements, (), None)
    report("test of the null")
    outcome = test_at(measurements, null, null_state, rng, replicates)
    global_p = combined_p(outcome)
    inflation = outcome.mechanism_inflation()
    testable = [
        name
        for name in MECHANISMS
        if any(
            t.mechanism == name and np.isfinite(p)
            for t, p in zip(outcome.tests, outcome.log_p, strict=True)
        )
    ]

    def result(verdict, causes=(), ties=(), chosen=None, state=null_state, left=None, why=""):
        return Analysis(
            measurements,
            verdict,
            tuple(causes),
            list(ties),
            null,
            chosen,
            null_state,
            state,
            outcome,
            left,
            global_p,
            ranking,
            excluded,
            why,
        )

    report("fits of single mechanisms")
    ranking = [candidate(measurements, null_state, (name,), null, inflation) for name in testable]
    ranking.sort(key=lambda c: c.bic)
    runs = number_of_runs(measurements, null_state.keep)
    specimens = len(np.unique(measurements.specimen[null_state.keep]))
    few = runs < SMALLEST_RUNS or specimens < SMALLEST_SPECIMENS
    if runs < LEAST_RUNS or specimens < 2 or (few and global_p > SIGNIFICANCE):
        why = (
            f"{runs} runs of {specimens} specimens; at least {SMALLEST_RUNS} of "
            f"{SMALLEST_SPECIMENS} are needed"
        )
        return result("insufficient", why=why)
    if measurements.implausible:
        return result("insufficient", why="; ".join(measurements.implausible))
    told = measurements.of_friction & null_state.keep & ~measurements.lower_bound
    if not told.any():
        return result("insufficient", why="every reading is only a bound")
    if global_p > SIGNIFICANCE:
        return result("none")
    if not ranking:
        return result("unknown", left=outcome, why="no mechanism can be tested with these data")

    # The scatter at the best model, for all models alike: sensitivities at a poor fit mislead.
    report("selection")
    state, base = null_state, null
    for _ in range(2):
        best = ranking[0]
        if best.bic > -2:
            break
        _, state, excluded = fit_without_outliers(measurements, best.causes, None, best.fitted)
        base = fit(measurements, state.weights, (), null.as_dict())
        starts = {c.causes: c.fitted.as_dict() for c in ranking}
        ranking = [
            candidate(measurements, state, c.causes, base, inflation, starts[c.causes])
            for c in ranking
        ]
        ranking.sort(key=lambda c: c.bic)
        if ranking[0].causes == best.causes:
            break
    singles = list(ranking)
    best = singles[0]
    left_state = state_at(measurements, best.fitted, state.keep, state.scatters)
    left = test_at(measurements, best.fitted, left_state, rng, replicates)
    pairs = fitted_pairs(measurements, state, base, singles, left, left_state, inflation, rng)
    accepted = [p for p in pairs if second_is_significant(p, singles)]
    ranking = sorted(singles + pairs, key=lambda c: c.bic)
    chosen = best
    if accepted and accepted[0].bic < best.bic:
        chosen = accepted[0]
        left_state = state_at(measurements, chosen.fitted, state.keep, state.scatters)
        left = test_at(measurements, chosen.fitted, left_state, rng, replicates)
    chosen_p = combined_p(left)
    if chosen.bic > -2:
        why = "no mechanism improves on the null by enough to be named"
        return result("unknown", chosen=None, state=null_state, left=outcome, why=why)
    if chosen_p < LEFTOVER_SIGNIFICANCE:
        why = "structure is left that no one or two mechanisms remove"
        return result("unknown", chosen=chosen, state=left_state, left=left, why=why)
    noisy = {p: s.kappa for p, s in left_state.scatters.items()}
    noisy = {p: kappa for p, kappa in noisy.items() if kappa > LARGEST_INSTRUMENT_FACTOR}
    if noisy:
        protocol = max(noisy, key=noisy.get)
        why = (
            f"readings of one run of {protocol} disagree by {noisy[protocol]:.1f} times their "
            "stated uncertainty: something differs within runs"
        )
        return result("unknown", chosen=chosen, state=left_state, left=left, why=why)
    aliases = [(c, measurements.unrecorded_alias(c)) for c in chosen.causes]
    aliases = [(c, alias) for c, alias in aliases if alias]
    if aliases:
        cause, alias = aliases[0]
        why = f"{cause} would explain it, but what would drive {alias} instead was not recorded"
        return result("unknown", chosen=chosen, state=left_state, left=left, why=why)
    if chosen.credit < MODERATE and not explains(outcome, chosen, measurements, state):
        why = "a shape outside the library describes the data better than any mechanism"
        return result("unknown", chosen=chosen, state=left_state, left=left, why=why)
    rivals = [c for c in singles if c.bic - chosen.bic < TIE_BIC and c.bic < 0]
    if len(chosen.causes) == 2:
        rivals += [c for c in accepted if c.bic - chosen.bic < TIE_BIC]
    rivals = [chosen] + [c for c in rivals if c.causes != chosen.causes]
    if len(rivals) > 1:
        ties = [c.causes for c in rivals]
        return result("confounded", (), ties, chosen, left_state, left)
    return result("cause", chosen.causes, [chosen.causes], chosen, left_state, left)
