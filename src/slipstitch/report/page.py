"""The page of the report: contents of the results folder as text, tables and figures."""

import os
from datetime import datetime
from itertools import pairwise
from pathlib import Path, PurePath
from typing import Any

import yaml

from slipstitch.base.page.figures import data_uri, svg_uri
from slipstitch.base.page.templates import render
from slipstitch.base.page.wording import time_of_making
from slipstitch.base.provenance import provenance_record, start_clock, write_text
from slipstitch.config import Config
from slipstitch.criticise.statement import second_sentence, statement
from slipstitch.criticise.within_runs import words
from slipstitch.design.grid import films
from slipstitch.design.trainable import view_order
from slipstitch.learning.evaluation import paper
from slipstitch.report import learning_pictures, scores
from slipstitch.report.captures import figure_6
from slipstitch.report.cost import benchmarks, cost_section, failure_table, provenance
from slipstitch.report.dataset import dataset, film
from slipstitch.report.headline import headline
from slipstitch.report.physics import convergence, physics, simulation_section
from slipstitch.report.results import Results
from slipstitch.report.status import read_runs

TEMPLATE = Path(__file__).with_name("report.html.j2")


def page_context(results: Results, now: datetime) -> dict[str, Any]:
    """Everything that the template shows: an entry a section, None or empty if it was not run."""
    config = results.config
    found = scores.Scores(
        results.json("evaluate", "metrics.json"), results.json("evaluate", "details.json")
    )
    predictions, histories = results.predictions(), results.histories()
    runs = read_runs(results.folder)
    whole = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False, width=100)
    return {
        "made": now.strftime("%-d %B %Y, %H:%M UTC"),
        "record": provenance_record("report"),
        "config": config,
        "config_file": data_uri(whole, "application/yaml"),
        "shards": films(config),
        "step": min((b - a for a, b in pairwise(config.grid.frictions)), default=None),
        "headline": headline(config, found, predictions),
        "physics": physics(results),
        "convergence": convergence(results),
        "simulations": simulation_section(results),
        "rendered": len(results.rendered()),
        "dataset": dataset(results),
        "film": film(results),
        "networks": len(histories),
        "training": svg_uri(learning_pictures.training(histories)),
        "confusions": svg_uri(learning_pictures.confusions(found.details)),
        "paper": paper,
        "test_sets": scores.test_sets(found),
        "table_2": scores.table_2(found, view_order(config)[0]),
        "unseen_texture": scores.unseen_texture(found, view_order(config)[0]),
        "table_3": scores.table_3(found, view_order(config)[0]),
        "figure_6": figure_6(results, predictions),
        "alarms": scores.alarms(found),
        "criticism": criticism_section(results),
        "audit": results.json("audit", "audit.json"),
        "release_preview": results.picture("release", "previews", "through_time.png"),
        "cost": cost_section(benchmarks(results.folder)),
        "runs": len(runs),
        "failures": failure_table(results.folder, runs),
        "provenance": provenance(results),
    }


def criticism_section(results: Results) -> list[dict[str, Any]]:
    """Verdict, picture and gain of every case that was judged.

    Measured cases come first, of these the ones with a finding; the first case and the first
    surrogate, which is simulated with a hidden effect, are to be ``shown``.
    """
    shown = []
    for name in [PurePath(case).name for case in results.config.criticise.cases]:
        verdict = results.json("criticise", name, "verdict.json")
        if verdict is None:
            continue
        again = results.json("criticise", name, "resimulation.json") or {}
        shown.append(
            {
                "name": name,
                "title": name.replace("_", " ").capitalize(),
                "surrogate": name.startswith("surrogate"),
                "verdict": _first_sentence(statement(verdict)),
                "finding": _finding(verdict),
                "again": again.get("all"),
                "picture": results.picture("criticise", name, "picture.svg"),
            }
        )
    shown.sort(key=lambda case: (case["surrogate"], case["finding"] is None))
    kinds = [case["surrogate"] for case in shown]
    return [case | {"shown": kinds.index(case["surrogate"]) == k} for k, case in enumerate(shown)]


def _finding(verdict: dict[str, Any]) -> str | None:
    """What the simulation gets wrong, with its gain; None where nothing was found."""
    if verdict["verdict"] in ("cause", "confounded", "unknown"):
        return f"{_first_sentence(statement(verdict))} {second_sentence(verdict)}"
    return next(iter(words(verdict.get("within_runs", {}))), None)


def _first_sentence(text: str) -> str:
    """The text up to its first full stop."""
    return text.partition(". ")[0].rstrip(".") + "."


def write_report(
    config: Config, results: str | os.PathLike, out: str | os.PathLike
) -> dict[str, Any]:
    """Write the page and return its context; BadInput if a file cannot be read."""
    started = start_clock()
    found = Results(results, config)
    context = page_context(found, time_of_making())
    record = provenance_record("report", inputs=found.read, config=config, started=started)
    write_text(out, render(TEMPLATE, **context), record)
    return context
