"""The whole inference: scatter, outliers, test of the null, fits, selection."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from scipy.stats import chi2 as chi_square

from slipstitch.criticise.inference.alternatives import (
    alternatives,
    nuisance_columns,
    rich_columns,
    sensitivity_of,
)
from slipstitch.criticise.inference.covariance import (
    Group,
    Scatter,
    estimate_scatter,
    make_groups,
    restricted_projection,
)
from slipstitch.criticise.inference.fit import Fit, Weights, fit
from slipstitch.criticise.inference.structure import Outcome, Test, run_tests
from slipstitch.criticise.measurements import Measurements
from slipstitch.criticise.mechanisms import MECHANISMS

START_SCATTER = Scatter(0.05, 0.03, 1.2)
# Of the family-wise error.
ERROR_WEIGHTS = {"mechanism": 0.6, "generic": 0.4}
SIGNIFICANCE = 0.04
LEFTOVER_SIGNIFICANCE = 0.01
PAIR_SIGNIFICANCE = 0.01
TIE_BIC = 6.0
CHANCE_GAIN = 20.0
MODERATE = 60.0
# Stated uncertainties may be 1.5 times too small; readings of one run that disagree by more than
# this hold an effect that differs within runs.
LARGEST_INSTRUMENT_FACTOR = 1.8
OUTLIER_T = 4.2
SUSPECT_T = 2.6
OUTLIER_FRACTION = 0.08
# Fewer runs or specimens than these cannot clear the null; fewer than the least, nothing at all.
SMALLEST_RUNS, SMALLEST_SPECIMENS, LEAST_RUNS = 8, 3, 5


@dataclass
class Candidate:
    """A fitted set of causes with its standing: credit over the null, BIC relative to the null."""

    causes: tuple[str, ...]
    fitted: Fit
    credit: float
    bic: float


@dataclass
class Excluded:
    """A run, or one feature of it, that no model explains."""

    run_id: str
    reason: str
    features: np.ndarray


@dataclass
class State:
    """Scatter, weights and tests at one fitted model."""

    keep: np.ndarray
    groups: list[Group]
    scatters: dict[str, Scatter]
    weights: Weights
    sensitivity: np.ndarray
    tests: list[Test]
    rich: dict[str, np.ndarray]
    untestable: dict[str, str]


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


def settle(
    measurements: Measurements,
    fitted: Fit,
    keep: np.ndarray,
    start: dict[str, Scatter] | None = None,
) -> State:
    """Estimate the scatter at a fitted model and set up the weights and tests there."""
    sensitivity = sensitivity_of(fitted)
    uncensored = keep & ~measurements.lower_bound
    groups = make_groups(
        measurements.protocol,
        measurements.run,
        measurements.specimen,
        measurements.u,
        sensitivity,
        uncensored,
    )
    found = alternatives(measurements, fitted, keep)
    residual = measurements.y - fitted.prediction
    scatters, rich = {}, {}
    for group in groups:
        fixed = _fixed(group, sensitivity)
        guess = (start or {}).get(group.protocol, START_SCATTER)
        own = rich_columns(found.tests, group, group.variance(START_SCATTER), fixed)
        scatter = estimate_scatter(group, residual[group.index], fixed, own, guess)
        rich[group.protocol] = own
        scatters[group.protocol] = scatter
    weights = Weights.build(groups, scatters, measurements, sensitivity, keep)
    return State(keep, groups, scatters, weights, sensitivity, found.tests, rich, found.untestable)


def _fixed(group: Group, sensitivity: np.ndarray) -> np.ndarray:
    d = sensitivity[group.index]
    size = np.linalg.norm(d)
    return (d / size)[:, None] if size > 0 else np.zeros((len(d), 0))


def find_outliers(measurements: Measurements, fitted: Fit, state: State) -> list[Excluded]:
    """Runs (and single features) that lie far off under the rich model, the worst first.

    Suspects are left out of the scatter by which they are judged.
    """
    found: list[tuple[float, Excluded]] = []
    residual = measurements.y - fitted.prediction
    for group in state.groups:
        scatter = state.scatters[group.protocol]
        fixed = _fixed(group, state.sensitivity)
        rich = rich_columns(state.tests, group, group.variance(scatter), fixed)
        suspects = _deviations(measurements, group, scatter, rich, residual, state)
        suspects = [s for s in suspects if s[0] > SUSPECT_T]
        if not suspects:
            continue
        runs = len(np.unique(measurements.run[group.index]))
        suspects = suspects[: 1 + int(1.5 * OUTLIER_FRACTION * runs)]
        suspicious = np.concatenate([s[2] for s in suspects])
        kept = np.flatnonzero(~np.isin(group.index, suspicious))
        if len(kept) < 0.6 * len(group.index):
            continue
        rest = Group(
            group.protocol,
            group.index[kept],
            group.u[kept],
            group.sensitivity[kept],
            group.same_specimen[np.ix_(kept, kept)],
            group.same_run[np.ix_(kept, kept)],
        )
        scatter = estimate_scatter(
            rest, residual[rest.index], _fixed(rest, state.sensitivity), rich[kept], scatter
        )
        for t, signed, features, what in _deviations(
            measurements, group, scatter, rich, residual, state
        ):
            limit = OUTLIER_T if what == "run-level outlier" else OUTLIER_T + 0.6
            if t > limit:
                name = str(measurements.rows["run_id"].iloc[features[0]])
                found.append((t, Excluded(name, f"{what}, t={signed:.1f}", features)))
    found.sort(key=lambda item: -item[0])
    return [item[1] for item in found]


def _deviations(measurements, group, scatter, rich, residual, state):
    """(|t|, t, features, what) of every run and of single features, the worst first."""
    variance = group.variance(scatter)
    projection, _ = restricted_projection(
        variance + rich @ rich.T, _fixed(group, state.sensitivity)
    )
    pulled = projection @ residual[group.index]
    runs, d = measurements.run[group.index], group.sensitivity
    quantities = measurements.rows["quantity"].to_numpy()[group.index]
    result = []
    for run in np.unique(runs):
        mine = np.flatnonzero(runs == run)
        information = d[mine] @ projection[np.ix_(mine, mine)] @ d[mine]
        worst = 0.0
        if information > 1e-9:
            t = float(d[mine] @ pulled[mine] / np.sqrt(information))
            worst = abs(t)
            result.append((worst, t, group.index[mine], "run-level outlier"))
        if len(mine) == 1:
            continue
        for i in mine:
            t = float(pulled[i] / np.sqrt(max(projection[i, i], 1e-12)))
            if abs(t) > worst + 1.0:
                result.append((abs(t), t, group.index[[i]], f"outlier in {quantities[i]}"))
    return sorted(result, key=lambda item: -item[0])


def settle_without_outliers(
    measurements: Measurements,
    causes: tuple[str, ...],
    start: dict[str, float] | None,
    fitted: Fit | None = None,
) -> tuple[Fit, State, list[Excluded]]:
    """Fit, estimate the scatter, set the worst outliers aside; repeat until none is left."""
    keep = np.ones(len(measurements.y), bool)
    excluded: list[Excluded] = []
    runs = {
        p: len(set(measurements.run[measurements.protocol == p]))
        for p in np.unique(measurements.protocol)
    }
    budget = {p: max(1, int(1.5 * OUTLIER_FRACTION * n + 0.5)) for p, n in runs.items()}
    in_all = max(1, int(OUTLIER_FRACTION * sum(runs.values()) + 0.5))
    spent = {p: [0, 0] for p in runs}  # whole runs, single features
    if fitted is None:
        fitted = _first_fit(measurements, causes, keep, start)
    state = settle(measurements, fitted, keep)
    for _ in range(6):
        new, seen = [], set()
        for outlier in find_outliers(measurements, fitted, state):
            # An outlier bends the level of its specimen: its siblings are judged without it.
            specimen = measurements.specimen[outlier.features[0]]
            if specimen in seen:
                continue
            seen.add(specimen)
            protocol = measurements.protocol[outlier.features[0]]
            whole = keep & (measurements.run == measurements.run[outlier.features[0]])
            kind = int(len(outlier.features) < whole.sum())
            total = sum(count[kind] for count in spent.values())
            room = spent[protocol][kind] < budget[protocol] and total < in_all
            if room and keep[outlier.features].all():
                spent[protocol][kind] += 1
                new.append(outlier)
            if len(new) >= 3:
                break
        fitted = fit(measurements, state.weights, causes, fitted.as_dict())
        if not new:
            break
        for outlier in new:
            keep[outlier.features] = False
        excluded += new
        state = settle(measurements, fitted, keep, state.scatters)
        fitted = fit(measurements, state.weights, causes, fitted.as_dict())
    state = settle(measurements, fitted, keep, state.scatters)
    fitted = fit(measurements, state.weights, causes, fitted.as_dict())
    return fitted, state, excluded


def _first_fit(measurements, causes, keep, start) -> Fit:
    """A fit with usual scatters; sensitivities from a first guess of the coefficients."""
    fitted = None
    values = dict(start or {})
    for _ in range(2):
        named = {p.name: values.get(p.name, p.null) for p in measurements.null_parameters}
        base = measurements.predict(named, ())
        moved = measurements.predict({k: v + 0.01 for k, v in named.items()}, ())
        sensitivity = (moved - base) / 0.01
        groups = make_groups(
            measurements.protocol,
            measurements.run,
            measurements.specimen,
            measurements.u,
            sensitivity,
            keep & ~measurements.lower_bound,
        )
        scatters = {g.protocol: START_SCATTER for g in groups}
        weights = Weights.build(groups, scatters, measurements, sensitivity, keep)
        fitted = fit(measurements, weights, causes, values)
        values = fitted.as_dict()
    return fitted


def _observations(measurements: Measurements, keep: np.ndarray) -> int:
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
    cost = extra * np.log(max(_observations(measurements, state.keep), 2))
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


def test_at(
    measurements: Measurements,
    fitted: Fit,
    state: State,
    rng: np.random.Generator,
    replicates: int,
) -> Outcome:
    """Tests of everything beyond the fitted model."""
    residual = measurements.y - fitted.prediction
    return run_tests(
        state.tests,
        fitted.jacobian,
        residual,
        state.groups,
        state.scatters,
        state.rich,
        rng,
        replicates,
    )


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
    null, null_state, excluded = settle_without_outliers(measurements, (), None)
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
    runs = _observations(measurements, null_state.keep)
    specimens = len(np.unique(measurements.specimen[null_state.keep]))
    few = runs < SMALLEST_RUNS or specimens < SMALLEST_SPECIMENS
    if runs < LEAST_RUNS or specimens < 2 or (few and global_p > SIGNIFICANCE):
        why = (
            f"{runs} runs of {specimens} specimens; at least {SMALLEST_RUNS} of "
            f"{SMALLEST_SPECIMENS} are needed"
        )
        return result("insufficient", why=why)
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
        _, state, excluded = settle_without_outliers(measurements, best.causes, None, best.fitted)
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
    left_state = settle(measurements, best.fitted, state.keep, state.scatters)
    left = test_at(measurements, best.fitted, left_state, rng, replicates)
    pairs = _pairs(measurements, state, base, singles, left, left_state, inflation, rng)
    accepted = [p for p in pairs if _pair_counts(p, singles)]
    ranking = sorted(singles + pairs, key=lambda c: c.bic)
    chosen = best
    if accepted and accepted[0].bic < best.bic:
        chosen = accepted[0]
        left_state = settle(measurements, chosen.fitted, state.keep, state.scatters)
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
    if chosen.credit < MODERATE and not _explains(outcome, chosen, measurements, state):
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


def _explains(outcome: Outcome, chosen: Candidate, measurements, state) -> bool:
    """Does the chosen model beat the best generic shape (its place or period counted)?

    For moderate effects only: the score test of a shape says little far from the null, and a
    shape that beats a strong cause leaves structure behind.
    """
    runs = np.log(max(_observations(measurements, state.keep), 2))
    best = np.inf
    for i, test in enumerate(outcome.tests):
        if test.family != "generic" or not np.isfinite(outcome.log_p[i]):
            continue
        best = min(best, (outcome.degrees[i] + test.scanned) * runs - outcome.statistic[i])
    return chosen.bic <= best + 2.0


def _pair_counts(pair: Candidate, singles: list[Candidate]) -> bool:
    """Is the second mechanism significant beside the better of the two alone (Bonferroni)?"""
    alone = [c for c in singles if c.causes[0] in pair.causes]
    if not alone:
        return False
    top = max(alone, key=lambda c: c.credit)
    extra = len(pair.fitted.parameters) - len(top.fitted.parameters)
    threshold = chi_square.isf(PAIR_SIGNIFICANCE / max(len(singles) - 1, 1), max(extra, 1))
    return pair.credit - top.credit > threshold and pair.bic < top.bic


def _pairs(measurements, state, base, singles, left, left_state, inflation, rng, most=5):
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
            other = settle_fast(measurements, single.fitted, state)
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


def settle_fast(measurements, fitted, state) -> list[Test]:
    """Mechanism tests beside another fitted model, at the scatter already known."""
    found = alternatives(measurements, fitted, state.keep)
    return [test for test in found.tests if test.family == "mechanism"]
