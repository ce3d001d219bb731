"""The criticism of one case as files: verdict, page, extended model, runs simulated again."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from slipstitch import __version__
from slipstitch.base.provenance import provenance_record, start_clock, write_json, write_text
from slipstitch.criticise.case import Case
from slipstitch.criticise.expected_traces import ASSUMPTIONS, assumptions_of, expected
from slipstitch.criticise.false_alarms import false_alarms
from slipstitch.criticise.inference.certificate import certificate, of_design, plain_model
from slipstitch.criticise.measurements import assemble
from slipstitch.criticise.statement import false_alarm_words, statement
from slipstitch.criticise.verdict import SIGNIFICANCE, analyse
from slipstitch.criticise.verdict_data import extended_model, verdict_of


def finite(content: Any) -> Any:
    """Plain data with None (``null``) for every number that could not be computed."""
    if isinstance(content, dict):
        return {key: finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [finite(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content


def criticise_to_files(
    case: Case,
    seed: int,
    replicates: int,
    *,
    campaigns: int = 0,
    verdict_path: str,
    page_path: str | None,
    picture_path: str | None,
    model_path: str | None,
    resimulation_path: str | None,
) -> str:
    """Criticise a case, write what is asked for, and say in a sentence what was found.

    Parameters
    ----------
    case : Case
    seed, replicates : int
        Of the simulated maxima; simulated data sets behind each family-wise p.
    campaigns : int
        Simulated in which nothing is hidden, for the rate of false alarms.
    verdict_path, page_path, picture_path, model_path, resimulation_path : path
        JSON, HTML (or Markdown, by its name), SVG, YAML, JSON; all but the verdict may be None.
    """
    started = start_clock()
    analysis = analyse(assemble(case), seed, replicates)
    verdict = verdict_of(case, analysis, seed, __version__)
    verdict["certificate"]["false_alarm_rate"] = _false_alarm_rate(
        replace(analysis.measurements, sound_sensors=False),
        analysis.null,
        analysis.null_state.scatters,
        campaigns,
        seed,
        replicates,
    )
    record = _record(case, seed, replicates, campaigns, started)
    write_json(verdict_path, finite(verdict), record)
    again = None
    if resimulation_path:
        from slipstitch.criticise.resimulation import FEWEST_SPECIMENS, resimulate_left_out

        why = "no drop-and-drag runs to simulate"
        if "drop_drag" in case.protocols:
            again = resimulate_left_out(case, seed, replicates)
            why = f"fewer than {FEWEST_SPECIMENS} specimens: none can be left out"
        summary = again.summary if again else {"case": case.name, "reason": why}
        record = _record(case, seed, replicates, campaigns, started)
        write_json(resimulation_path, finite(summary), record)
    if page_path or picture_path:
        from slipstitch.criticise.report import left_over, markdown, page

        if page_path:
            as_text = Path(page_path).suffix == ".md"
            text = markdown(case, verdict, analysis) if as_text else page(verdict, analysis, again)
            write_text(page_path, text, record)
        if picture_path:
            write_text(picture_path, left_over(verdict, analysis), record)
    if model_path:
        text = yaml.safe_dump(extended_model(verdict), sort_keys=False)
        write_text(model_path, text, record)
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


def _false_alarm_rate(measurements, null, scatters, campaigns, seed, replicates) -> dict | None:
    if not campaigns:
        return None
    return false_alarms(measurements, null, scatters, campaigns, seed, replicates).as_dict()


def power_to_file(case: Case, seed: int, replicates: int, path: str, campaigns: int = 0) -> str:
    """Write what a design could show as JSON, and say it, a line a mechanism."""
    started = start_clock()
    assumed = assumptions_of(case)
    design = expected(case, assumed, seed)
    plain, scatters = plain_model(design, assumed)
    found = of_design(design, plain, scatters, SIGNIFICANCE, seed, replicates)
    shown = certificate(found, SIGNIFICANCE)
    rate = _false_alarm_rate(design, plain, scatters, campaigns, seed, replicates)
    shown["false_alarm_rate"] = rate
    record = _record(case, seed, replicates, campaigns, started)
    write_json(path, {"case": case.name, "seed": seed, "assumed": assumed, **shown}, record)
    lines = ["assumed (meta.json may say otherwise under design):"]
    for assumption in ASSUMPTIONS:
        if assumption.name in assumed:
            unit = "" if assumption.unit == "1" else f" {assumption.unit}"
            lines.append(
                f"  {assumption.name}: {assumed[assumption.name]:g}{unit}, {assumption.meaning}"
            )
    lines.append(f"seen in {100 * shown['power']:.0f} of 100 campaigns like {case.name}, from")
    if not shown["smallest_detectable"]:
        lines[-1] = f"{case.name}: every reading would be only a bound: nothing can be seen"
    for name, entry in shown["smallest_detectable"].items():
        size = "never" if entry["size"] is None else f"{entry['size']:.3g} {entry['unit']}"
        lines.append(f"  {name}: {size}")
    if rate:
        lines.append(false_alarm_words(shown))
    return "\n".join(lines)
