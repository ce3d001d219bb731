"""The paper's Fig. 6: cumulative errors on the simulated test set and on captures."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from slipstitch.base.page.figures import svg_uri
from slipstitch.base.page.wording import NONE, percent
from slipstitch.config.train import REFLECTIVE
from slipstitch.film.captures_scores import capture_errors, model_and_split, what_they_are
from slipstitch.learning.evaluation import paper
from slipstitch.learning.evaluation.metrics import CAPTURES, metrics_of
from slipstitch.learning.evaluation.scores import CALIBRATED
from slipstitch.report import learning_pictures
from slipstitch.report.results import Results, Table
from slipstitch.report.scores import NETWORK_TITLES, SPLIT_NAMES, model_title

CURVES = {
    "all": "all captures",
    "matte": "captures without reflective",
    "reflective": "captures, reflective only",
    "all, reflective training": "all captures, reflective training",
}
COLUMNS = metrics_of(CAPTURES, "friction", "capture")
Panels = dict[str, dict[str, np.ndarray]]


def figure_6(results: Results, predictions) -> dict[str, Any] | None:
    """Cumulative errors; without captures, on the simulated test sets alone; None without any."""
    panels = _simulated(predictions or (), np.asarray(results.config.grid.frictions))
    rows, table = results.capture_predictions() or [], None
    if rows:
        table = _captured(results, rows, panels)
    if not panels:
        return None
    stars = {CURVES[name]: one["median_within_0.1"] for name, one in paper.CAPTURES.items() if one}
    return {
        "figure": svg_uri(learning_pictures.cumulative(panels, stars)),
        "table": table,
        "kind": what_they_are(rows) if rows else None,
        "real": not rows[0]["surrogate"] if rows else None,
        "other_networks": results.captures_of_other_networks(),
    }


def _simulated(predictions: Iterable[Mapping[str, Any]], frictions: np.ndarray) -> Panels:
    """Model and split -> errors on the split's own test videos, beside a uniform guess."""
    pairs: dict[str, list[tuple[float, float]]] = {}
    for row in predictions:
        base = row["network"].removesuffix(CALIBRATED)
        if base in list(NETWORK_TITLES)[1:] and row["split"] in SPLIT_NAMES:
            title = f"{model_title(row['network'])}, {SPLIT_NAMES[row['split']]}"
            pairs.setdefault(title, []).append((row["true_value"], row["predicted_value"]))
    panels = {}
    for title, values in pairs.items():
        true, predicted = np.array(values).T
        guess = np.abs(frictions[None, :] - true[:, None]).ravel()
        panels[title] = {"simulated test set": np.abs(predicted - true), "uniform guess": guess}
    return panels


def _captured(results: Results, rows: Sequence[Mapping[str, Any]], panels: Panels) -> Table:
    """Add the captures' curves to the panels; return scores by model and subset."""
    by_subset = results.json("captures", "metrics.json") or {}
    shown = [
        [f"paper, real videos: {subset}", NONE, NONE, *(percent(of.get(c.name)) for c in COLUMNS)]
        for subset, of in paper.CAPTURES.items()
        if of
    ]
    for label in next(iter(by_subset.values()), {}):
        model, split = model_and_split(label)
        title = f"{model_title(model)}, {SPLIT_NAMES[split]}"
        panel = panels.setdefault(title, {})
        for trained_on in (split, REFLECTIVE) if split == "by_video" else (split,):
            own = [row for row in rows if (row["model"], row["trained_on"]) == (model, trained_on)]
            errors = capture_errors(own) if own else {}
            if trained_on == split:
                panel |= {CURVES[name]: off for name, off in errors.items()}
            elif errors:
                panel[CURVES["all, reflective training"]] = errors["all"]
        shown.append([title])
        for name, of_model in by_subset.items():
            one = of_model[label]
            cells = [metric.shown(one, one.get("spread")) for metric in COLUMNS]
            subset = CURVES[name.split("_")[1]]
            shown.append([subset, str(one["n"]), str(one.get("pairs") or NONE), *cells])
    return ["tested on", "videos", "pairs", *(metric.heading for metric in COLUMNS)], shown
