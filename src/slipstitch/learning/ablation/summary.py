"""From the results of all seeds to table rows, differences with intervals, and conclusions.

The videos of one simulation are right or wrong together, and so are those that one training
answers: a difference between two variants is averaged over the videos of a simulation, and its
interval counts seeds and simulations, not videos.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import stats

from slipstitch.base.errors import BadInput
from slipstitch.base.page.wording import counted
from slipstitch.learning.evaluation.metrics import (
    constant_error,
    friction_scores,
    mean_over_seeds,
    spread_over_seeds,
)

LEVEL = 0.9
Row = dict[str, Any]


def interval(differences: np.ndarray) -> tuple[float, float, float]:
    """Mean of differences that share seeds and simulations, and its interval at `LEVEL`.

    Both are random effects, crossed: with mean squares of rows, columns and remainder, the variance
    of the mean is (MS_seeds + MS_simulations - MS_rest) / (S N), its degrees of freedom those of
    Satterthwaite (1946); Student's t. A bootstrap over as few as three seeds would be too narrow:
    where seeds differ as much as simulations do, its 90 % interval holds 76 % of the time, this
    one 87 % (tests/unit/test_ablate_summary.py).

    Parameters
    ----------
    differences : ndarray, shape (S, N)
        Seeds by simulations. With one seed the interval counts simulations only.

    Returns
    -------
    mean, low, high : float
        The ends are infinite where one simulation says nothing of others.
    """
    seeds, simulations = differences.shape
    mean = float(differences.mean())
    if simulations < 2:
        return mean, -math.inf, math.inf
    of_simulation = differences.mean(0)
    if seeds < 2:
        parts = [(of_simulation.var(ddof=1) / simulations, simulations - 1)]
        rest = 0.0
    else:
        of_seed = differences.mean(1)
        parts = [
            (of_seed.var(ddof=1) / seeds, seeds - 1),
            (of_simulation.var(ddof=1) / simulations, simulations - 1),
        ]
        left = differences - of_seed[:, None] - of_simulation[None] + mean
        freedom = (seeds - 1) * (simulations - 1)
        rest = float((left**2).sum() / freedom / (seeds * simulations))
    each = [variance for variance, _ in parts]
    # The remainder is in both; where it is most of them, their difference must not vanish.
    variance = max(sum(each) - rest, *each, rest)
    if variance == 0:
        return mean, mean, mean
    freedom = sum(each) ** 2 / sum(part**2 / free for part, free in parts)
    half = float(stats.t.ppf((1 + LEVEL) / 2, freedom)) * math.sqrt(variance)
    return mean, mean - half, mean + half


def summarise(answers: Sequence[dict[str, Any]], step: float) -> dict[str, Any]:
    """All questions' rows, comparisons and conclusions.

    Parameters
    ----------
    answers : sequence of dict
        What `slipstitch.learning.ablation.answering.answer` returned, for all questions and seeds.
    step : float
        Grid step of mu for the shares of small errors.

    Returns
    -------
    dict
        ``{"level", "seeds", "comparisons", "questions": {name: {"asks", "left_out", "rows",
        "comparisons"}}}``, the content of ablate.json.

    Raises
    ------
    BadInput
        If the results are from different datasets.
    """
    if len({answer["dataset_digest"] for answer in answers}) > 1:
        raise BadInput("the results are from different datasets; rerun all questions")
    questions: dict[str, Any] = {}
    for name in dict.fromkeys(answer["question"] for answer in answers):
        of_question = sorted(
            (answer for answer in answers if answer["question"] == name),
            key=lambda answer: answer["seed"],
        )
        first = of_question[0]
        if first["left_out"]:
            questions[name] = {"asks": None, "left_out": first["left_out"]}
            questions[name] |= {"rows": [], "comparisons": []}
            continue
        rows = _rows(of_question, step)
        questions[name] = {
            "asks": first["asks"],
            "left_out": None,
            "rows": rows,
            "comparisons": _comparisons(of_question, rows),
        }
    return {
        "level": LEVEL,
        "seeds": sorted({answer["seed"] for answer in answers}),
        "comparisons": sum(len(question["comparisons"]) for question in questions.values()),
        "questions": questions,
    }


def _tests(answers: Sequence[dict[str, Any]]) -> list[str]:
    """Names of the test sets, in their order."""
    return list(
        dict.fromkeys(
            prediction["tested_on"] for answer in answers for prediction in answer["predictions"]
        )
    )


def _predictions(answer: dict[str, Any], network: str, variant: str, tested_on: str) -> list[Row]:
    wanted = (network, variant, tested_on)
    return [
        prediction
        for prediction in answer["predictions"]
        if (prediction["network"], prediction["variant"], prediction["tested_on"]) == wanted
    ]


def _rows(answers: Sequence[dict[str, Any]], step: float) -> list[Row]:
    """One row per network, test set and variant."""
    first = answers[0]
    rows = []
    for network in dict.fromkeys(variant["network"] for variant in first["variants"]):
        for tested_on in _tests(answers):
            for place, variant in enumerate(first["variants"]):
                if variant["network"] == network:
                    of_seeds = [answer["variants"][place] for answer in answers]
                    predictions = [
                        _predictions(answer, network, variant["variant"], tested_on)
                        for answer in answers
                    ]
                    rows.append(
                        _row(
                            of_seeds,
                            [of_seed for of_seed in predictions if of_seed],
                            tested_on,
                            step,
                        )
                    )
    return rows


def _row(of_seeds: list[Row], predictions: list[list[Row]], tested_on: str, step: float) -> Row:
    variant = of_seeds[0]
    scores = [
        friction_scores(
            np.array([prediction["predicted"] for prediction in of_seed]),
            np.array([prediction["true"] for prediction in of_seed]),
            step,
        )
        for of_seed in predictions
    ]
    tested = predictions[0] if predictions else []
    return {
        "network": variant["network"],
        "variant": variant["variant"],
        "phrase": variant["phrase"],
        "tested_on": tested_on,
        "n": len(tested),
        "simulations": len({prediction["simulation"] for prediction in tested}),
        "training_videos": variant["training_videos"],
        "training_simulations": variant["training_simulations"],
        "passes": variant["passes"],
        "seeds": len(of_seeds),
        "diverged": sum(training["failure"] is not None for training in of_seeds),
        "stayed_at_chance": sum(training["stayed_at_chance"] for training in of_seeds),
        "material_stayed_at_chance": sum(
            training.get("material_stayed_at_chance", False) for training in of_seeds
        ),
        "constant_error": constant_error(np.array([prediction["true"] for prediction in tested]))
        if tested
        else None,
        "mean": mean_over_seeds(scores) if scores else None,
        "spread": spread_over_seeds(scores),
    }


def _comparisons(answers: Sequence[dict[str, Any]], rows: list[Row]) -> list[Row]:
    """Every variant with the first of its network and test set."""
    compared = []
    for row in rows:
        same = [
            other
            for other in rows
            if (other["network"], other["tested_on"]) == (row["network"], row["tested_on"])
        ]
        if row is not same[0]:
            compared.append(_comparison(answers, same[0], row))
    return compared


def _comparison(answers: Sequence[dict[str, Any]], reference: Row, row: Row) -> Row:
    pairs = []
    for answer in answers:
        errors = [
            _by_simulation(
                _predictions(answer, row["network"], compared["variant"], row["tested_on"])
            )
            for compared in (row, reference)
        ]
        if all(errors):
            pairs.append([errors[0][name] - errors[1][name] for name in sorted(errors[0])])
    found = {
        "network": row["network"],
        "tested_on": row["tested_on"],
        "variant": row["variant"],
        "reference": reference["variant"],
        "seeds": len(pairs),
        "simulations": len(pairs[0]) if pairs else 0,
        "difference": None,
        "low": None,
        "high": None,
    }
    if pairs:
        mean, low, high = interval(np.array(pairs))
        found |= {"difference": mean}
        found |= {"low": low, "high": high} if math.isfinite(low) else {}
    found["verdict"] = verdict(found, reference, row)
    found["sentence"] = sentence(found, reference, row)
    return found


def _by_simulation(predictions: list[Row]) -> dict[str, float]:
    """Mean absolute error of each simulation."""
    errors: dict[str, list[float]] = {}
    for prediction in predictions:
        error = abs(prediction["predicted"] - prediction["true"])
        errors.setdefault(prediction["simulation"], []).append(error)
    return {name: float(np.mean(of)) for name, of in errors.items()}


def verdict(found: Row, reference: Row, row: Row) -> str:
    """Conclusion from the interval: better, worse, no significant difference, or none."""
    if found["low"] is None:
        return "not compared"
    if all(variant["stayed_at_chance"] == variant["seeds"] for variant in (reference, row)):
        return "nothing learnt"
    if found["high"] < 0:
        return "better"
    return "worse" if found["low"] > 0 else "no significant difference"


def sentence(found: Row, reference: Row, row: Row) -> str:
    """The conclusion, from the interval alone."""
    new, old = row["phrase"], reference["phrase"]
    where = "" if row["tested_on"] == "held-out" else f", tested on {row['tested_on']}"
    start = f"{row['network']}{where}: "
    amount = ""
    if found["low"] is not None:
        sign = -1 if found["verdict"] == "better" else 1
        ends = sorted((sign * found["low"], sign * found["high"]))
        amount = f"{sign * found['difference']:.3f} ({ends[0]:.3f} ... {ends[1]:.3f})"
    many = f"{found['simulations']} simulations and {counted(found['seeds'], 'seed')}"
    if found["verdict"] == "not compared":
        conclusion = f"{new} cannot be compared with {old}: " + (
            "one test simulation does not generalise to others"
            if found["seeds"]
            else "in no seed did both train without diverging"
        )
    elif found["verdict"] == "nothing learnt":
        conclusion = f"{new} and {old} cannot be compared: both stayed at chance at this budget"
    elif found["verdict"] == "no significant difference":
        conclusion = (
            f"no significant difference between {new} and {old} with {many}: difference of the "
            f"mean error {amount}"
        )
    elif found["verdict"] == "better":
        conclusion = f"{new} is better than {old}: mean error smaller by {amount}, {many}"
    else:
        conclusion = f"{new} is worse than {old}: mean error larger by {amount}, {many}"
    notes = [
        f"{variant['phrase']} {what} with {variant[key]} of {variant['seeds']} seeds"
        for variant in (reference, row)
        for key, what in (
            ("stayed_at_chance", "stayed at chance"),
            ("material_stayed_at_chance", "had a material network that stayed at chance"),
            ("diverged", "diverged"),
        )
        if variant[key] and not (key == "stayed_at_chance" and found["verdict"] == "nothing learnt")
    ]
    if found["seeds"] == 1:
        notes.append("the interval does not cover other seeds")
    return start + "; ".join([conclusion, *notes]) + "."
