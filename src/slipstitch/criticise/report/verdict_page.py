"""One page: the verdict in a sentence, three pictures, the rivals, what to measure next."""

from __future__ import annotations

from pathlib import Path

from slipstitch.criticise.inference.analysis import Analysis
from slipstitch.criticise.mechanisms import MECHANISMS
from slipstitch.criticise.report.covariate_panels import covariate_picture
from slipstitch.criticise.report.resimulation import before_and_after
from slipstitch.criticise.report.verdict_pictures import (
    prediction_picture,
    ranking_picture,
    residual_picture,
)
from slipstitch.criticise.resimulation import Resimulation
from slipstitch.criticise.verdict import sentence
from slipstitch.page.figures import svg_element
from slipstitch.page.palette import BLUE, DOUBT, GOOD, SOFT, VERMILION
from slipstitch.page.templates import render
from slipstitch.page.wording import with_interval

_TEMPLATE = Path(__file__).with_name("verdict.html.j2")
_TONES = {"none": GOOD, "cause": BLUE, "confounded": DOUBT, "unknown": VERMILION}


def page(verdict: dict, analysis: Analysis, again: Resimulation | None = None) -> str:
    """The page as HTML; it needs no other file. ``again`` adds before and after."""
    named = verdict["verdict"] in ("cause", "confounded")
    extended = analysis.chosen.fitted if named and analysis.chosen else None
    everything = covariate_picture(analysis)
    return render(
        _TEMPLATE,
        verdict=verdict,
        tone=_TONES.get(verdict["verdict"], SOFT),
        sentence=sentence(verdict),
        second_sentence=_second_sentence(verdict),
        named=named,
        extended=extended is not None,
        residuals=svg_element(residual_picture(analysis, extended)),
        predictions=svg_element(prediction_picture(analysis, extended)),
        ranking=svg_element(ranking_picture(verdict)),
        again=before_and_after(again) if again else None,
        everything=svg_element(everything) if everything else None,
        seen=[
            (MECHANISMS[name].title, f"{found['size']:.3g}", found["unit"])
            for name, found in verdict["certificate"]["smallest_detectable"].items()
            if found["size"] is not None
        ],
        silent=[
            (name, MECHANISMS[name].title, why)
            for name, why in verdict["not_testable"].items()
            if name in MECHANISMS
        ],
    )


def _second_sentence(verdict: dict) -> str:
    gain = verdict["gain"]
    if verdict["verdict"] in ("cause", "confounded"):
        return (
            "On specimens that it has not seen, the extended model gains "
            f"{with_interval(gain['estimate'], gain['ci95'])} in log score a row; its error falls "
            f"from {100 * gain['rmse_null']:.1f} to {100 * gain['rmse_extended']:.1f} % "
            f"({gain['n_groups']} specimens left out one by one, the choice repeated each time)."
        )
    if verdict["verdict"] == "unknown":
        return verdict["reason"].capitalize() + "."
    p = verdict["null"]["global_p"]
    return f"Family-wise p of the plain model over all tests made: {p:.3g}."
