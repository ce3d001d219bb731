"""From the results of all seeds to table rows, differences with intervals, conclusions, a page.

The videos of one simulation are right or wrong together, and so are those that one training
answers: a difference between two variants is averaged over the videos of a simulation, and its
interval counts seeds and simulations, not videos.
"""

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from slipstitch.base.errors import BadInput
from slipstitch.base.page.figures import new_figure, styled, svg_uri
from slipstitch.base.page.palette import BAD, FAINT, GOOD, PALE, SOFT
from slipstitch.base.page.templates import render
from slipstitch.base.page.wording import counted
from slipstitch.base.provenance import (
    provenance_record,
    read_json,
    start_clock,
    write_json,
    write_text,
)
from slipstitch.config import Config
from slipstitch.learning.ablation.questions import QUESTIONS
from slipstitch.learning.evaluation.metrics import (
    TEST_SETS,
    constant_error,
    friction_scores,
    mean_over_seeds,
    metrics_of,
    spread_over_seeds,
)
from slipstitch.learning.evaluation.scores import grouped

LEVEL = 0.9
_TEMPLATE = Path(__file__).with_name("ablations.html.j2")
_COLOURS = {"better": GOOD, "worse": BAD, "no significant difference": SOFT, "nothing learnt": PALE}

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


def summarise(cases: Sequence[Row]) -> dict[str, Any]:
    """Return all questions' rows, comparisons and conclusions.

    Parameters
    ----------
    cases : sequence of dict
        What `slipstitch.learning.ablation.run.run_case` returned, for all variants and seeds.

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
    if len({case["dataset_digest"] for case in cases}) > 1:
        raise BadInput("the results are from different datasets; rerun all questions")
    questions: dict[str, Any] = {}
    for name, of_question in grouped(cases, "question").items():
        left_out = of_question[0]["left_out"]
        asks = None if left_out else QUESTIONS[name].asks
        questions[name] = {"asks": asks, "left_out": left_out, "rows": [], "comparisons": []}
        if left_out:
            continue
        for part in grouped(_by_test_set(of_question), "network", "tested_on").values():
            first, *others = grouped(part, "variant").values()
            reference = _row(first)
            rows = [_row(variant) for variant in others]
            questions[name]["rows"] += [reference, *rows]
            questions[name]["comparisons"] += [
                _comparison(first, variant, reference, row)
                for variant, row in zip(others, rows, strict=True)
            ]
    return {
        "level": LEVEL,
        "seeds": sorted({case["seed"] for case in cases}),
        "comparisons": sum(len(question["comparisons"]) for question in questions.values()),
        "questions": questions,
    }


def _by_test_set(cases: Sequence[Row]) -> list[Row]:
    """A row for every case and test set, with the predictions for it; in the order of test sets."""
    names = dict.fromkeys(one["tested_on"] for case in cases for one in case["predictions"])
    return [
        case
        | {
            "tested_on": name,
            "predictions": [one for one in case["predictions"] if one["tested_on"] == name],
        }
        for name in names
        for case in sorted(cases, key=lambda case: case["seed"])
    ]


def _row(of_seeds: list[Row]) -> Row:
    """A row of the table: a variant on a test set."""
    first = of_seeds[0]
    trained = [case["predictions"] for case in of_seeds if case["predictions"]]
    true = [np.array([one["true"] for one in part]) for part in trained]
    scores = [
        friction_scores(np.array([one["predicted"] for one in part]), of_part)
        for part, of_part in zip(trained, true, strict=True)
    ]
    names = (
        "network",
        "variant",
        "phrase",
        "tested_on",
        "training_videos",
        "training_simulations",
        "passes",
    )
    return {
        **{name: first[name] for name in names},
        "n": len(trained[0]) if trained else 0,
        "simulations": len({one["simulation"] for one in trained[0]}) if trained else 0,
        "seeds": len(of_seeds),
        "diverged": sum(case["failure"] is not None for case in of_seeds),
        "stayed_at_chance": sum(case["stayed_at_chance"] for case in of_seeds),
        "material_stayed_at_chance": sum(case["material_stayed_at_chance"] for case in of_seeds),
        "constant_error": constant_error(true[0]) if trained else None,
        "mean": mean_over_seeds(scores) if scores else None,
        "spread": spread_over_seeds(scores),
    }


def _comparison(first: list[Row], second: list[Row], reference: Row, row: Row) -> Row:
    """The difference of a variant from the first, over the seeds with which both trained."""
    by_seed = {case["seed"]: _errors(case) for case in first}
    pairs = []
    for case in second:
        errors, others = _errors(case), by_seed.get(case["seed"])
        if errors and others:
            pairs.append([errors[name] - others[name] for name in sorted(errors)])
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


def _errors(case: Row) -> dict[str, float]:
    """Mean absolute error of each simulation."""
    return {
        name: float(np.mean([abs(one["predicted"] - one["true"]) for one in part]))
        for name, part in grouped(case["predictions"], "simulation").items()
    }


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


def ablations_page(summary: Mapping[str, Any]) -> str:
    """The page as HTML; it needs no other file.

    Parameters
    ----------
    summary : mapping
        What `summarise` returned.
    """
    questions = summary["questions"].items()
    answered = {name: question for name, question in questions if not question["left_out"]}
    return render(
        _TEMPLATE,
        level=f"{100 * summary['level']:.0f} %",
        seeds=summary["seeds"],
        comparisons=summary["comparisons"],
        by_chance=(1 - summary["level"]) * summary["comparisons"],
        questions=answered,
        columns=metrics_of(TEST_SETS, "friction"),
        pictures={
            name: svg_uri(_picture(question["comparisons"])) for name, question in answered.items()
        },
        left_out=[question["left_out"] for _, question in questions if question["left_out"]],
    )


@styled
def _picture(comparisons: list[Mapping[str, Any]]) -> Figure | None:
    """Differences of the mean error as dots with their intervals; None without any."""
    shown = [comparison for comparison in comparisons if comparison["low"] is not None]
    if not shown:
        return None
    names = [
        f"{comparison['variant']} − {comparison['reference']}\n"
        f"{comparison['network']}, {comparison['tested_on']}"
        for comparison in shown
    ]
    figure = new_figure(7.6, 0.8 + 0.5 * len(shown))
    axes = figure.subplots()
    axes.axvline(0, color=FAINT, lw=0.9)
    for place, comparison in enumerate(shown):
        colour = _COLOURS[comparison["verdict"]]
        axes.plot([comparison["low"], comparison["high"]], [place, place], color=colour, lw=2)
        axes.plot(comparison["difference"], place, "o", color=colour, ms=6)
    axes.set_yticks(range(len(shown)), names)
    axes.set_ylim(len(shown) - 0.5, -0.5)
    ends = [abs(comparison[end]) for comparison in shown for end in ("low", "high")]
    reach = max(1.1 * max(ends), 1e-3)
    axes.set_xlim(-reach, reach)
    axes.set_xlabel("difference of the mean error of µ;  negative: better")
    axes.spines["left"].set_visible(False)
    axes.tick_params(axis="y", length=0)
    return figure


def write_summary(
    config: Config,
    folder: str | os.PathLike,
    out: str | os.PathLike,
    page: str | os.PathLike | None = None,
) -> dict[str, Any]:
    """Write the summary of ``{question}/{network}_{variant}_seed{seed}.json`` and its page.

    Raises
    ------
    BadInput
        If a result is missing, damaged, or of another case or dataset.
    """
    started = start_clock()
    paths = [Path(folder) / path for path in config.ablate.results]
    summary = summarise([_read(path) for path in paths])
    record = provenance_record(
        "ablate",
        inputs=paths,
        config=config.model_dump(mode="json", include={"ablate"}),
        started=started,
    )
    write_json(out, summary, record)
    if page is not None:
        write_text(page, ablations_page(summary), record)
    return summary


def _read(path: Path) -> Row:
    """One result; BadInput if it does not match its path."""
    case = read_json(path)
    if not isinstance(case, dict) or not set(case) >= {"question", "dataset_digest", "predictions"}:
        raise BadInput(f"{path}: not a result of `slipstitch ablate`")
    name = f"{case['network']}_{case['variant']}_seed{case['seed']}"
    if (case["question"], name) != (path.parent.name, path.stem):
        raise BadInput(f"{path}: holds {case['question']} {name}: does not match its path")
    return case
