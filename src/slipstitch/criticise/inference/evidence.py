"""What the data say of the model, each piece found once, when a rule of the verdict asks for it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from slipstitch.criticise.inference import candidates
from slipstitch.criticise.inference.candidates import Candidate, Judge
from slipstitch.criticise.inference.certificate import Detectable, smallest_detectable
from slipstitch.criticise.inference.faulty_data import robust_fit
from slipstitch.criticise.inference.fit import Fit, Weights, fit
from slipstitch.criticise.inference.intervals import Intervals
from slipstitch.criticise.inference.rivals import taken_by_rivals
from slipstitch.criticise.inference.state import State
from slipstitch.criticise.inference.structure import SIGNIFICANCE, Outcome
from slipstitch.criticise.measurements import Measurements, Outlier

# Explanations beside which outliers are looked for.
MOST_BESIDE = 3


@dataclass(frozen=True)
class Best:
    """The best explanation: one or two mechanisms with their scatter, and tests of what they leave.

    ``ranking`` has every candidate that was fitted, by BIC, ``rivals`` those that may stand in its
    place.
    """

    chosen: Candidate
    state: State
    left: Outcome
    judge: Judge
    ranking: list[Candidate]
    rivals: list[Candidate]


@dataclass(frozen=True)
class Evidence:
    """Of one case. The seed is that of the simulated maxima, ``replicates`` their number."""

    measurements: Measurements
    seed: int
    replicates: int

    @cached_property
    def _rng(self) -> np.random.Generator:
        return np.random.default_rng(self.seed)

    @cached_property
    def null_state(self) -> State:
        """Scatter and tests beside plain friction."""
        return robust_fit(self.measurements)

    @property
    def null(self) -> Fit:
        """Plain friction."""
        return self.null_state.fitted

    @cached_property
    def null_outcome(self) -> Outcome:
        """Tests of everything beyond plain friction."""
        most = candidates.MOST_ROUNDS * self.replicates
        return self.null_state.outcome(self._rng, most, (SIGNIFICANCE,))

    @property
    def is_significant(self) -> bool:
        """Is anything beyond plain friction significant?"""
        return self.null_outcome.global_p <= SIGNIFICANCE

    @cached_property
    def detectable(self) -> dict[str, Detectable]:
        """The smallest effect of every mechanism that would have been seen, and named."""
        return smallest_detectable(self.null_state, self.null_outcome)

    @cached_property
    def screened(self) -> list[Candidate]:
        """Single mechanisms by their ratio beside the null, none fitted."""
        return candidates.linear_ranking(self.null_state, self.null_outcome)

    @property
    def excluded(self) -> tuple[Outlier, ...]:
        """Outliers beside the null, or beside the best explanation if that was looked for."""
        state = self.best.state if "best" in self.__dict__ else self.null_state
        return state.measurements.outliers

    @property
    def ranking(self) -> list[Candidate]:
        """Candidates by BIC: those that were fitted, or screened only."""
        return self.best.ranking if "best" in self.__dict__ else self.screened

    @cached_property
    def best(self) -> Best:
        """Fit what is promising, one and two at a time, and test what the best of all leaves."""
        judge, singles, m = self._singles()
        rng = self._rng
        chosen, state, left = judge.tested(singles[0], m, rng, self.replicates)
        pairs = candidates.fitted_pairs(judge, singles, left)
        accepted = [p for p in pairs if candidates.second_is_significant(p, singles, left)]
        accepted = [p for p in accepted if not self.unsure(p)]
        ranking = sorted(singles + pairs, key=lambda c: c.bic)
        if accepted and accepted[0].bic < chosen.bic:
            chosen, state, left = judge.tested(accepted[0], m, rng, self.replicates)
            accepted[0] = chosen
        ranking = [chosen if c.causes == chosen.causes else c for c in ranking]
        rivals = [chosen if c.causes == chosen.causes else c for c in singles]
        rivals += accepted if len(chosen.causes) == 2 else []
        return Best(chosen, state, left, judge, ranking, rivals)

    def _singles(self) -> tuple[Judge, list[Candidate], Measurements]:
        """Single mechanisms fitted in full, by BIC, beside outliers and the laws' own error.

        And the measurements, outliers allowed for, without the laws' own error.
        """
        null, state = self.null, self.null_state
        m = state.measurements
        inflation = self.null_outcome.mechanism_inflation()
        judge = Judge(m, null, state.scatters, inflation)
        ranking = judge.ranked(candidates.promising(self.screened))
        # Outliers are judged again beside the best model: what the null could not explain, it may.
        beside: set[tuple[str, ...]] = set()
        while ranking[0].bic < -2 and ranking[0].causes not in beside and len(beside) < MOST_BESIDE:
            best = ranking[0]
            beside.add(best.causes)
            found = robust_fit(self.measurements, best.causes, best.fitted).measurements
            if not np.array_equal(found.usual, m.usual):
                m = found
                weights = Weights(m, state.sensitivity, state.scatters)
                base = fit(m, weights, (), null.as_dict())
                judge = Judge(m, base, state.scatters, inflation)
                ranking = judge.ranked(ranking, fitted=True)
        imprecise = candidates.with_law_error(m, ranking[0].fitted)
        if imprecise is not m:
            judge = replace(judge, measurements=imprecise, bases={})
            ranking = judge.ranked(ranking, fitted=True)
        return judge, ranking, m

    def intervals(self, fitted: Fit) -> Intervals:
        """The parameters of a fit."""
        inflation = self.null_outcome.mechanism_inflation()
        return Intervals(fitted, self.measurements.specimens, inflation)

    def unsure(self, candidate: Candidate) -> list[str]:
        """Causes of a candidate that may have no size at all."""
        found = self.intervals(candidate.fitted)
        return [cause for cause in candidate.causes if found.may_be_nothing(cause)]

    @cached_property
    def taken(self) -> dict[str, list[str]]:
        """Causes of the best explanation whose evidence a rival takes, with the rivals."""
        return taken_by_rivals(self.null_state, self.best.state)

    @property
    def takers(self) -> list[str]:
        """The rivals that take evidence."""
        return list(dict.fromkeys(name for names in self.taken.values() for name in names))

    @cached_property
    def ties(self) -> list[tuple[str, ...]]:
        """The best explanation and those that the data do not tell from it."""
        best = self.best
        tied = candidates.tied_with(best.chosen, best.rivals, best.judge, best.state)
        return [best.chosen.causes, *(c.causes for c in tied)]

    def untestable(self) -> dict[str, str]:
        """Mechanisms that these data cannot tell, and why."""
        tested = {test.mechanism for test in self.null_state.tests if test.mechanism}
        alike = "cannot be distinguished from the friction coefficient with these data"
        told = candidates.testable(self.null_outcome)
        return self.null_state.untestable | dict.fromkeys(tested - told, alike)
