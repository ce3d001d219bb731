"""Tables of the networks: comparison with the paper's Table 2 and Sec. 6.2.1, and all test sets."""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from slipstitch.base.page.wording import percent, seeds_in_words
from slipstitch.config import Config
from slipstitch.learning.ablation.summary import LEVEL, interval
from slipstitch.learning.evaluation import paper, probes
from slipstitch.learning.evaluation.metrics import TEST_SETS, Metric, metrics_of, steps_off
from slipstitch.learning.evaluation.scores import AVERAGE, MODELS, TRAINING

SPLIT_TITLES = {
    "by_video": "videos held out (the paper’s split)",
    "by_simulation": "whole simulations held out",
    "off_grid": "off-grid friction",
    "by_video_reflective": "videos held out, also trained on reflective floors",
    "reflective_floors": "unseen reflective floors",
    "unseen_texture": "unseen texture",
    "unseen_fabric": "unseen fabric",
}
MODEL_TITLES = {
    "lrcn_baseline": "baseline network",
    "lrcn_conditional": "network given the material",
    TRAINING: "instrument",
    AVERAGE: "instruments averaged",
}
# Which entry of metrics.json holds a network's scores.
ENTRIES = {
    "material_baseline": "lrcn_baseline",
    TRAINING: TRAINING,
    AVERAGE: AVERAGE,
    **{network: model for model, network in MODELS.items()},
}
# What the paper's tables count of each network, and what tells its rows apart.
COUNTED = {
    "material_baseline": ("fabric", ""),
    "friction_baseline": ("friction", ", baseline"),
    "friction_conditional": ("friction", ", given the material"),
    TRAINING: ("friction", ", instrument"),
    AVERAGE: ("friction", ", instruments averaged"),
}
TURNED = "view_"


def counted_metrics(network: str) -> list[Metric]:
    """The metrics of a network that the paper's tables have: shares of right answers."""
    kind, _ = COUNTED[network]
    return [metric for metric in metrics_of(TEST_SETS, kind) if metric.title]


class Score(NamedTuple):
    """A mean over seeds and their standard deviation; None where there is none."""

    mean: float | None
    spread: float | None


def score(
    metrics, details, test_set: str, network: str, metric: str, viewpoint: str | None = None
) -> Score:
    """A network's score on a test set, or on its videos from a viewpoint.

    Parameters
    ----------
    metrics, details : mapping
        metrics.json and details.json.
    """
    entry = metrics.get(test_set, {}).get(ENTRIES[network]) or {}
    detail = details.get(test_set, {}).get(network) or {}
    if viewpoint is not None:
        detail = detail.get("viewpoints", {}).get(viewpoint) or {}
        entry = detail.get("mean", {})
    return Score(entry.get(metric), (detail.get("spread") or {}).get(metric))


def seeds_of(entries: Mapping[str, Mapping[str, Any]]) -> str:
    """The number of seeds of the models of a test set, in words."""
    counts = sorted({len(row["seeds"]) for row in entries.values() if row.get("seeds")})
    if not counts:
        return ""
    most = seeds_in_words(counts[-1])
    return most if len(counts) == 1 else f"{counts[0]} to {most}"


def headline(config: Config, metrics, details, predictions) -> list[dict[str, Any]]:
    """The result that counts, of simulations that no network has seen; then the paper's split.

    Each with what a linear probe of one frame gives; of the same network, where both have it.
    """
    found: list[dict[str, Any]] = []
    best = ""
    for split in ("by_simulation", "by_video"):
        rows = (metrics or {}).get(split, {})
        scored = {
            name: row
            for name, row in rows.items()
            if row.get("friction_lt_0.1") is not None and not name.startswith(probes.PREFIX)
        }
        if not scored:
            continue
        if best not in scored:
            best = max(scored, key=lambda name: scored[name]["friction_lt_0.1"])
        network = MODELS.get(best, best)
        detail = details.get(split, {}).get(network, {})
        chance = detail.get("chance", {})
        found.append(
            {
                "split": SPLIT_TITLES[split],
                "model": MODEL_TITLES.get(best, best),
                "share": scored[best]["friction_lt_0.1"],
                "interval": share_interval(
                    predictions or (), split, network, config.evaluate.friction_step
                ),
                "seeds": len(scored[best].get("seeds") or ()),
                "probe": rows.get(probes.MIDDLE_FRAME, {}).get("friction_lt_0.1"),
                "error": scored[best].get("mean_absolute_error"),
                "chance": chance.get("uniform", 1.0 / len(config.grid.frictions)),
                "majority": chance.get("majority"),
                "chance_error": chance.get("mean_absolute_error"),
                "n": scored[best]["n"],
                "simulations": detail.get("simulations"),
                "classes": len(config.grid.frictions),
            }
        )
    return found


def share_interval(
    predictions: Iterable[Mapping[str, Any]], split: str, network: str, step: float
) -> tuple[float, float] | None:
    """90 % interval of the share below half a step, over simulations and seeds; None of one.

    If all are right, or none, it is Clopper and Pearson's (1934), each simulation one case.
    """
    right: dict[tuple[int, str], list[bool]] = defaultdict(list)
    for row in predictions:
        if (row["split"], row["network"]) == (split, network):
            off = steps_off(row["predicted_value"], row["true_value"], step)
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


def beside_paper(
    metrics,
    details,
    titles: Mapping[tuple[str, str | None], str],
    quoted: Mapping[tuple[str, str], float],
    videos: int,
) -> dict[str, Any]:
    """A table of the paper's metrics: its own figures, then one column per test set of ours.

    Parameters
    ----------
    titles : mapping
        (test set, viewpoint or None for all) -> heading of its column; those that were not run are
        left out.
    quoted : mapping
        (network, metric) -> the paper's figure.
    videos : int
        Of how many videos these are.
    """
    networks = ("material_baseline", *MODELS.values())

    def of_each(name: str, view: str | None) -> list[Mapping[str, Any]]:
        found = [details.get(name, {}).get(network, {}) for network in networks]
        return found if view is None else [one.get("viewpoints", {}).get(view, {}) for one in found]

    shown = [
        (name, view)
        for name, view in titles
        if metrics.get(name) and (view is None or any(of_each(name, view)))
    ]

    def column(name: str, view: str | None) -> dict[str, Any]:
        rows = {key: metrics[name][key] for key in MODELS if key in metrics[name]}
        counted = of_each(name, view)
        return {
            "title": titles[name, view],
            "n": max((row.get("n", 0) for row in (counted if view else rows.values())), default=0),
            "simulations": max(detail.get("simulations") or 0 for detail in counted),
            "seeds": seeds_of(rows),
        }

    return {
        "paper_videos": videos,
        "columns": [column(*key) for key in shown],
        "rows": [
            {
                "title": metric.title + COUNTED[network][1],
                "paper": quoted.get((network, metric.name)),
                "cells": [
                    percent(*score(metrics, details, name, network, metric.name, view))
                    for name, view in shown
                ],
            }
            for network in networks
            for metric in counted_metrics(network)
        ],
    }


def table_2(metrics, details) -> dict[str, Any] | None:
    """The paper's Table 2: the paper's split, and the honest one."""
    titles: dict[tuple[str, str | None], str] = {
        ("by_video", None): "ours, by video",
        ("by_simulation", None): "ours, by simulation",
    }
    if not any((metrics or {}).get(name) for name, _ in titles):
        return None
    return beside_paper(metrics, details, titles, paper.TABLE_2, paper.TABLE_2_VIDEOS)


def unseen_texture(metrics, details, calibrated: str) -> dict[str, Any] | None:
    """The paper's Sec. 6.2.1, and the same networks on textures that they trained on.

    Parameters
    ----------
    metrics, details : mapping
        metrics.json and details.json.
    calibrated : str
        Name of the calibrated viewpoint.
    """
    if not (metrics or {}).get("unseen_texture"):
        return None
    titles = {
        ("unseen_texture", calibrated): "ours, unseen texture, calibrated view",
        ("unseen_texture", None): "ours, unseen texture, all views",
        ("by_video", None): "ours, trained textures, all views",
    }
    return beside_paper(metrics, details, titles, paper.UNSEEN_TEXTURE, paper.UNSEEN_TEXTURE_VIDEOS)


def not_tested(metrics, captures) -> list[str]:
    """Parts of the paper's Sec. 6 without videos in this run, and their sources."""
    wanted = {
        "an unseen texture (Sec. 6.2.1; render.test_textures)": "unseen_texture" in metrics,
        "rotated viewpoints (Table 3; render.test_viewpoints)": any(
            name.startswith(TURNED) for name in metrics
        ),
        "captures (Fig. 6; snakemake captures)": captures is not None,
    }
    return [what for what, there in wanted.items() if not there]


def test_sets(metrics, details) -> list[dict[str, Any]]:
    """Every test set of metrics.json but the turned viewpoints, and what chance would give."""
    groups = []
    for split, models in (metrics or {}).items():
        if split.startswith(TURNED):
            continue
        of_split = details.get(split, {})
        trained_on = next((network.get("trained_on") for network in of_split.values()), None)
        groups.append(
            {
                "split": SPLIT_TITLES.get(split, split.replace("_", " ")),
                "trained_on": trained_on.replace("_", " ")
                if trained_on and trained_on != split
                else None,
                "rows": [
                    _test_row(model, row, of_split.get(MODELS.get(model, model), {}), of_split)
                    for model, row in models.items()
                ],
            }
        )
    return groups


def _test_row(model: str, row, detail, of_split) -> dict[str, Any]:
    # The baseline's row holds the scores of two networks.
    fabric = of_split.get("material_baseline", {}) if model == "lrcn_baseline" else detail
    spread = (fabric.get("spread") or {}) | (detail.get("spread") or {})
    return {
        "model": _model_title(model),
        "n": row["n"],
        "simulations": detail.get("simulations"),
        "seeds": len(row.get("seeds") or []) or None,
        "chance": percent(detail.get("chance", {}).get("uniform")),
        "cells": [metric.shown(row, spread) for metric in metrics_of(TEST_SETS)],
    }


def _model_title(model: str) -> str:
    """Of a row of the test sets."""
    if model.startswith(probes.PREFIX):
        what = probes.WHAT[model.removesuffix(probes.NETWORK)]
        return f"{'small network' if model.endswith(probes.NETWORK) else 'linear'}: {what}"
    return MODEL_TITLES.get(model, model).replace("network", "").strip()


def alarms(details) -> list[dict[str, Any]]:
    """Alarm rates, one row per instrument, and one of their average."""
    return [
        {"split": SPLIT_TITLES[split], "seed": seed, "rates": rates}
        for split in ("by_simulation", "by_video")
        for network in (TRAINING, AVERAGE)
        for seed, rates in details.get(split, {}).get(network, {}).get("alarms", {}).items()
    ]
