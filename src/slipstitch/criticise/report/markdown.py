"""The verdict in words and tables, as Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd
from scipy.stats import t as student

from slipstitch.base.page.wording import counted, with_interval
from slipstitch.criticise.case import Case
from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.covariates import COVARIATES
from slipstitch.criticise.report.verdict_pictures import relative_residuals
from slipstitch.criticise.statement import false_alarm_words, second_sentence, sentence
from slipstitch.criticise.verdict import Analysis
from slipstitch.criticise.within_runs import words

MOST_TRACES = 6


def markdown(case: Case, verdict: dict, analysis: Analysis) -> str:
    """The page of a case; what ``meta.json`` says ``about`` it stands at its beginning."""
    measured = analysis.measurements
    runs = len(np.unique(measured.run))
    specimens = len(np.unique(measured.specimen))
    parts = [
        f"# {verdict['case']}",
        str(case.meta.get("about") or ""),
        f"**{sentence(verdict)}** {second_sentence(verdict)}",
        " ".join(words(verdict["within_runs"])),
        f"Judged: {counted(len(measured.y), 'feature')} of {counted(runs, 'run')}, "
        f"{counted(specimens, 'specimen')}.",
        *_parameters(verdict),
        *_ladder(verdict),
        "## The strongest traces of structure beside plain Coulomb friction",
        _table(("along", "shape", "p (family-wise)"), _traces(analysis)),
        *_labels(analysis),
        *_of_data(verdict),
        *_of_scatter(verdict),
        *_certificate(verdict),
        *_silent(verdict),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _parameters(verdict: dict) -> list[str]:
    why = verdict["not_identified"]
    rows = [
        (
            f"{name} (not identified: {why[name]})" if name in why else name,
            f"{p['estimate']:.3g}",
            f"{p['ci95'][0]:.3g} … {p['ci95'][1]:.3g}",
            p["unit"],
        )
        for name, p in verdict["parameters"].items()
    ]
    return ["## Parameters", _table(("name", "estimate", "95 % interval", "unit"), rows)]


def _ladder(verdict: dict) -> list[str]:
    track = verdict["within_runs"].get("spring_slider")
    if track is None:
        return []
    rows = [
        (
            entry["adds"],
            f"{entry['log_score']:.2f}",
            with_interval(entry["step"], entry["step_ci95"]) if i else "",
            f"{100 * entry['error_of_weight']:.1f}",
        )
        for i, entry in enumerate(track["ladder"])
    ]
    return [
        "## Within the runs",
        f"{counted(track['slips'], 'slip')} of {counted(track['runs'], 'run')}. Every second "
        "sixteenth of a run's way is left out, and its peaks and troughs are predicted from the "
        f"rest; 95 % t-intervals over {track['pieces']} pieces of track.",
        _table(("each model adds", "log score a slip", "step", "error (% of the weight)"), rows),
    ]


def _traces(analysis: Analysis) -> list[tuple[str, str, str]]:
    outcome = analysis.null_outcome
    best: dict[str, int] = {}
    for i, test in enumerate(outcome.tests):
        if np.isfinite(outcome.log_p[i]):
            name = test.mechanism or COVARIATES[str(test.covariate)].title
            if name not in best or outcome.log_p[i] > outcome.log_p[best[name]]:
                best[name] = i
    order = sorted(best, key=lambda name: outcome.adjusted[best[name]])[:MOST_TRACES]
    shapes = [outcome.tests[best[name]].shape or "the mechanism's own" for name in order]
    p_values = [f"{outcome.adjusted[best[name]]:.2g}" for name in order]
    return list(zip(order, shapes, p_values, strict=True))


def _labels(analysis: Analysis) -> list[str]:
    """Friction by support, operator ...; an effect is told from specimens' scatter, if at all."""
    rows = analysis.measurements.rows
    residual, good = relative_residuals(analysis, analysis.null)
    parts = []
    for name, covariate in COVARIATES.items():
        if not covariate.text:
            continue
        own = good & (rows[name] != "").to_numpy()
        table = pd.DataFrame({"label": rows[name], "of": rows["specimen_id"], "y": residual})[own]
        means = table.groupby(["label", "of"])["y"].mean().groupby("label").agg(["mean", "count"])
        if len(means) < 2:
            continue
        lines = [
            (str(label), f"{m['mean']:+.1f}", str(int(m["count"]))) for label, m in means.iterrows()
        ]
        head = (covariate.title, "friction, % from the mean model", "specimens")
        parts += [f"## By {covariate.title}", _table(head, lines), _told(table)]
    return parts


def _told(table: pd.DataFrame) -> str:
    means = table.groupby(["label", "of"])["y"].mean()
    few = [label for label, count in means.groupby("label").size().items() if count < 2]
    shared = table.groupby("of")["label"].nunique().max() > 1
    if shared or len(means.groupby("label").size()) > 2:
        return ""
    if few:
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


def _of_data(verdict: dict) -> list[str]:
    rows = [
        (
            found["protocol"],
            found["sensor"],
            found["quantity"] + (", noise over what is stated" if found["kind"] == "noise" else ""),
            f"{found['size']:.3g}",
            f"{found['ci95'][0]:.3g} … {found['ci95'][1]:.3g}",
            found["unit"],
        )
        for found in verdict["data_findings"]
    ]
    head = ("protocol", "sensor", "what", "size", "95 % interval", "unit")
    return ["## What is wrong with the data themselves", _table(head, rows)] if rows else []


def _of_scatter(verdict: dict) -> list[str]:
    rows = [
        (
            found["protocol"],
            f"{100 * found['run_scatter']:.2g}",
            f"{100 * found['usual']:.2g}",
            ", ".join(COVARIATES[name].title for name in found["record_next"]) or "-",
        )
        for found in verdict["scatter_findings"]
    ]
    head = ("protocol", "scatter between runs (%)", "usual (%)", "not recorded, or always the same")
    return ["## Runs that scatter more than usual", _table(head, rows)] if rows else []


def _certificate(verdict: dict) -> list[str]:
    shown = verdict["certificate"]
    rows = [
        (
            MECHANISMS[name].title,
            f"{found['size']:.3g}",
            "-" if found["named_from"] is None else f"{found['named_from']:.3g}",
            found["unit"],
        )
        for name, found in shown["smallest_detectable"].items()
        if found["size"] is not None
    ]
    if not rows:
        return []
    return [
        "## What this design could have seen",
        f"Each of these, alone and of this size, is seen in {100 * shown['power']:.0f} of 100 such "
        f"campaigns; {false_alarm_words(shown)}.",
        _table(("mechanism", "smallest size seen", "named from", "unit"), rows),
    ]


def _silent(verdict: dict) -> list[str]:
    lines = [
        f"- {name} ({MECHANISMS[name].title}): {why}"
        for name, why in verdict["not_testable"].items()
        if name in MECHANISMS
    ]
    return ["## What these data cannot tell", "\n".join(lines)] if lines else []
