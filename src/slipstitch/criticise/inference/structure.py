"""Tests for structure in residuals, and their family-wise error from simulated maxima."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtrc, gammaln, log_ndtr
from scipy.stats import beta

# The family-wise error, and its shares.
SIGNIFICANCE = 0.04
ERROR_WEIGHTS = {"mechanism": 0.6, "generic": 0.4}
SMALLEST_INFLATION = 0.5
# A p from simulations is clear of a limit that this interval of it leaves out.
CLEAR = (0.005, 0.995)


@dataclass(frozen=True)
class Test:
    """One alternative: columns over all features, beside nuisance columns that cost nothing.

    Attributes
    ----------
    mechanism : identifier, if it is a mechanism's own effect; otherwise a generic ``shape`` (in
        words) along a ``covariate``.
    scanned : one of a row of shapes that differ by their place or period.
    spanned : its columns are combinations of other tests' columns.
    protocol : in which it is looked for; None: in all of them together.
    one_sided : its one column may only be added: a mechanism that cannot be negative.
    """

    columns: np.ndarray
    nuisance: np.ndarray | None = None
    mechanism: str | None = None
    covariate: str | None = None
    shape: str = ""
    scanned: bool = False
    spanned: bool = False
    protocol: str | None = None
    one_sided: bool = False

    @property
    def family(self) -> str:
        """Within which the error is controlled."""
        return "generic" if self.mechanism is None else "mechanism"


@dataclass
class Outcome:
    """Result of a set of tests.

    ``statistic`` is divided by ``inflation`` (its simulated mean over the degrees of freedom).
    ``exceeded`` of the ``replicates`` largest statistics (``largest``, -log10 p) were above the
    best of each family. ``information``: of a test's columns where the design knows least.
    """

    tests: list[Test]
    statistic: np.ndarray
    degrees: np.ndarray
    inflation: np.ndarray
    log_p: np.ndarray
    adjusted: np.ndarray
    family_p: dict[str, float]
    exceeded: dict[str, int]
    replicates: int
    largest: dict[str, np.ndarray] = field(default_factory=dict)
    information: np.ndarray | None = None

    @property
    def global_p(self) -> float:
        """Family-wise p over mechanisms and shapes, Bonferroni-weighted between the two."""
        weighted = (self.family_p.get(name, 1.0) / w for name, w in ERROR_WEIGHTS.items())
        return float(min(1.0, *weighted))

    def is_clear(self, limits: tuple[float, ...]) -> bool:
        """Would more simulations leave the global p on the same side of all limits?"""
        name = min(self.family_p, key=lambda n: self.family_p[n] / ERROR_WEIGHTS[n], default=None)
        if name is None:
            return True
        above, count = self.exceeded[name], self.replicates
        low = beta.ppf(CLEAR[0], above, count - above + 1) if above else 0.0
        high = beta.ppf(CLEAR[1], above + 1, count - above)
        if not above and self.family_p[name] < 0.1 / (count + 1):
            high = 0.0  # far beyond all that was simulated
        weight = ERROR_WEIGHTS[name]
        return not any(low <= limit * weight <= high for limit in limits)

    def mechanism_inflation(self) -> dict[str, float]:
        """Largest inflation of every mechanism's tests in all protocols together."""
        result: dict[str, float] = {}
        for test, value in zip(self.tests, self.inflation, strict=True):
            if test.mechanism is not None and test.protocol is None:
                result[test.mechanism] = max(result.get(test.mechanism, 1.0), float(value))
        return result

    def strongest_by(self, key: Callable[[Test], str | None]) -> dict[str, int]:
        """Index of the most significant test of each key; tests without a key are left out."""
        best: dict[str, int] = {}
        for i, test in enumerate(self.tests):
            name = key(test) if np.isfinite(self.log_p[i]) else None
            if name is not None and (name not in best or self.log_p[i] > self.log_p[best[name]]):
                best[name] = i
        return best

    def strongest_shapes(self) -> dict[str, int]:
        """Index of the most significant shape along each covariate."""
        return self.strongest_by(lambda test: None if test.mechanism else test.covariate)

    def strongest(self, family: str) -> int | None:
        """Index of the most significant test of a family."""
        return self.strongest_by(lambda test: test.family).get(family)


def outcome_of(
    tests: list[Test], observed: np.ndarray, simulated: np.ndarray, degrees: np.ndarray
) -> Outcome:
    """Outcome of statistics (tests,) by those of simulated data sets (replicates, tests)."""
    replicates = len(simulated)
    usable = degrees > 0
    safe = np.maximum(degrees, 1)
    # Half of the data sets pull a column that may only be added the other way.
    usual = safe * np.where([test.one_sided for test in tests], 0.5, 1.0)
    inflation = np.maximum(simulated.mean(axis=0) / usual, SMALLEST_INFLATION)
    log_p = minus_log10_p(observed / inflation, safe)
    log_null = minus_log10_p(simulated / inflation, safe[None, :])
    log_p = np.where(usable, log_p, -np.inf)
    log_null[:, ~usable] = -np.inf
    adjusted = np.ones(len(tests))
    family_p: dict[str, float] = {}
    exceeded: dict[str, int] = {}
    maxima: dict[str, np.ndarray] = {}
    for family in dict.fromkeys(test.family for test in tests):
        mine = np.array([test.family == family for test in tests]) & usable
        if not mine.any():
            family_p[family], exceeded[family] = 1.0, replicates
            continue
        largest = np.sort(log_null[:, mine].max(axis=1))
        above = len(largest) - np.searchsorted(largest, log_p[mine] - 1e-12)
        adjusted[mine] = (1 + above) / (1 + replicates)
        # Beyond the simulated maxima, Bonferroni by the tests' effective number.
        count = 10.0 ** np.median(largest) * np.log(2.0)
        tail = np.minimum(1.0, max(count, 1.0) * 3 * 10.0 ** -log_p[mine])
        adjusted[mine] = np.where(above == 0, np.minimum(adjusted[mine], tail), adjusted[mine])
        family_p[family], exceeded[family] = float(adjusted[mine].min()), int(above.min())
        maxima[family] = largest
    return Outcome(
        tests,
        observed / inflation,
        degrees,
        inflation,
        log_p,
        adjusted,
        family_p,
        exceeded,
        replicates,
        maxima,
    )


def minus_log10_p(statistic, degrees):
    """-log10 of the upper tail of chi squared; of many degrees by its leading term far out."""
    x, degrees = np.broadcast_arrays(np.maximum(statistic, 0.0), np.asarray(degrees))
    found = np.where(degrees == 1, np.log(2.0) + log_ndtr(-np.sqrt(x)), -0.5 * x)
    more = degrees > 2
    if more.any():
        own, half = x[more], 0.5 * degrees[more]
        far = own > 400.0
        with np.errstate(divide="ignore"):
            exact = np.log(chdtrc(2 * half, np.where(far, 1.0, own)))
            tail = (half - 1) * np.log(np.maximum(own, 1.0) / 2) - own / 2 - gammaln(half)
        found[more] = np.where(far, tail, exact)
    return -found / np.log(10.0)
