"""The report's page: what the results folder holds, put into words, tables and pictures."""

import os
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import jinja2
import yaml

from slipstitch import __version__
from slipstitch.config import Config
from slipstitch.config.grid import simulations, viewpoints
from slipstitch.evaluate import paper
from slipstitch.evaluate.wording import percent
from slipstitch.provenance import atomic_path, provenance_record, start_clock, write_sidecar
from slipstitch.report import learning_pictures, pictures
from slipstitch.report.captures import captures_section
from slipstitch.report.dataset import dataset
from slipstitch.report.learning import (
    alarms,
    headline,
    not_tested,
    table_2,
    test_sets,
    unseen_texture,
)
from slipstitch.report.physics import convergence, physics
from slipstitch.report.results import Benchmark, Results
from slipstitch.report.simulations import simulation_section
from slipstitch.report.viewpoints import table_3
from slipstitch.report.wording import counted, duration, svg_uri
from slipstitch.status.runs import Failure


def scale_in_words(config: Config) -> str:
    """What the grid holds, in one line."""
    grid = config.grid
    names = len(config.render.textures) + len(config.render.test_textures)
    views = len(config.render.viewpoints) + len(config.render.test_viewpoints)
    count = len(grid.materials) * len(grid.frictions) * grid.replicates
    return (
        f"{counted(len(grid.materials), 'fabric')} × "
        f"{counted(len(grid.frictions), 'friction coefficient')} × "
        f"{counted(grid.replicates, 'replicate')} = {counted(count, 'simulation')}; "
        f"{counted(names, 'texture')} × {counted(views, 'viewpoint')} = "
        f"{counted(count * names * views, 'video')} of {config.sample.frames} frames at "
        f"{config.render.pixels} × {config.render.pixels} pixels"
    )


def _cost_rows(benchmarks: Sequence[Benchmark]) -> list[dict[str, str]]:
    return [
        {
            "stage": one.stage,
            "jobs": str(one.jobs),
            "cpu": duration(one.cpu_s),
            "wall": duration(one.wall_s),
            "cpu_median": duration(one.cpu_median_s),
            "wall_median": duration(one.wall_median_s),
            "memory": "–" if one.memory_mib is None else f"{one.memory_mib:.0f} MiB",
        }
        for one in benchmarks
    ]


def _failure_rows(failures: Sequence[Failure]) -> list[dict[str, str]]:
    return [
        {
            "when": datetime.fromtimestamp(one.time_s, UTC).strftime("%Y-%m-%d %H:%M"),
            "rule": one.rule,
            "output": ", ".join(one.output[:2]) + (" ..." if len(one.output) > 2 else ""),
            "log": ", ".join(one.log),
            "then": one.then,
        }
        for one in failures
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
        One entry a section; None or empty where a stage was not run.
    """
    config = results.config
    metrics, details = results.metrics(), results.details()
    predictions = results.predictions()
    frictions = config.grid.frictions
    benchmarks = results.benchmarks()
    histories = results.histories()
    step = closest_frictions(frictions)
    calibrated = config.calibrated_view
    captures = captures_section(results, metrics, details, predictions)
    record = provenance_record("report")
    return {
        "version": __version__,
        "made": now.strftime("%-d %B %Y, %H:%M UTC"),
        "commit": (record["git_commit"] or "unknown")[:12],
        "dirty": record["git_dirty"],
        "host": record["host_kind"],
        "scale": scale_in_words(config),
        "config": yaml.safe_dump(
            config.model_dump(mode="json"), sort_keys=False, default_flow_style=None, width=100
        ),
        "grid": config.grid,
        "headline": headline(config, metrics, details),
        "simulations": simulation_section(results),
        "physics": physics(results),
        "convergence": convergence(results),
        "rendered": results.rendered(),
        "shards": len(simulations(config)) * len(viewpoints(config)),
        "dataset": dataset(results),
        "training": svg_uri(learning_pictures.training(histories)),
        "networks": len(histories),
        "table_2": table_2(metrics, details),
        "unseen_texture": unseen_texture(metrics, details),
        "table_3": table_3(metrics, details, calibrated),
        "captures": captures,
        "not_tested": not_tested(metrics, captures) if metrics else [],
        "test_sets": test_sets(metrics, details),
        "alarms": alarms(details),
        "paper": paper,
        "coarse_grid": step is not None and step > 0.1 + 1e-9,
        "step": step,
        "confusion": svg_uri(learning_pictures.confusions(predictions, frictions)),
        "cumulative": svg_uri(learning_pictures.cumulative(predictions, frictions)),
        "costs": _cost_rows(benchmarks),
        "runs": len(results.runs()),
        "failures": _failure_rows(results.failures()),
        "cost_figure": svg_uri(pictures.costs(benchmarks)),
        "total_cpu": duration(sum(one.cpu_s for one in benchmarks)) if benchmarks else None,
        "provenance": _provenance(results),
    }


def render_page(context: Mapping[str, Any]) -> str:
    """The page as HTML.

    Parameters
    ----------
    context : mapping
        What `page_context` returned.
    """
    folder = Path(__file__).parent
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"percent": percent, "duration": duration}
    style = (folder / "style.css").read_text(encoding="utf-8")
    return environment.get_template("page.html.j2").render(**context, style=style)


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
    # Reproducible builds set the time from outside.
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    now = datetime.fromtimestamp(int(epoch), UTC) if epoch else datetime.now(UTC)
    found = Results(results, config)
    context = page_context(found, now)
    page = render_page(context)
    with atomic_path(out) as temporary:
        Path(temporary).write_text(page, encoding="utf-8")
    inputs = [
        path
        for path in (
            found.folder / "calibrate" / "calibration.json",
            found.folder / "sample" / "manifest.parquet",
            found.folder / "evaluate" / "metrics.json",
            found.folder / "evaluate" / "predictions.parquet",
            found.folder / "captures" / "metrics.json",
            found.folder / "captures" / "predictions.parquet",
        )
        if path.exists()
    ]
    write_sidecar(out, provenance_record("report", inputs=inputs, config=config, started=started))
    return context
