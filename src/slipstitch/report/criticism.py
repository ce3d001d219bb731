"""What measured data say of the friction law."""

from pathlib import PurePath
from typing import Any

from slipstitch.criticise.statement import second_sentence, statement
from slipstitch.criticise.within_runs import words
from slipstitch.report.results import Results


def criticism_section(results: Results) -> list[dict[str, Any]]:
    """Verdict, picture and gain of every case that was judged: measured ones first.

    A case with a finding stands before those without; surrogates, which are simulated with a hidden
    effect, stand last. The first of both kinds is to be ``shown``.
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
