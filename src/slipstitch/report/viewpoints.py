"""The paper's Table 3: rotations of the calibrated viewpoint."""

from collections.abc import Collection, Mapping
from typing import Any

from slipstitch.base.page.figures import svg_uri
from slipstitch.base.page.wording import percent
from slipstitch.learning.evaluation import paper
from slipstitch.learning.evaluation.metrics import Metric
from slipstitch.learning.evaluation.scores import AVERAGE, MODELS, TRAINING
from slipstitch.report import learning_pictures
from slipstitch.report.learning import (
    COUNTED,
    MODEL_TITLES,
    TURNED,
    Score,
    counted_metrics,
    score,
    seeds_of,
)


def _columns(known: Collection[str]) -> list[tuple[str, Metric]]:
    """(network, metric) of every column: of the fabric the first guess alone."""
    return [
        (network, metric)
        for network in COUNTED
        if network in known
        for metric in counted_metrics(network)
        if metric.name != "material_top2"
    ]


def turns(metrics) -> dict[int, str]:
    """Turn in degrees -> name of its test set, in the order of the turns."""
    names = {int(name.removeprefix(TURNED)): name for name in metrics if name.startswith(TURNED)}
    return dict(sorted(names.items()))


def table_3(metrics, details, calibrated: str) -> dict[str, Any] | None:
    """Scores at every turn, and at none: the split's test videos from the calibrated viewpoint.

    Parameters
    ----------
    metrics, details : mapping
        metrics.json and details.json.
    calibrated : str
        Name of the calibrated viewpoint.

    Returns
    -------
    dict or None
        None if no turned viewpoint was tested.
    """
    sets = turns(metrics or {})
    if not sets:
        return None
    known = {network for name in sets.values() for network in details.get(name, {})}
    columns = _columns(known)
    rows = {
        turn: {
            **_size(details.get(name, {})),
            "seeds": seeds_of(metrics[name]),
            "scores": [
                score(metrics, details, name, network, metric.name) for network, metric in columns
            ],
        }
        for turn, name in sets.items()
    }
    straight = _straight(details.get("by_video", {}), columns, calibrated)
    if straight:
        rows[0] = straight | {"seeds": seeds_of(metrics.get("by_video", {}))}
    curves = {
        (network, metric.name): {turn: row["scores"][k] for turn, row in sorted(rows.items())}
        for k, (network, metric) in enumerate(columns)
    }
    return {
        "networks": _headings(columns),
        "metrics": [metric for _, metric in columns],
        "rows": [
            {
                **row,
                "turn": f"{turn:+d}°".replace("-", "−") if turn else "0°",
                "paper": paper.TABLE_3.get(turn),
                "cells": [percent(*of_network) for of_network in row["scores"]],
            }
            for turn, row in sorted(rows.items())
        ],
        "figure": svg_uri(learning_pictures.accuracy_by_turn(curves)),
    }


def _headings(columns) -> list[tuple[str, int]]:
    """Name of each network, and how many columns it has."""
    titles = {network: MODEL_TITLES[model] for model, network in MODELS.items()}
    titles |= {"material_baseline": "material network"}
    titles |= {network: MODEL_TITLES[network] for network in (TRAINING, AVERAGE)}
    networks = [network for network, _ in columns]
    return [(titles[network], networks.count(network)) for network in dict.fromkeys(networks)]


def _size(of_set: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    return {
        name: max((network.get(name) or 0 for network in of_set.values()), default=0)
        for name in ("n", "simulations")
    }


def _straight(of_set, columns, calibrated: str) -> dict[str, Any] | None:
    """The row at 0 degrees, from the scores by viewpoint; the instrument knows one only."""
    seen = {
        network: detail
        if network in (TRAINING, AVERAGE)
        else detail.get("viewpoints", {}).get(calibrated)
        for network, detail in of_set.items()
    }
    seen = {network: detail for network, detail in seen.items() if detail}
    if not seen:
        return None
    return {
        **_size(seen),
        "scores": [
            Score(
                (seen.get(network, {}).get("mean") or {}).get(metric.name),
                (seen.get(network, {}).get("spread") or {}).get(metric.name),
            )
            for network, metric in columns
        ],
    }
