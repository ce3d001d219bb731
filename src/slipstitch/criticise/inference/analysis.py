"""The whole inference: scatter, outliers, test of the null, fits, selection."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from slipstitch.criticise.inference.alternatives import sensitivity_of
from slipstitch.criticise.inference.certificate import Detectable, smallest_detectable
from slipstitch.criticise.inference.covariance import make_groups
from slipstitch.criticise.inference.findings import noise_findings, zero_findings
from slipstitch.criticise.inference.fit import Fit, Weights, fit
from slipstitch.criticise.inference.outliers import Excluded, fit_without_outliers
from slipstitch.criticise.inference.rivals import TITLES, taken_by_rivals
from slipstitch.criticise.inference.selection import (
    STANDS_BESIDE,
    TIE_BIC,
    Candidate,
    Judge,
    explains,
    fitted_pairs,
    number_of_runs,
    second_is_significant,
    stands_beside,
    tied_with,
)
from slipstitch.criticise.inference.state import State, refit, state_at, test_at
from slipstitch.criticise.inference.structure import Outcome
from slipstitch.criticise.measurements import Measurements
from slipstitch.criticise.mechanisms import MECHANISMS
from slipstitch.criticise.sensors import ZEROS, DataFinding, Zero
from slipstitch.physics.friction_law import CONTACT_MECHANISMS

SIGNIFICANCE = 0.04
LEFTOVER_SIGNIFICANCE = 0.01
# Simulated data sets at most, in units of those asked for, where a p is near its limit.
MOST_ROUNDS = 3
# Mechanisms whose ratio beside the null is far below the best one's are not fitted in full.
FITTED_SINGLES, FITTED_SHARE = 8, 0.5
# A mechanism's law is an idealisation: its effect on a feature is right to this share. What a
# strong effect leaves within it is no further structure; less than the least is not looked at.
LAW_ERROR, NOTICEABLE = 0.03, 4.0
# Gain in log-likelihood from where on zeros may stand where a cause should.
ZEROS_NEEDED = 4.0
# Stated uncertainties may be 1.5 times too small; readings of one run that disagree by more than
# this hold an effect that differs within runs.
LARGEST_INSTRUMENT_FACTOR = 1.8
# A sensor whose noise is a finding may have heavy tails as well: the standard deviation of
# Student's t of 3 degrees is 1.5 times the one that its median tells.
HEAVY_TAILS = 1.5
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
    data_findings: list[DataFinding] = field(default_factory=list)
    detectable: dict[str, Detectable] = field(default_factory=dict)


def analyse(measurements: Measurements, seed: int = 1, replicates: int = 300) -> Analysis:
    """Reach a verdict.

    Parameters
    ----------
    seed : of the simulated maxima; the same data and seed give the same verdict.
    replicates : simulated data sets behind every family-wise p.
    """
    found = _analyse(measurements, seed, replicates)
    tares = _unsure_tares(found)
    if tares:
        measurements = replace(measurements, further_zeros=tares)
        found = _analyse(measurements, seed, replicates)
    if found.verdict != "none" or not measurements.zeros:
        return found
    # Zeros may have taken a cause's place: does one explain the data as well without them?
    sound = replace(measurements, sound_sensors=True)
    keep = found.null_state.keep
    zeros = refit(measurements, keep, (), found.null, found.null_state.scatters).log_likelihood
    plain = refit(sound, keep, (), found.null, found.null_state.scatters).log_likelihood
    if zeros - plain < ZEROS_NEEDED:
        return found
    other = _analyse(sound, seed, replicates)
    if other.verdict not in ("cause", "confounded") or other.chosen is None:
        return found
    chosen = other.chosen
    without = refit(sound, keep, chosen.causes, chosen.fitted, chosen.scatters).log_likelihood
    extra = len(chosen.fitted.values) - len(found.null.values)
    without -= 0.5 * extra * np.log(max(number_of_runs(measurements, keep), 2))
    # Where zeros explain it about as well, nothing is said: of campaigns that hold nothing, a
    # quarter would be said to hold something, and none of the bench's effects was found by it.
    return other if without >= zeros + 0.5 * TIE_BIC else found


def _unsure_tares(found: Analysis) -> tuple[tuple[str, Zero], ...]:
    """Zeros of cells that drift, where an offset is blamed.

    A drift is counted from the middle of the session; when the cell read right is not known, so
    that it is off there by up to what it drifts in half the session.
    """
    blamed = {cause for causes in found.alternatives for cause in causes}
    blamed |= set(found.chosen.causes if found.chosen else ())
    if "force_offset" not in blamed:
        return ()
    drift = ZEROS["force_drift_N_h"]
    hours = {b.protocol: np.abs(b.hours()).max(initial=0.0) for b in found.measurements.blocks}
    return tuple(
        (
            finding.protocol,
            Zero(
                "force_offset_N",
                finding.sensor,
                "zero of the drifting force",
                "mN",
                1e-3,
                float(abs(finding.size) * hours[finding.protocol]),
            ),
        )
        for finding in found.data_findings
        if finding.quantity == drift.quantity
    )


def _analyse(measurements: Measurements, seed: int, replicates: int) -> Analysis:
    rng = np.random.default_rng(seed)
    null, null_state, excluded = fit_without_outliers(measurements, (), None)
    outcome = test_at(
        measurements, null, null_state, rng, MOST_ROUNDS * replicates, (SIGNIFICANCE,)
    )
    global_p = outcome.global_p
    detectable = smallest_detectable(outcome, null, SIGNIFICANCE)
    inflation = outcome.mechanism_inflation()
    linear = _linear_ranking(measurements, null, null_state, outcome)
    ranking = linear

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
            [
                *noise_findings(measurements),
                *zero_findings(measurements, chosen.fitted if chosen else null, state),
            ],
            detectable,
        )

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
    if measurements.lower_bound[null_state.keep].all():
        return result("insufficient", why="every reading is only a bound")
    if global_p > SIGNIFICANCE and not _could_be_seen(detectable):
        why = "not even an effect that doubles the friction would have been seen"
        return result("insufficient", why=why)
    if global_p > SIGNIFICANCE:
        return result("none")
    if not ranking:
        return result("unknown", left=outcome, why="no mechanism can be tested with these data")

    keep = null_state.keep
    judge = Judge(measurements, keep, null, null_state.scatters, null_state.sensitivity, inflation)
    promising = _promising(linear)
    ranking = sorted((judge.candidate(c.causes) for c in promising), key=lambda c: c.bic)
    # Outliers are judged again beside the best model: what the null could not explain, it may.
    if ranking[0].bic < -2:
        _, state, again = fit_without_outliers(
            measurements, ranking[0].causes, None, ranking[0].fitted
        )
        if not np.array_equal(state.keep, keep):
            keep, excluded = state.keep, again
            groups = make_groups(
                measurements, null_state.sensitivity, keep & ~measurements.lower_bound
            )
            weights = Weights.build(
                groups, null_state.scatters, measurements, null_state.sensitivity, keep
            )
            base = fit(measurements, weights, (), null.as_dict())
            judge = Judge(
                measurements, keep, base, null_state.scatters, sensitivity_of(base), inflation
            )
            ranking = [judge.candidate(c.causes, c.fitted) for c in ranking]
            ranking.sort(key=lambda c: c.bic)
    imprecise = _with_law_error(measurements, ranking[0].fitted)
    if imprecise is not measurements:
        judge = replace(judge, measurements=imprecise, bases={})
        ranking = [judge.candidate(c.causes, c.fitted) for c in ranking]
        ranking.sort(key=lambda c: c.bic)
    singles = list(ranking)
    chosen, left_state, left = _tested(measurements, judge, singles[0], rng, replicates)
    pairs = fitted_pairs(judge, singles, left)
    accepted = [p for p in pairs if second_is_significant(p, singles, left)]
    ranking = sorted(singles + pairs, key=lambda c: c.bic)
    if accepted and accepted[0].bic < chosen.bic:
        chosen, left_state, left = _tested(measurements, judge, accepted[0], rng, replicates)
        accepted[0] = chosen
    ranking = [chosen if c.causes == chosen.causes else c for c in ranking]
    singles = [chosen if c.causes == chosen.causes else c for c in singles]
    chosen_p = left.global_p
    if chosen.bic > -2:
        why = "no mechanism improves on the null by enough to be named"
        return result("unknown", chosen=None, state=null_state, left=outcome, why=why)
    if chosen_p < LEFTOVER_SIGNIFICANCE and not stands_beside(chosen, left, judge):
        why = "structure is left that no one or two mechanisms remove"
        return result("unknown", chosen=chosen, state=left_state, left=left, why=why)
    largest = dict.fromkeys(left_state.scatters, LARGEST_INSTRUMENT_FACTOR)
    for finding in noise_findings(measurements):
        largest[finding.protocol] = LARGEST_INSTRUMENT_FACTOR * HEAVY_TAILS
    noisy = {p: s.kappa for p, s in left_state.scatters.items() if s.kappa > largest[p]}
    if noisy and chosen.credit < STANDS_BESIDE:
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
    if not explains(outcome, chosen, measurements, keep):
        why = "a shape outside the library describes the data better than any mechanism"
        return result("unknown", chosen=chosen, state=left_state, left=left, why=why)
    others = singles + accepted if len(chosen.causes) == 2 else singles
    rivals = tied_with(chosen, others, judge, left_state)
    ties = [chosen.causes] + [c.causes for c in rivals]
    taken = taken_by_rivals(measurements, chosen.fitted, null_state, left_state)
    if taken:
        others = dict.fromkeys(name for names in taken.values() for name in names)
        kept = tuple(c for c in chosen.causes if c not in taken)
        ties += [(*kept, name) for name in others]
        why = f"beside {' or '.join(TITLES[name] for name in others)} its evidence is gone; " + (
            "runs in a random order would tell"
        )
        return result("confounded", (), ties, chosen, left_state, left, why)
    if len(ties) > 1:
        return result("confounded", (), ties, chosen, left_state, left)
    return result("cause", chosen.causes, [chosen.causes], chosen, left_state, left)


def _could_be_seen(detectable: dict[str, Detectable]) -> bool:
    """Would any mechanism of the contact that changes the friction twofold have been seen?"""
    return any(
        found.on_friction < np.log(2)
        for name, found in detectable.items()
        if name in CONTACT_MECHANISMS
    )


def _with_law_error(measurements: Measurements, fitted: Fit) -> Measurements:
    """Uncertainties with the law's own error, where that makes a difference."""
    plain = measurements.predict(fitted.as_dict(), ())
    error = np.nan_to_num(LAW_ERROR * (fitted.prediction - plain))
    if np.sum((error / measurements.u) ** 2) < NOTICEABLE:
        return measurements
    return replace(measurements, u=np.hypot(measurements.u, error))


def _linear_ranking(measurements, null, state, outcome: Outcome) -> list[Candidate]:
    """Every testable mechanism by its likelihood ratio beside the null, not fitted any further."""
    best: dict[str, float] = {}
    for test, ratio, log_p in zip(outcome.tests, outcome.statistic, outcome.log_p, strict=True):
        if test.mechanism is not None and np.isfinite(log_p):
            best[test.mechanism] = max(best.get(test.mechanism, 0.0), float(ratio))
    cost = np.log(max(number_of_runs(measurements, state.keep), 2))
    ranking = [
        Candidate(
            (name,), null, ratio, len(MECHANISMS[name].parameters) * cost - ratio, state.scatters
        )
        for name, ratio in best.items()
    ]
    return sorted(ranking, key=lambda c: c.bic)


def _promising(ranking: list[Candidate]) -> list[Candidate]:
    """The mechanisms that are worth a full fit."""
    least = FITTED_SHARE * max(c.credit for c in ranking)
    by_credit = sorted(ranking, key=lambda c: -c.credit)
    return [c for i, c in enumerate(by_credit) if i < FITTED_SINGLES or c.credit > least]


def _tested(
    measurements: Measurements, judge: Judge, chosen: Candidate, rng, replicates: int
) -> tuple[Candidate, State, Outcome]:
    """A candidate under its restricted scatter, as it is reported, and tests of what is left."""
    m = _with_law_error(measurements, chosen.fitted)
    state = state_at(m, chosen.fitted, judge.keep, chosen.scatters)
    weights = judge.weights_of(chosen.causes, state)
    fitted = fit(m, weights, chosen.causes, chosen.fitted.as_dict())
    state = state_at(m, fitted, judge.keep, state.scatters)
    limits = (LEFTOVER_SIGNIFICANCE,)
    left = test_at(m, fitted, state, rng, MOST_ROUNDS * replicates, limits)
    return replace(chosen, fitted=fitted, scatters=state.scatters), state, left
