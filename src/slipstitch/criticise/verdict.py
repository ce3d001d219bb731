"""The verdict on the model: an ordered list of rules over the evidence; the first that applies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from slipstitch.criticise.causes import ZEROS, DataFinding, Zero
from slipstitch.criticise.covariates import COVARIATES
from slipstitch.criticise.inference import candidates
from slipstitch.criticise.inference.candidates import Candidate
from slipstitch.criticise.inference.evidence import Evidence
from slipstitch.criticise.inference.faulty_data import noise_findings, zero_findings
from slipstitch.criticise.inference.rivals import TITLES
from slipstitch.criticise.inference.state import State, refit
from slipstitch.criticise.inference.structure import SIGNIFICANCE, Outcome
from slipstitch.criticise.measurements import Measurements
from slipstitch.physics.friction_law import CONTACT_MECHANISMS

# Fewer runs or specimens than these cannot clear the null; fewer than the least, nothing at all.
SMALLEST_RUNS, SMALLEST_SPECIMENS, LEAST_RUNS = 8, 3, 5
# BIC of the best explanation relative to plain friction from where on it may be named.
WORTH_NAMING = -2.0
# Stated uncertainties may be 1.5 times too small; readings of one run that disagree by more than
# this hold an effect that differs within runs.
LARGEST_INSTRUMENT_FACTOR = 1.8
# A sensor whose noise is a finding may have heavy tails as well: the standard deviation of
# Student's t of 3 degrees is 1.5 times the one that its median tells.
HEAVY_TAILS = 1.5
# Gain in log-likelihood from where on zeros may stand where a cause should.
ZEROS_NEEDED = 4.0


@dataclass(frozen=True)
class Rule:
    """A rule of the verdict.

    Attributes
    ----------
    name, verdict : of the rule, and the verdict that it gives.
    says : what the rule says, for the documentation.
    reason : of the verdict where the rule applies, None where it does not.
    of_best : the best explanation is reported, not plain friction.
    """

    name: str
    verdict: str
    says: str
    reason: Callable[[Evidence], str | None]
    of_best: bool = False


RULES: list[Rule] = []


def _rule(name: str, verdict: str, says: str, of_best: bool = False):
    """Enter a function of the evidence, which gives the reason, as the next rule."""

    def entered(reason: Callable[[Evidence], str | None]):
        RULES.append(Rule(name, verdict, says, reason, of_best))
        return reason

    return entered


_of_best = partial(_rule, of_best=True)


@_rule(
    "too few runs",
    "insufficient",
    f"Fewer than {LEAST_RUNS} runs or 2 specimens; or fewer than {SMALLEST_RUNS} runs or "
    f"{SMALLEST_SPECIMENS} specimens, and nothing significant.",
)
def _too_few(e: Evidence) -> str | None:
    m = e.measurements
    few = m.runs < SMALLEST_RUNS or m.specimens < SMALLEST_SPECIMENS
    if m.runs < LEAST_RUNS or m.specimens < 2 or (few and not e.is_significant):
        return (
            f"{m.runs} runs of {m.specimens} specimens; at least {SMALLEST_RUNS} of "
            f"{SMALLEST_SPECIMENS} are needed"
        )
    return None


@_rule("another unit", "insufficient", "Readings or sizes that no cloth and no bench has.")
def _another_unit(e: Evidence) -> str | None:
    return "; ".join(e.measurements.implausible) or None


@_rule("only bounds", "insufficient", "Every reading is only a bound.")
def _only_bounds(e: Evidence) -> str | None:
    return "every reading is only a bound" if e.measurements.lower_bound.all() else None


@_rule(
    "blind design",
    "insufficient",
    "Nothing is significant, and not even an effect that doubles the friction would be seen.",
)
def _blind(e: Evidence) -> str | None:
    seen = [e.detectable[name].on_friction for name in e.detectable if name in CONTACT_MECHANISMS]
    if e.is_significant or min(seen, default=np.inf) < np.log(2):
        return None
    return "not even an effect that doubles the friction would have been seen"


@_rule(
    "nothing significant", "none", f"The family-wise p of plain friction is above {SIGNIFICANCE}."
)
def _nothing(e: Evidence) -> str | None:
    return None if e.is_significant else ""


@_rule("nothing to test", "unknown", "No mechanism can be tested with these data.")
def _nothing_to_test(e: Evidence) -> str | None:
    return None if e.screened else "no mechanism can be tested with these data"


@_rule(
    "no gain",
    "unknown",
    f"The BIC of the best explanation, relative to plain friction, is above {WORTH_NAMING:g}.",
)
def _no_gain(e: Evidence) -> str | None:
    if e.best.chosen.bic > WORTH_NAMING:
        return "no mechanism improves on the null by enough to be named"
    return None


@_of_best(
    "structure left",
    "unknown",
    "What the best explanation leaves has a family-wise p below "
    f"{candidates.LEFTOVER_SIGNIFICANCE}, and beside that its credit is below "
    f"{candidates.STANDS_BESIDE:g}.",
)
def _structure_left(e: Evidence) -> str | None:
    best = e.best
    explained = best.left.global_p >= candidates.LEFTOVER_SIGNIFICANCE
    if explained or candidates.stands_beside(best.chosen, best.left, best.judge):
        return None
    return "structure is left that no one or two mechanisms remove"


@_of_best(
    "structure left along its own covariate",
    "unknown",
    "What is left has a shape along the covariate of a cause that is significant by itself "
    f"(p below {candidates.OWN_SIGNIFICANCE:g}), and more than {100 * candidates.FORM_SHARE:g} % "
    "of its credit.",
)
def _left_along_own(e: Evidence) -> str | None:
    covariate = candidates.left_along_own(e.best.chosen, e.best.left)
    if covariate is None:
        return None
    return f"structure is left along the {COVARIATES[covariate].title}, which the cause acts by"


@_of_best(
    "size may be zero", "unknown", "The 95 % interval of a cause's size contains that of no effect."
)
def _may_be_nothing(e: Evidence) -> str | None:
    unsure = e.unsure(e.best.chosen)
    return f"the size of {' and '.join(unsure)} may be zero" if unsure else None


@_of_best(
    "differs within runs",
    "unknown",
    f"Readings of one run disagree by more than {LARGEST_INSTRUMENT_FACTOR} times their stated "
    f"uncertainty ({LARGEST_INSTRUMENT_FACTOR * HEAVY_TAILS:g} where a sensor is found noisy), "
    f"and the credit is below {candidates.STANDS_BESIDE:g}.",
)
def _differs_within_runs(e: Evidence) -> str | None:
    tails = {finding.protocol: HEAVY_TAILS for finding in noise_findings(e.measurements)}
    kappas = {name: scatter.kappa for name, scatter in e.best.state.scatters.items()}
    noisy = [p for p in kappas if kappas[p] > LARGEST_INSTRUMENT_FACTOR * tails.get(p, 1.0)]
    if not noisy or e.best.chosen.credit >= candidates.STANDS_BESIDE:
        return None
    protocol = max(noisy, key=kappas.__getitem__)
    return (
        f"readings of one run of {protocol} disagree by {kappas[protocol]:.1f} times their "
        "stated uncertainty: something differs within runs"
    )


@_of_best(
    "driver not recorded",
    "unknown",
    "Another mechanism would do the same, and what drives that one was not recorded.",
)
def _driver_not_recorded(e: Evidence) -> str | None:
    for cause in e.best.chosen.causes:
        if alias := e.measurements.unrecorded_alias(cause):
            return (
                f"{cause} would explain it, but what would drive {alias} instead was not recorded"
            )
    return None


@_of_best(
    "a free shape is better",
    "unknown",
    "A shape outside the library describes the data better than any mechanism.",
)
def _free_shape(e: Evidence) -> str | None:
    if candidates.explains(e.null_outcome, e.best.chosen, e.measurements):
        return None
    return "a shape outside the library describes the data better than any mechanism"


@_of_best(
    "a rival takes the evidence",
    "confounded",
    "Beside a drift with time, memory of the run before, or the place on the track, the "
    "evidence for a cause is gone.",
)
def _taken(e: Evidence) -> str | None:
    if not e.taken:
        return None
    return (
        f"beside {' or '.join(TITLES[name] for name in e.takers)} its evidence is gone; "
        "runs in a random order would tell"
    )


@_of_best(
    "tied", "confounded", f"Another explanation is within {candidates.TIE_BIC:g} units of BIC."
)
def _tied(e: Evidence) -> str | None:
    return "" if len(e.ties) > 1 else None


@_of_best("named", "cause", "None of the above.")
def _named(e: Evidence) -> str | None:
    return ""


class Analysis(Evidence):
    """The evidence, the rule that applies, and why: all that verdict, report, prediction need."""

    @cached_property
    def _judged(self) -> tuple[Rule, str]:
        reasons = ((rule, rule.reason(self)) for rule in RULES)
        return next((rule, reason) for rule, reason in reasons if reason is not None)

    @property
    def rule(self) -> Rule:
        """The first rule that applies; the last one always does."""
        return self._judged[0]

    @property
    def reason(self) -> str:
        """What the rule says of these data."""
        return self._judged[1]

    @property
    def verdict(self) -> str:
        """One of none, cause, confounded, unknown, insufficient."""
        return self.rule.verdict

    @property
    def causes(self) -> tuple[str, ...]:
        """The causes that are named."""
        return self.explanation.causes if self.explanation and self.verdict == "cause" else ()

    @cached_property
    def alternatives(self) -> list[tuple[str, ...]]:
        """Every set of causes that is possible."""
        if not self.explanation:
            return []
        if self.verdict == "cause" or not self.taken:
            return self.ties
        kept = tuple(c for c in self.best.chosen.causes if c not in self.taken)
        return [*self.ties, *((*kept, name) for name in self.takers)]

    @property
    def chosen(self) -> Candidate | None:
        """The best explanation, where the rule is about it."""
        return self.best.chosen if self.rule.of_best else None

    @property
    def explanation(self) -> Candidate | None:
        """The best explanation, where it is named, alone or among others."""
        return self.chosen if self.verdict in ("cause", "confounded") else None

    @property
    def state(self) -> State:
        """Scatter and tests beside the chosen explanation, or beside plain friction."""
        return self.best.state if self.rule.of_best else self.null_state

    @property
    def left_over(self) -> Outcome | None:
        """Tests of what is left, where something is."""
        if self.rule.of_best:
            return self.best.left
        return self.null_outcome if self.verdict == "unknown" else None

    @cached_property
    def data_findings(self) -> list[DataFinding]:
        """What is wrong with the data themselves."""
        m = self.measurements
        return [*m.findings, *noise_findings(m), *zero_findings(self.state)]


def analyse(measurements: Measurements, seed: int = 1, replicates: int = 300) -> Analysis:
    """Reach a verdict; the same data and seed give the same one.

    ``replicates`` simulated data sets are behind every family-wise p.
    """
    found = Analysis(measurements, seed, replicates)
    tares = _unsure_tares(found)
    if tares:
        measurements = replace(measurements, further_zeros=tares)
        found = Analysis(measurements, seed, replicates)
    if found.verdict != "none" or not measurements.zeros:
        return found
    # Zeros may have taken a cause's place: does one explain the data as well without them?
    state = found.null_state
    null, sound = found.null, replace(state.measurements, sound_sensors=True)

    def likelihood(of: Measurements, causes=(), start=null, scatters=state.scatters) -> float:
        return refit(of, causes, start, scatters, state.sensitivity).log_likelihood

    zeros, plain = likelihood(state.measurements), likelihood(sound)
    if zeros - plain < ZEROS_NEEDED:
        return found
    other = Analysis(replace(measurements, sound_sensors=True), seed, replicates)
    promise = -min((c.bic for c in other.screened), default=0.0)
    if not other.is_significant or plain + promise < zeros + 0.5 * candidates.TIE_BIC:
        return found  # not even if the fit gains twice what its linear test promises
    chosen = other.explanation
    if chosen is None or len(chosen.causes) > 1:
        return found  # two causes in the place of zeros are no simpler than these
    without = likelihood(sound, chosen.causes, chosen.fitted, chosen.scatters)
    extra = len(chosen.fitted.values) - len(null.values)
    without -= 0.5 * extra * np.log(max(measurements.runs, 2))
    # Where zeros explain it about as well, nothing is said: of campaigns that hold nothing, a
    # quarter would be said to hold something, and none of the bench's effects was found by it.
    return other if without >= zeros + 0.5 * candidates.TIE_BIC else found


def _unsure_tares(found: Analysis) -> tuple[tuple[str, Zero], ...]:
    """Zeros of cells that drift, where an offset is blamed.

    A drift is counted from the middle of the session; when the cell read right is not known, so
    that it is off there by up to what it drifts in half the session.
    """
    blamed = {cause for causes in found.alternatives for cause in causes}
    blamed |= set(found.chosen.causes if found.chosen else ())
    if "force_offset" not in blamed:
        return ()
    drift, blocks = ZEROS["force_drift_N_h"], found.measurements.blocks
    hours = {b.protocol: np.abs(b.hours()).max(initial=0.0) for b in blocks}
    name, quantity = "force_offset_N", "zero of the drifting force"
    return tuple(
        (
            of.protocol,
            Zero(name, of.sensor, quantity, "mN", 1e-3, float(abs(of.size) * hours[of.protocol])),
        )
        for of in found.data_findings
        if of.quantity == drift.quantity
    )
