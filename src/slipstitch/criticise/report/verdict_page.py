"""One page: the verdict in a sentence, three pictures, the rivals, what to measure next."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from slipstitch.base.page.figures import svg, svg_element
from slipstitch.base.page.palette import BLUE, DOUBT, GOOD, SOFT, VERMILION
from slipstitch.base.page.templates import render
from slipstitch.base.page.wording import percent, with_interval
from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.inference.fit import Fit
from slipstitch.criticise.report.verdict_pictures import (
    before_and_after_picture,
    covariate_picture,
    discrepancy_picture,
    prediction_picture,
    ranking_picture,
    residual_picture,
)
from slipstitch.criticise.resimulation import Resimulation
from slipstitch.criticise.statement import false_alarm_words, second_sentence, sentence
from slipstitch.criticise.verdict import Analysis
from slipstitch.criticise.within_runs import words

_TEMPLATE = Path(__file__).with_name("verdict.html.j2")
_TONES = {"none": GOOD, "cause": BLUE, "confounded": DOUBT, "unknown": VERMILION}


def page(verdict: dict, analysis: Analysis, again: Resimulation | None = None) -> str:
    """The page as HTML; it needs no other file. ``again`` adds before and after."""
    extended = _extended(verdict, analysis)
    everything = covariate_picture(analysis)
    found = verdict["discrepancy"]
    return render(
        _TEMPLATE,
        verdict=verdict,
        tone=_TONES.get(verdict["verdict"], SOFT),
        sentence=sentence(verdict),
        second_sentence=second_sentence(verdict),
        within=words(verdict["within_runs"]),
        named=verdict["verdict"] in ("cause", "confounded"),
        extended=extended is not None,
        discrepancy=svg_element(discrepancy_picture(found, analysis), "The factor and its band")
        if found and found["covariate"]
        else None,
        residuals=svg_element(
            residual_picture(analysis, extended),
            "Residuals of plain Coulomb and of the extended model",
        ),
        predictions=svg_element(
            prediction_picture(analysis, extended), "Residuals in standard deviations, both models"
        ),
        ranking=svg_element(ranking_picture(verdict), "The rival models by BIC"),
        again=before_and_after(again) if again else None,
        everything=svg_element(everything, "Residuals along every covariate")
        if everything
        else None,
        seen=[
            (MECHANISMS[name].title, f"{found['size']:.3g}", found["unit"])
            for name, found in verdict["certificate"]["smallest_detectable"].items()
            if found["size"] is not None
        ],
        false_alarm_words=false_alarm_words(verdict["certificate"]),
        silent=[
            (name, MECHANISMS[name].title, why)
            for name, why in verdict["not_testable"].items()
            if name in MECHANISMS
        ],
    )


def left_over(verdict: dict, analysis: Analysis) -> str:
    """The picture of what is left over without and with the extended model, as an SVG."""
    return svg(residual_picture(analysis, _extended(verdict, analysis)))


def _extended(verdict: dict, analysis: Analysis) -> Fit | None:
    named = verdict["verdict"] in ("cause", "confounded")
    return analysis.chosen.fitted if named and analysis.chosen else None


def before_and_after(again: Resimulation) -> dict[str, Any]:
    """What the page shows of the runs that were simulated again."""
    summary = again.summary
    rows = (
        ("trailing edge", summary["quantities"]["te_x_mm"]),
        ("contact length", summary["quantities"]["contact_len_mm"]),
        ("both", summary["all"]),
    )
    return {
        "picture": svg_element(
            before_and_after_picture(again.frames),
            "Lag of the edge and contact length: measured and simulated again",
        ),
        "specimens": summary["all"]["specimens"],
        "rows": [
            {
                "title": title,
                "null_mm": entry["rmse_null_mm"],
                "extended_mm": entry["rmse_extended_mm"],
                "gain": _gain(entry),
            }
            for title, entry in rows
        ],
    }


def _gain(entry: dict) -> str:
    if entry["gain_ci95"] is None:
        return percent(entry["gain"], digits=0)
    return with_interval(entry["gain"], entry["gain_ci95"], 0, 100.0, " %")
