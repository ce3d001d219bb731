"""One page: the verdict in a sentence, three pictures, the rivals, what to measure next."""

from __future__ import annotations

from html import escape

import matplotlib

from slipstitch.criticise.inference.analysis import Analysis
from slipstitch.criticise.mechanisms import MECHANISMS
from slipstitch.criticise.report.covariate_panels import covariate_picture
from slipstitch.criticise.report.pictures import (
    prediction_picture,
    ranking_picture,
    residual_picture,
)
from slipstitch.criticise.report.resimulation import before_and_after
from slipstitch.criticise.resimulation import Resimulation
from slipstitch.criticise.verdict import sentence

STYLE = """
:root { color-scheme: light; }
body { font: 17px/1.55 Georgia, 'Times New Roman', serif; color: #26323a; background: #fbfaf7;
  max-width: 46rem; margin: 3rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.55rem; line-height: 1.3; font-weight: 600; margin: .2rem 0 1rem; }
h2 { font-size: 1.1rem; margin: 2.4rem 0 .5rem; }
.case { font: 13px/1.4 system-ui, sans-serif; color: #66757d; letter-spacing: .04em;
  text-transform: uppercase; }
.verdict { border-left: 6px solid var(--tone); padding-left: 1rem; }
figure { margin: 1.6rem 0; } figure svg { width: 100%; height: auto; }
figcaption { font-size: .92rem; color: #4c5a61; }
table { border-collapse: collapse; width: 100%; font: 14px/1.45 system-ui, sans-serif; }
th, td { text-align: left; padding: .3rem .7rem .3rem 0; border-bottom: 1px solid #e4e0d6;
  vertical-align: top; }
td.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.next { background: #eef4f3; padding: .8rem 1.1rem; }
small { color: #66757d; }
"""
TONES = {"none": "#4c8c5a", "cause": "#2a7f9e", "confounded": "#c79a2b", "unknown": "#c8553d"}


def page(verdict: dict, analysis: Analysis, again: Resimulation | None = None) -> str:
    """The page as HTML; it needs no other file. ``again`` adds before and after."""
    named = verdict["verdict"] in ("cause", "confounded")
    extended = analysis.chosen.fitted if named and analysis.chosen else None
    with matplotlib.rc_context({"svg.hashsalt": "slipstitch", "font.size": 10}):
        pictures = (
            residual_picture(analysis, extended),
            prediction_picture(analysis, extended),
            ranking_picture(verdict),
        )
        everything = covariate_picture(analysis)
    captions = (
        _residual_caption(verdict, extended is not None),
        "All features: the filled shapes should match the line. "
        "What sticks out is more than noise and scatter of specimens explain.",
        "The rivals. Every model is charged for its parameters (BIC); "
        "blue: the answer. A pair in grey left of the dotted line adds nothing significant to the "
        "cause that it contains.",
    )
    figures = "".join(
        f"<figure>{picture}<figcaption>{caption}</figcaption></figure>"
        for picture, caption in zip(pictures, captions, strict=True)
    )
    tone = TONES.get(verdict["verdict"], "#66757d")
    title = escape(f"{verdict['case']}: {verdict['verdict']}")
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<meta name="viewport" content="width=device-width, initial-scale=1"><style>{STYLE}</style></head>
<body style="--tone: {tone}">
<p class="case">{escape(verdict["case"])}</p>
<div class="verdict"><h1>{escape(sentence(verdict))}</h1>
<p>{_second_sentence(verdict)}</p></div>
{figures}
{before_and_after(again) if again else ""}
{_parameters(verdict)}
{_next(verdict)}
{_everything(everything)}
{_tests(verdict)}
{_notes(verdict)}
</body></html>
"""


def _everything(picture: str) -> str:
    if not picture:
        return ""
    return (
        "<h2>What plain Coulomb friction leaves over, along everything recorded</h2>"
        f"<figure>{picture}<figcaption>Dark line: the strongest shape that was tested along a "
        "covariate; p: how often a shape as strong, anywhere, comes without a cause."
        "</figcaption></figure>"
    )


def _second_sentence(verdict: dict) -> str:
    gain = verdict["gain"]
    if verdict["verdict"] in ("cause", "confounded"):
        low, high = gain["ci95"]
        return (
            f"On specimens that it has not seen, the extended model gains {gain['estimate']:.2f} "
            f"[{low:.2f}, {high:.2f}] in log score a row; its error falls from "
            f"{100 * gain['rmse_null']:.1f} to {100 * gain['rmse_extended']:.1f} % "
            f"({gain['n_groups']} specimens left out one by one, the choice repeated each time)."
        )
    if verdict["verdict"] == "unknown":
        return escape(verdict["reason"]).capitalize() + "."
    p = verdict["null"]["global_p"]
    return f"Family-wise p of the plain model over all tests made: {p:.3g}."


def _residual_caption(verdict: dict, extended: bool) -> str:
    if extended:
        return (
            "What plain Coulomb friction leaves over, along what drives it, and what the extended "
            "model leaves over. Large marks are means with their standard errors."
        )
    return (
        "What plain Coulomb friction leaves over, along the covariate with the strongest trace. "
        "Large marks are means with their standard errors."
    )


def _parameters(verdict: dict) -> str:
    rows = "".join(
        f"<tr><td>{escape(name)}</td><td class=n>{p['estimate']:.4g}</td>"
        f"<td class=n>{p['ci95'][0]:.4g} … {p['ci95'][1]:.4g}</td><td>{escape(p['unit'])}</td></tr>"
        for name, p in verdict["parameters"].items()
    )
    return (
        "<h2>Parameters</h2><table><tr><th>name</th><th>estimate</th><th>95 % interval</th>"
        f"<th>unit</th></tr>{rows}</table>"
    )


def _next(verdict: dict) -> str:
    if not verdict["separate_by"]:
        return ""
    lines = "".join(
        f"<li>{escape(' with '.join(s['between'][0]))} or "
        f"{escape(' with '.join(s['between'][1]))}: "
        f"<b>{escape(s['measure'])}</b> (expected gain in log-likelihood "
        f"{s['expected_delta_loglik']:.1f})</li>"
        for s in verdict["separate_by"]
    )
    return f'<h2>What to measure next</h2><div class="next"><ul>{lines}</ul></div>'


def _tests(verdict: dict) -> str:
    rows = "".join(
        f"<tr><td>{escape(t['name'])}</td><td>{escape(t['shape'])}</td>"
        f"<td class=n>{t['p_adjusted']:.3g}</td></tr>"
        for t in verdict["residual_tests"]
    )
    which = "the chosen model" if verdict["verdict"] in ("cause", "confounded") else "the model"
    return (
        f"<h2>What is left over beside {which}</h2><table><tr><th>along</th>"
        f"<th>strongest shape</th><th>p (family-wise)</th></tr>{rows}</table>"
    )


def _notes(verdict: dict) -> str:
    excluded = "; ".join(
        f"{escape(e['run_id'])}: {escape(e['reason'])}" for e in verdict["excluded_rows"]
    )
    silent = "; ".join(
        f"{escape(name)} ({escape(MECHANISMS[name].title)}): {escape(why)}"
        for name, why in verdict["not_testable"].items()
        if name in MECHANISMS
    )
    parts = []
    if excluded:
        parts.append(f"<p><small>Set aside as outliers: {excluded}.</small></p>")
    if silent:
        parts.append(f"<p><small>Cannot be tested with these data: {silent}.</small></p>")
    return "".join(parts)
