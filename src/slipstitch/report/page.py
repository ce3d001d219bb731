"""The page of the report: contents of the results folder as text, tables and figures."""

import os
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml

from slipstitch.base.page.figures import svg_uri
from slipstitch.base.page.templates import render
from slipstitch.base.page.wording import counted, time_of_making
from slipstitch.base.provenance import provenance_record, start_clock, write_text
from slipstitch.config import Config
from slipstitch.design.grid import films
from slipstitch.learning.evaluation import paper
from slipstitch.learning.evaluation.metrics import TEST_SETS, metrics_of
from slipstitch.report import learning_pictures
from slipstitch.report.captures_section import captures_section
from slipstitch.report.cost import cost_section
from slipstitch.report.criticism import criticism_section, release_section
from slipstitch.report.dataset import dataset
from slipstitch.report.learning import (
    alarms,
    headline,
    not_tested,
    table_2,
    test_sets,
    unseen_texture,
)
from slipstitch.report.limits import limits
from slipstitch.report.physics import convergence, physics
from slipstitch.report.results import Results
from slipstitch.report.simulations import simulation_section
from slipstitch.report.status.runs import Failure
from slipstitch.report.viewpoints import table_3

TEMPLATE = Path(__file__).with_name("report.html.j2")


def scale_in_words(config: Config) -> str:
    """The grid in one line."""
    grid = config.grid
    shown = films(config)
    count = len(grid.materials) * len(grid.frictions) * grid.replicates
    return (
        f"{counted(len(grid.materials), 'fabric')} × "
        f"{counted(len(grid.frictions), 'friction coefficient')} × "
        f"{counted(grid.replicates, 'replicate')} = {counted(count, 'simulation')}; "
        f"{counted(len(config.render.texture_ids()), 'texture')}, "
        f"{counted(len(set(config.render.viewpoint_ids().values())), 'viewpoint')}: "
        f"{counted(sum(map(len, shown.values())), 'video')} of {config.sample.frames} frames at "
        f"{config.render.pixels} × {config.render.pixels} pixels"
    )


def _failure_rows(failures: Sequence[Failure]) -> list[dict[str, str]]:
    return [
        {
            "when": datetime.fromtimestamp(failure.time_s, UTC).strftime("%Y-%m-%d %H:%M"),
            "rule": failure.rule,
            "output": ", ".join(failure.output[:2]) + (" ..." if len(failure.output) > 2 else ""),
            "log": ", ".join(failure.log),
            "then": failure.then,
        }
        for failure in failures
    ]


def _provenance(results: Results) -> dict[str, Any]:
    records = results.provenance()
    rows = [
        {
            "stage": record.get("stage", "?"),
            "artefact": artefact,
            "commit": (record.get("git_commit") or "none")[:12]
            + (" + changes" if record.get("git_dirty") else ""),
            "code": (record.get("code_digest") or "?")[:12],
            "host": record.get("host_kind", "?"),
            "seed": record.get("seed"),
        }
        for artefact, record in records
    ]
    versions: dict[str, set[str]] = {}
    for _, record in records:
        for name, version in (record.get("versions") or {}).items():
            versions.setdefault(name, set()).add(version)
    return {
        "rows": rows,
        "versions": {name: ", ".join(sorted(found)) for name, found in sorted(versions.items())},
    }


def closest_frictions(frictions: Sequence[float]) -> float | None:
    """Smallest step of a grid of friction coefficients; None if it has one only."""
    return min((after - before for before, after in pairwise(sorted(frictions))), default=None)


def page_context(results: Results, now: datetime) -> dict[str, Any]:
    """Everything that the template shows.

    Parameters
    ----------
    results : Results
        The results folder.
    now : datetime
        When the page is made.

    Returns
    -------
    dict
        One entry per section; None or empty where a stage was not run.
    """
    config = results.config
    metrics, details = results.metrics(), results.details()
    predictions = results.predictions()
    frictions = config.grid.frictions
    histories = results.histories()
    step = closest_frictions(frictions)
    calibrated = config.calibrated_view
    captures = captures_section(results, metrics, details, predictions)
    found = headline(config, metrics, details, predictions)
    record = provenance_record("report")
    return {
        "made": now.strftime("%-d %B %Y, %H:%M UTC"),
        "commit": (record["git_commit"] or "unknown")[:12],
        "dirty": record["git_dirty"],
        "host": record["host_kind"],
        "scale": scale_in_words(config),
        "config": yaml.safe_dump(
            config.model_dump(mode="json"), sort_keys=False, default_flow_style=None, width=100
        ),
        "grid": config.grid,
        "headline": found,
        "limits": limits(config, next(iter(found), None), captures),
        "simulations": simulation_section(results),
        "physics": physics(results),
        "convergence": convergence(results),
        "rendered": results.rendered(),
        "shards": len(films(config)),
        "dataset": dataset(results),
        "training": svg_uri(learning_pictures.training(histories)),
        "networks": len(histories),
        "table_2": table_2(metrics, details),
        "unseen_texture": unseen_texture(metrics, details, calibrated),
        "table_3": table_3(metrics, details, calibrated),
        "drawn_turns": config.render.test_viewpoint_videos is not None,
        "captures": captures,
        "not_tested": not_tested(metrics, captures) if metrics else [],
        "criticism": criticism_section(results),
        "release": release_section(results),
        "metrics": metrics_of(TEST_SETS),
        "test_sets": test_sets(metrics, details),
        "alarms": alarms(details),
        "paper": paper,
        "coarse_grid": step is not None and step > 0.1 + 1e-9,
        "step": step,
        "confusion": svg_uri(learning_pictures.confusions(predictions, frictions)),
        "cumulative": svg_uri(learning_pictures.cumulative(predictions, frictions)),
        "runs": len(results.runs()),
        "failures": _failure_rows(results.failures()),
        "cost": cost_section(results.benchmarks()),
        "provenance": _provenance(results),
    }


def render_page(context: Mapping[str, Any]) -> str:
    """The page as HTML.

    Parameters
    ----------
    context : mapping
        What `page_context` returned.
    """
    return render(TEMPLATE, **context)


def write_report(
    config: Config, results: str | os.PathLike, out: str | os.PathLike
) -> dict[str, Any]:
    """Write the page.

    Parameters
    ----------
    config : Config
        What was to be run.
    results : path
        The results folder; stages that are missing in it are said to be missing.
    out : path
        The HTML file.

    Returns
    -------
    dict
        The page's context.

    Raises
    ------
    BadInput
        If there is no such folder, or a file in it cannot be read.
    """
    started = start_clock()
    found = Results(results, config)
    context = page_context(found, time_of_making())
    page = render_page(context)
    record = provenance_record("report", inputs=found.read, config=config, started=started)
    write_text(out, page, record)
    return context
