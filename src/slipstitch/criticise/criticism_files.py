"""The criticism of one case as files: verdict, page, extended model, runs simulated again."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.stats import binomtest

from slipstitch import __version__
from slipstitch.base.provenance import provenance_record, start_clock, write_json, write_text
from slipstitch.criticise.case import Case
from slipstitch.criticise.expected_traces import ASSUMPTIONS, assumptions_of, expected
from slipstitch.criticise.inference.certificate import certificate, of_design, plain_model
from slipstitch.criticise.inference.state import State
from slipstitch.criticise.measurements import assemble
from slipstitch.criticise.statement import false_alarm_words, statement
from slipstitch.criticise.verdict import analyse
from slipstitch.criticise.verdict_data import extended_model, verdict_of

NO_ALARM = ("none", "insufficient")


def false_alarms(null: State, campaigns: int, seed: int, replicates: int) -> dict:
    """How often campaigns that hold nothing are said to hold something, with a 95 % interval.

    Features are drawn from a fitted null and judged, from the fit of the scatter to the verdict.
    Instruments and scatters are normal, sensors' zeros as usual; bounds stay what they are.
    """
    rng = np.random.default_rng([seed, 23])
    m, alarms = null.measurements, 0
    for number in range(campaigns):
        y = np.where(m.lower_bound, m.y, null.fitted.prediction)
        for group in null.groups:
            zeros = m.zero_columns[group.index]
            drawn = group.drawn(null.scatters[group.protocol], rng, 1)[:, 0]
            y[group.index] += drawn + zeros @ rng.standard_normal(zeros.shape[1])
        campaign = replace(m, y=y, rows=m.rows.assign(y=y), implausible=())
        alarms += analyse(campaign, seed + number, replicates).verdict not in NO_ALARM
    interval = binomtest(alarms, campaigns).proportion_ci(method="wilson")
    return {
        "estimate": round(alarms / campaigns, 4),
        "ci95": [round(float(end), 4) for end in interval],
        "campaigns": campaigns,
    }


def finite(content: Any) -> Any:
    """Plain data with None (``null``) for every number that could not be computed."""
    if isinstance(content, dict):
        return {key: finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [finite(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content


def criticise_to_files(
    case: Case, seed: int, replicates: int, paths: Mapping[str, Any], campaigns: int = 0
) -> str:
    """Criticise a case, write what is asked for, and say in a sentence what was found.

    Parameters
    ----------
    paths : of the ``verdict`` and, where wanted, the ``page`` (HTML, or Markdown by its name),
        ``picture`` (SVG), ``model`` (YAML) and ``resimulation``.
    seed, replicates : of the simulated maxima; simulated data sets behind each family-wise p.
    campaigns : simulated in which nothing is hidden, for the rate of false alarms.
    """
    record = partial(_record, case, seed, replicates, campaigns, start_clock())
    analysis = analyse(assemble(case), seed, replicates)
    verdict = verdict_of(case, analysis, seed, __version__)
    if campaigns:
        m = replace(analysis.measurements, sound_sensors=False)
        null = replace(analysis.null_state, measurements=m)
        rate = false_alarms(null, campaigns, seed, replicates)
        verdict["certificate"]["false_alarm_rate"] = rate
    write_json(paths["verdict"], finite(verdict), record())
    again = None
    if path := paths.get("resimulation"):
        from slipstitch.criticise.resimulation import FEWEST_SPECIMENS, resimulate_left_out

        why = "no drop-and-drag runs to simulate"
        if "drop_drag" in case.protocols:
            again = resimulate_left_out(case, seed, replicates)
            why = f"fewer than {FEWEST_SPECIMENS} specimens: none can be left out"
        summary = again.summary if again else {"case": case.name, "reason": why}
        write_json(path, finite(summary), record())
    if path := paths.get("page"):
        from slipstitch.criticise.report.verdict_page import markdown, page

        as_text = Path(path).suffix == ".md"
        text = markdown(case, verdict, analysis) if as_text else page(verdict, analysis, again)
        write_text(path, text, record())
    if path := paths.get("picture"):
        from slipstitch.base.page.figures import svg
        from slipstitch.criticise.report.verdict_pictures import residual_picture

        write_text(path, svg(residual_picture(analysis)), record())
    if path := paths.get("model"):
        text = yaml.safe_dump(extended_model(verdict), sort_keys=False)
        write_text(path, text, record())
    return statement(verdict)


def _record(
    case: Case, seed: int, replicates: int, campaigns: int, started: tuple[float, float]
) -> dict[str, Any]:
    """Where a file on a case comes from."""
    return provenance_record(
        "criticise",
        inputs=case.files,
        config={"replicates": replicates, "campaigns": campaigns},
        seed=seed,
        started=started,
    )


def power_to_file(case: Case, seed: int, replicates: int, path: str, campaigns: int = 0) -> str:
    """Write what a design could show as JSON, and say it, a line a mechanism."""
    started = start_clock()
    assumed = assumptions_of(case)
    design = expected(case, assumed, seed)
    plain = plain_model(design, assumed)
    shown = certificate(of_design(plain, seed, replicates))
    if campaigns:
        shown["false_alarm_rate"] = false_alarms(plain, campaigns, seed, replicates)
    record = _record(case, seed, replicates, campaigns, started)
    write_json(path, {"case": case.name, "seed": seed, "assumed": assumed, **shown}, record)
    lines = ["assumed (meta.json may say otherwise under design):"]
    for known in ASSUMPTIONS:
        if known.name in assumed:
            unit = "" if known.unit == "1" else f" {known.unit}"
            lines.append(f"  {known.name}: {assumed[known.name]:g}{unit}, {known.meaning}")
    lines.append(f"seen in {100 * shown['power']:.0f} of 100 campaigns like {case.name}, from")
    if not shown["smallest_detectable"]:
        lines[-1] = f"{case.name}: every reading would be only a bound: nothing can be seen"
    for name, entry in shown["smallest_detectable"].items():
        size, named_from, unit = (entry[key] for key in ("size", "named_from", "unit"))
        named = "only noticed" if named_from is None else f"named from {named_from:.3g} {unit}"
        seen = "never" if size is None else f"{size:.3g} {unit}, {named}"
        lines.append(f"  {name}: {seen}")
    if campaigns:
        lines.append(false_alarm_words(shown))
    return "\n".join(lines)
