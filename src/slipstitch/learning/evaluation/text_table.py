"""The tables of ``slipstitch evaluate`` for a terminal."""

from collections.abc import Mapping
from typing import Any

from slipstitch.learning.evaluation.metrics import CAPTURES, TEST_SETS, Metric, metrics_of


def test_set_lines(metrics: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> list[str]:
    """Every test set and model of evaluate/metrics.json, a line each."""
    heads = [f"{'split':<16}", f"{'model':<27}", f"{'n':>5}"]
    return _lines(metrics, heads, metrics_of(TEST_SETS))


def capture_lines(metrics: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> list[str]:
    """Every subset of the captures and model of captures/metrics.json, a line each."""
    heads = [f"{'captures':<22}", f"{'model':<38}", f"{'n':>4}"]
    columns = [metric for metric in metrics_of(CAPTURES, "friction", "capture") if metric.column]
    return _lines(metrics, heads, columns)


def _lines(metrics, heads: list[str], columns: list[Metric]) -> list[str]:
    first, second, count = (len(head) for head in heads)
    return [" ".join([*heads, *(f"{metric.column:>{_width(metric)}}" for metric in columns)])] + [
        " ".join(
            [
                f"{of:<{first}}",
                f"{model:<{second}}",
                f"{row['n']:>{count}}",
                *(_cell(metric, row[metric.name]) for metric in columns),
            ]
        )
        for of, models in metrics.items()
        for model, row in models.items()
    ]


def _width(metric: Metric) -> int:
    return max(7, len(metric.column) + 1)


def _cell(metric: Metric, value: float | None) -> str:
    if value is None:
        shown = "-"
    else:
        shown = f"{100 * value:.1f}%" if metric.unit == "%" else f"{value:.4f}"
    return f"{shown:>{_width(metric)}}"
