"""What measured data say of the friction law, and what an audit says of the released dataset."""

from pathlib import PurePath
from typing import Any

from slipstitch.base.page.figures import svg_uri
from slipstitch.criticise.statement import second_sentence, statement
from slipstitch.report.results import Results


def criticism_section(results: Results) -> list[dict[str, Any]]:
    """Verdict, picture and gain of every case of the configuration that was judged."""
    names = [PurePath(case).name for case in results.config.criticise.cases]
    shown = []
    for name in names:
        verdict = results.verdict(name)
        if verdict is not None:
            shown.append(
                {
                    "name": name,
                    "case": verdict["case"].replace("_", " "),
                    "about": verdict.get("about"),
                    "verdict": statement(verdict),
                    "gain": second_sentence(verdict),
                    "again": results.simulated_again(name),
                    "picture": svg_uri(results.criticism_picture(name)),
                }
            )
    return shown


def release_section(results: Results) -> dict[str, Any] | None:
    """What `slipstitch audit` wrote of the release; None without one."""
    audit = results.audit()
    if audit is None:
        return None
    return {**audit, "found": {kind: count for kind, count in audit["counts"].items() if count}}
