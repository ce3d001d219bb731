"""The result: the best network on simulations that it never saw, beside the best probe."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.base.page.figures import svg_uri
from slipstitch.config import Config
from slipstitch.design.grid import simulations
from slipstitch.learning.ablation.summary import LEVEL, interval
from slipstitch.learning.evaluation.metrics import STEP, steps_off
from slipstitch.learning.evaluation.scores import network_of
from slipstitch.learning.evaluation.test_sets import PREFIX
from slipstitch.report.learning_pictures import predicted_against_true
from slipstitch.report.scores import Scores, model_title

HELD_OUT = {
    "by_simulation": "simulations that it never saw",
    "by_video": "new videos of simulations that it saw",
}


def _best(rows: Mapping[str, Mapping[str, Any]], of_probes: bool) -> str | None:
    """The model with the smallest mean error of µ, of the networks or of the probes."""
    errors = {
        name: row["mean_absolute_error"]
        for name, row in rows.items()
        if name.startswith(PREFIX) == of_probes and row["mean_absolute_error"] is not None
    }
    return min(errors, key=errors.__getitem__, default=None)


def headline(config: Config, scores: Scores, predictions) -> dict[str, Any] | None:
    """What the first screen says of the best network, beside the best probe; None without one."""
    for split in HELD_OUT:
        rows = scores.metrics.get(split, {})
        best, probe = _best(rows, of_probes=False), _best(rows, of_probes=True)
        if best is None:
            continue
        network = network_of(best)
        detail = scores.detail(split, network)
        own = [r for r in predictions or () if (r["split"], r["network"]) == (split, network)]
        _refuse_other_grid(config, own)
        own = [row | _interval(row, config.grid.frictions) for row in own]
        materials = {one.material_id: one.material for one in simulations(config)}
        return {
            "model": model_title(best),
            "unseen": HELD_OUT[split],
            "scores": rows[best],
            "share_interval": share_interval(own),
            "step": STEP,
            "probe": rows[probe] | {"title": model_title(probe)} if probe else None,
            "constant_error": detail.get("chance", {}).get("mean_absolute_error"),
            "simulations": detail.get("simulations"),
            "figure": svg_uri(predicted_against_true(own, materials)),
        }
    return None


def _interval(row: Mapping[str, Any], frictions: Sequence[float]) -> dict[str, float]:
    """A prediction's own 90 % interval; without one, the middle 90 % of its distribution."""
    if row["low"] is not None:
        return {"low": row["low"], "high": row["high"]}
    below = np.cumsum(row["probabilities"])
    low, high = np.searchsorted(below, [0.05, 0.95]).clip(max=len(frictions) - 1)
    return {"low": frictions[low], "high": frictions[high]}


def _refuse_other_grid(config: Config, rows: Iterable[Mapping[str, Any]]) -> None:
    """Refuse predictions for coefficients that the configured grid does not hold."""
    grid = config.grid.frictions
    for row in rows:
        if not np.isclose(row["true_value"], grid, rtol=0, atol=1e-9).any():
            known = ", ".join(f"{one:g}" for one in grid)
            raise BadInput(
                f"evaluate/predictions.parquet: {row['network']} {row['split']} has friction "
                f"{row['true_value']:g}, not one of the configured grid's: {known}; evaluate "
                "again, or give the configuration of these results"
            )


def share_interval(rows: Sequence[Mapping[str, Any]]) -> tuple[float, float] | None:
    """90 % interval of the share below half a step, over simulations and seeds; None of one.

    If all are right, or none, it is Clopper and Pearson's (1934), each simulation one case.
    """
    right: dict[tuple[int, str], list[bool]] = defaultdict(list)
    for row in rows:
        off = steps_off(row["predicted_value"], row["true_value"])
        right[row["seed"], row["simulation"]].append(off == 0)
    seeds = sorted({seed for seed, _ in right})
    names = sorted({name for _, name in right})
    if len(names) < 2:
        return None
    table = [[float(np.mean(right[seed, name])) for name in names] for seed in seeds]
    mean, low, high = interval(np.array(table))
    if mean in (0.0, 1.0):
        bound = ((1 - LEVEL) / 2) ** (1 / len(names))
        return (bound, 1.0) if mean else (0.0, 1 - bound)
    return max(0.0, low), min(1.0, high)
