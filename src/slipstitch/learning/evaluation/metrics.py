"""The metrics of the tables: name, unit, computation and formatting.

`METRICS` is the only place that lists them. What a model says of videos, beside what is true, comes
as `PredictionsAndTruth`; pages and terminal take headings and numbers from the rows of the list.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slipstitch.base.page.wording import aligned, number, percent

TEST_SETS, CAPTURES = "test sets", "captures"
#: Of the paper's grid of mu, in which errors are counted.
STEP = 0.1


@dataclass(frozen=True)
class PredictionsAndTruth:
    """Predictions of a trained model for n videos, and the truth; None where not predicted."""

    # (n,): predicted and true friction coefficients
    friction: np.ndarray | None = None
    reference: np.ndarray | None = None
    # (n,): the reference is an interval of this half width; 0 of simulated videos
    reference_error: np.ndarray | float = 0.0
    intervals: np.ndarray | None = None  # (n, 2): of the prediction
    # videos of one group are right or wrong together; by default each is its own
    groups: Sequence[str] | None = None
    alarms: np.ndarray | None = None  # (n,) bool
    # (p,): of each pair of captures: error of the median, whether the repeats are told equal
    pair_errors: np.ndarray | None = None
    pair_agrees: np.ndarray | None = None
    # (m,): place of the true fabric among the guesses, 0 the first, of videos whose fabric is known
    fabric_rank: np.ndarray | None = None

    @cached_property
    def off(self) -> np.ndarray:
        """Distance of the predictions from the references' intervals."""
        return distance(self.friction, self.reference, self.reference_error)

    def share_off(self, errors: np.ndarray, steps: int) -> float:
        """Share of errors of at most so many grid steps."""
        return float((steps_off(errors, np.zeros_like(errors)) <= steps).mean())

    @cached_property
    def coverage(self) -> tuple[float, float]:
        """Share of references that their intervals meet, each group counting once; its error."""
        low, high = self.intervals.T
        each = [str(place) for place in range(len(low))]
        return covered(
            low - self.reference_error,
            high + self.reference_error,
            self.reference,
            each if self.groups is None else self.groups,
        )


@dataclass(frozen=True)
class Metric:
    """One row of the list."""

    name: str  # its key in metrics.json
    kind: str  # what it is computed from; ``capture``: references with errors, and pairs
    unit: str  # shares are 0 ... 1 in files and shown in %
    compute: Callable[[PredictionsAndTruth], float]  # `PredictionsAndTruth` -> float
    heading: str  # of a column of a page
    # where it is shown. Those of TEST_SETS make up an entry of evaluate/metrics.json.
    tables: frozenset[str] | set[str]
    column: str = ""  # of the terminal's table; empty where it is not in it
    title: str = ""  # in words, for a row of its own

    def shown(self, scores: Mapping[str, Any], spread: Mapping[str, Any] | None = None) -> str:
        """Its mean ± spread over seeds, of entries that may lack it."""
        write = percent if self.unit == "%" else number
        return write(scores.get(self.name), (spread or {}).get(self.name))


def _within_a_tenth(errors: np.ndarray) -> float:
    return float((errors <= 0.1 + 1e-9).mean())


# fmt: off
METRICS = (
    Metric("friction_lt_0.1", "friction", "%", lambda a: a.share_off(a.off, 0),
           "< 0.1", {TEST_SETS, CAPTURES}, "< 0.1", "Friction, error < 0.1"),
    Metric("friction_lt_0.2", "friction", "%", lambda a: a.share_off(a.off, 1),
           "< 0.2", {TEST_SETS, CAPTURES}, "< 0.2", "Friction, error < 0.2"),
    Metric("within_0.1", "capture", "%", lambda a: _within_a_tenth(a.off),
           "within 0.1", {CAPTURES}),
    # From the reference itself, not from its interval.
    Metric("mean_absolute_error", "friction", "µ",
           lambda a: float(np.abs(a.friction - a.reference).mean()),
           "|error|", {TEST_SETS, CAPTURES}, "|error|"),
    Metric("mean_distance", "capture", "µ", lambda a: float(a.off.mean()),
           "distance", frozenset()),
    Metric("median_error", "capture", "µ", lambda a: float(a.pair_errors.mean()),
           "error of medians", {CAPTURES}, "medians"),
    Metric("median_lt_0.1", "capture", "%", lambda a: a.share_off(a.pair_errors, 0),
           "medians < 0.1", {CAPTURES}),
    # As the paper counts real films: five equal answers or, else, their median.
    Metric("median_within_0.1", "capture", "%", lambda a: _within_a_tenth(a.pair_errors),
           "medians within 0.1", {CAPTURES}),
    Metric("equal_predictions", "capture", "%", lambda a: float(a.pair_agrees.mean()),
           "all repeats equal", {CAPTURES}, "equal"),
    Metric("material_top1", "fabric", "%", lambda a: float((a.fabric_rank < 1).mean()),
           "fabric, first", {TEST_SETS, CAPTURES}, "top-1", "Material, top 1"),
    Metric("material_top2", "fabric", "%", lambda a: float((a.fabric_rank < 2).mean()),
           "first two", {TEST_SETS}, "top-2", "Material, top 2"),
    Metric("coverage_90", "interval", "%", lambda a: a.coverage[0],
           "in 90 % interval", {TEST_SETS, CAPTURES}, "cover"),
    Metric("interval_width", "interval", "µ",
           lambda a: float((a.intervals[:, 1] - a.intervals[:, 0]).mean()),
           "its width", {TEST_SETS, CAPTURES}, "width"),
    Metric("alarms", "interval", "%", lambda a: float(a.alarms.mean()),
           "alarms", {CAPTURES}),
)
# fmt: on
BY_NAME = {metric.name: metric for metric in METRICS}


def metrics_of(table: str, *kinds: str) -> list[Metric]:
    """Rows of the list that a table shows; those of some kinds only, if kinds are given."""
    return [
        metric
        for metric in METRICS
        if table in metric.tables and (not kinds or metric.kind in kinds)
    ]


# Every entry of metrics.json has all of these; null where the model does not give the quantity.
FIELDS = ("n", *(metric.name for metric in metrics_of(TEST_SETS)), "seeds")


def scores_of(
    answers: PredictionsAndTruth, *kinds: str, table: str | None = None
) -> dict[str, float]:
    """Name -> score of all metrics of some kinds, of one table's if it is given."""
    return {
        metric.name: metric.compute(answers)
        for metric in METRICS
        if metric.kind in kinds and (table is None or table in metric.tables)
    }


def covered(
    low: np.ndarray, high: np.ndarray, truth: np.ndarray, groups: Sequence[str]
) -> tuple[float, float]:
    """Share of truths inside their intervals, each group counting once, and its standard error."""
    inside = (low - 1e-12 <= truth) & (truth <= high + 1e-12)
    names = np.asarray(groups)
    shares = np.array([inside[names == name].mean() for name in np.unique(names)])
    error = shares.std(ddof=1) / np.sqrt(len(shares)) if len(shares) > 1 else float("nan")
    return float(shares.mean()), float(error)


def distance(friction: ArrayLike, reference: ArrayLike, error: ArrayLike) -> np.ndarray:
    """Distance of predictions from the intervals reference +- error."""
    return np.maximum(np.abs(np.subtract(friction, reference)) - error, 0.0)


def steps_off(predicted: ArrayLike, true: ArrayLike) -> np.ndarray:
    """Error in steps of the paper's grid: |predicted - true| / `STEP` rounded half up, int64.

    The paper's "error < 0.1" is 0 steps, "error < 0.2" at most 1: < 0.05 and < 0.15 off the grid.
    """
    return np.floor(np.abs(np.subtract(predicted, true)) / STEP + 0.5 + 1e-9).astype(np.int64)


def friction_scores(predicted: np.ndarray, true: np.ndarray) -> dict[str, float]:
    """Return the metrics of predicted and true friction coefficients, on the grid or off it."""
    return scores_of(PredictionsAndTruth(predicted, true), "friction")


def constant_error(true: np.ndarray) -> float:
    """Least mean absolute error of one coefficient said of every video: that of the median."""
    return float(np.abs(true - np.median(true)).mean())


def _common(scores: Sequence[Mapping[str, float]]) -> dict[str, list[float]]:
    """Score -> its values, of those that all trainings have."""
    names = [name for name in scores[0] if all(name in of_seed for of_seed in scores)]
    return {name: [of_seed[name] for of_seed in scores] for name in names}


def mean_over_seeds(scores: Sequence[Mapping[str, float | None]]) -> dict[str, float]:
    """The mean of every score over trainings that differ by the seed."""
    return {name: float(np.mean(values)) for name, values in _common(scores).items()}


def spread_over_seeds(scores: Sequence[Mapping[str, float | None]]) -> dict[str, float] | None:
    """Standard deviation (n - 1) of every score over the seeds; None of one seed only."""
    if len(scores) < 2:
        return None
    return {name: float(np.std(values, ddof=1)) for name, values in _common(scores).items()}


def entry(n: int, seeds: list[int], *scores: dict[str, float]) -> dict[str, Any]:
    """An entry of metrics.json: every field of `FIELDS`, None where no score is given."""
    known: dict[str, Any] = {"n": n, "seeds": seeds}
    for score in scores:
        known |= score
    return {name: known.get(name) for name in FIELDS}


def test_set_lines(metrics: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> list[str]:
    """Every test set and model of evaluate/metrics.json, a line each."""
    return _lines(metrics, "split", metrics_of(TEST_SETS))


def capture_lines(metrics: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> list[str]:
    """Every subset of the captures and model of captures/metrics.json, a line each."""
    columns = [metric for metric in metrics_of(CAPTURES, "friction", "capture") if metric.column]
    return _lines(metrics, "captures", columns)


def _lines(metrics, head: str, columns: list[Metric]) -> list[str]:
    wide = max(map(len, [head, *metrics]))
    rows = [[f"{head:<{wide}}  model", "n", *(metric.column for metric in columns)]]
    for of, models in metrics.items():
        for model, row in models.items():
            cells = [_cell(row[metric.name], metric.unit) for metric in columns]
            rows.append([f"{of:<{wide}}  {model}", str(row["n"]), *cells])
    return aligned(rows)


def _cell(value: float | None, unit: str) -> str:
    if value is None:
        return "-"
    return f"{100 * value:.1f}%" if unit == "%" else f"{value:.4f}"
