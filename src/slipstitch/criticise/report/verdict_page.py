"""The verdict for the experimenter: as a page with pictures, or in words and tables as Markdown."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import t as student

from slipstitch.base.page.figures import svg_element
from slipstitch.base.page.palette import BLUE, DOUBT, GOOD, SOFT, VERMILION
from slipstitch.base.page.templates import render
from slipstitch.base.page.wording import percent, with_interval
from slipstitch.criticise.case import Case
from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.covariates import COVARIATES
from slipstitch.criticise.report import verdict_pictures as pictures
from slipstitch.criticise.resimulation import Resimulation
from slipstitch.criticise.statement import false_alarm_words, second_sentence, sentence
from slipstitch.criticise.verdict import Analysis
from slipstitch.criticise.within_runs import words

_PAGE, _MARKDOWN = (Path(__file__).with_name(f"verdict.{kind}.j2") for kind in ("html", "md"))
_TONES = {"none": GOOD, "cause": BLUE, "confounded": DOUBT, "unknown": VERMILION}
MOST_TRACES = 6


def _content(verdict: dict) -> dict[str, Any]:
    """What both forms show of a verdict."""
    seen = verdict["certificate"]["smallest_detectable"].items()
    silent = verdict["not_testable"].items()
    return {
        "verdict": verdict,
        "sentence": sentence(verdict),
        "second_sentence": second_sentence(verdict),
        "within": words(verdict["within_runs"]),
        "seen": [(MECHANISMS[n].title, one) for n, one in seen if one["size"] is not None],
        "false_alarm_words": false_alarm_words(verdict["certificate"]),
        "silent": [(n, MECHANISMS[n].title, why) for n, why in silent if n in MECHANISMS],
    }


def page(verdict: dict, analysis: Analysis, again: Resimulation | None = None) -> str:
    """The page as HTML; it needs no other file. ``again`` adds before and after."""
    found, everything = verdict["discrepancy"], pictures.covariate_picture(analysis)
    drawn: dict[str, Any] = dict.fromkeys(("discrepancy", "everything"))
    if found and found["covariate"]:
        factor = pictures.discrepancy_picture(found, analysis)
        drawn["discrepancy"] = svg_element(factor, "The factor and its band")
    if everything:
        drawn["everything"] = svg_element(everything, "Residuals along every covariate")
    return render(
        _PAGE,
        tone=_TONES.get(verdict["verdict"], SOFT),
        extended=analysis.explanation is not None,
        residuals=svg_element(
            pictures.residual_picture(analysis),
            "Residuals of plain Coulomb and of the extended model",
        ),
        predictions=svg_element(
            pictures.prediction_picture(analysis), "Residuals in standard deviations, both models"
        ),
        ranking=svg_element(pictures.ranking_picture(verdict), "The rival models by BIC"),
        again=before_and_after(again) if again else None,
        **drawn,
        **_content(verdict),
    )


def markdown(case: Case, verdict: dict, analysis: Analysis) -> str:
    """The page of a case; what ``meta.json`` says ``about`` it stands at its beginning."""
    measured = analysis.measurements
    text = render(
        _MARKDOWN,
        about=str(case.meta.get("about") or ""),
        measured=measured,
        traces=_traces(analysis),
        labels=_labels(analysis),
        covariates=COVARIATES,
        with_interval=with_interval,
        **_content(verdict),
    )
    return re.sub(r"\n{3,}", "\n\n", text).strip() + "\n"


def _traces(analysis: Analysis) -> list[tuple[str, str, float]]:
    """The strongest test of each mechanism and along each covariate: what, shape, p."""
    outcome = analysis.null_outcome
    best = outcome.strongest_by(lambda t: t.mechanism or COVARIATES[str(t.covariate)].title)
    order = sorted(best.items(), key=lambda item: outcome.adjusted[item[1]])[:MOST_TRACES]
    return [
        (name, outcome.tests[i].shape or "the mechanism's own", outcome.adjusted[i])
        for name, i in order
    ]


def _labels(analysis: Analysis) -> list[tuple[str, list, str]]:
    """Friction by support, operator ...; an effect is told from specimens' scatter, if at all."""
    rows = analysis.measurements.rows
    residual, good = pictures.relative_residuals(analysis, analysis.null)
    found = []
    for name, covariate in COVARIATES.items():
        if covariate.text:
            own = good & (rows[name] != "").to_numpy()
            columns = {"label": rows[name], "of": rows["specimen_id"], "y": residual}
            means = pd.DataFrame(columns)[own].groupby(["label", "of"])["y"].mean()
            table = means.groupby("label").agg(["mean", "count"])
            if len(table) > 1:
                found.append((covariate.title, list(table.itertuples()), _told(means)))
    return found


def _told(means: pd.Series) -> str:
    """What specimens' means by label say of the difference between two labels."""
    counts = means.groupby("label").size()
    shared = means.groupby("of").size().max() > 1
    if shared or len(counts) > 2:
        return ""
    if few := [label for label, count in counts.items() if count < 2]:
        alone = " and ".join(f"“{label}”" for label in few)
        return (
            f"{alone} was measured with one specimen only: its difference cannot be told from that "
            "specimen's own."
        )
    one, two = (group for _, group in means.groupby("label"))
    error = np.sqrt(one.var() / len(one) + two.var() / len(two))
    half = student.ppf(0.975, len(one) + len(two) - 2) * error
    difference = float(one.mean() - two.mean())
    interval = (difference - half, difference + half)
    return f"Difference between specimens: {with_interval(difference, interval, 1)} % of friction."


def before_and_after(again: Resimulation) -> dict[str, Any]:
    """What the page shows of the runs that were simulated again."""
    both, each = again.summary["all"], again.summary["quantities"]
    rows = {
        "trailing edge": each["te_x_mm"],
        "contact length": each["contact_len_mm"],
        "both": both,
    }
    return {
        "picture": svg_element(
            pictures.before_and_after_picture(again.frames),
            "Lag of the edge and contact length: measured and simulated again",
        ),
        "specimens": both["specimens"],
        "rows": [(title, entry, _gain(entry)) for title, entry in rows.items()],
    }


def _gain(entry: dict) -> str:
    if entry["gain_ci95"] is None:
        return percent(entry["gain"], digits=0)
    return with_interval(entry["gain"], entry["gain_ci95"], 0, 100.0, " %")
