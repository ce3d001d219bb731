"""Physics section of the report: checks against theory, convergence."""

from collections import Counter
from collections.abc import Mapping
from typing import Any

from slipstitch.base.page.figures import svg_uri
from slipstitch.base.page.wording import counted, quantity, yes_or_no
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics.calibration.choice import describe
from slipstitch.physics.simulation.convergence import studied_settings_that_differ
from slipstitch.report import physics_pictures
from slipstitch.report.results import Results

_OPTION_NAMES = {
    "friction": "µ",
    "slope_deg": "slope in degrees",
    "gravity_length_m": "gravity length in m",
}


def physics(results: Results) -> dict[str, Any] | None:
    calibration = results.calibration()
    if calibration is None:
        return None
    checks = []
    for check in calibration["checks"]:
        unit = check.get("unit", "")
        scale, shown = (1e6, "µm") if check["name"].endswith("creep") else (1.0, unit)
        if check["name"].startswith("strip-drag") and unit == "m":
            scale, shown = 1e3, "mm"
        yes_no = check["name"].endswith("sticks")
        error_scale, error_unit = (100.0, "%") if check["relative"] else (scale, shown)
        checks.append(
            {
                "name": check["name"].replace("-", " "),
                "options": ", ".join(
                    f"{_OPTION_NAMES.get(key, key)} {value:.4g}"
                    for key, value in check["options"].items()
                ),
                "measured": yes_or_no(check["measured"])
                if yes_no
                else quantity(check["measured"], scale, shown),
                "theory": yes_or_no(check["theory"])
                if yes_no
                else quantity(check["theory"], scale, shown),
                "error": "" if yes_no else quantity(check["error"], error_scale, error_unit, 2),
                "demand": "" if yes_no else quantity(check["demand"], error_scale, error_unit, 2),
                "met": check["met"],
            }
        )
    return {
        "checks": checks,
        "met": sum(check["met"] for check in checks),
        "settings": {
            name: value
            for name, value in calibration.get("settings", {}).items()
            if value is not None
        },
        "figure": svg_uri(physics_pictures.calibration(calibration))
        if calibration.get("experiments")
        else None,
        "strip": _strip(calibration),
    }


def _strip(calibration: Mapping[str, Any]) -> dict[str, Any] | None:
    """The pushed strip: pictures, and a row for every choice of settings that was tried."""
    strip = calibration.get("strip")
    if not strip:
        return None
    rows = [
        {
            "settings": describe(trial),
            "strain": quantity(trial["strain_error"], 1.0, "", 2),
            "friction": quantity(trial["friction_error"], 1.0, "", 2),
            "wrong": f"{trial['wrong_regimes']} of {len(trial['runs'])}",
            "cpu": f"{trial['cpu_s']:.0f} s",
            "meets": trial["meets"],
            "chosen": trial["settings"] == strip["chosen"]["settings"],
            "may_be_chosen": trial["may_be_chosen"],
        }
        for trial in strip["trials"]
    ]
    return {
        "figure": svg_uri(physics_pictures.strip(calibration)),
        "settings_figure": svg_uri(physics_pictures.settings(calibration)),
        "rows": rows,
        "demand": strip["demand"],
        "not_told": strip["not_told"],
    }


def convergence(results: Results) -> dict[str, Any] | None:
    study = results.convergence()
    if study is None:
        return None
    rows = []
    for row in study["summary"]:
        for key, name in (("time_step", "time step"), ("mesh", "mesh")):
            found = row[key]
            if found is not None:
                rows.append(
                    {
                        "material": row["material"],
                        "friction": row["friction"],
                        "against": _refinement(name, found.get("finest", "")),
                        "mean": quantity(found["mean_m"], 1e3, "mm", 2),
                        "moment": quantity(found["mean_largest_m"], 1e3, "mm", 2),
                        "worst": quantity(found["worst_m"], 1e3, "mm", 2),
                        "shifted": quantity(found["shifted_mean_m"], 1e3, "mm", 2),
                        "shift": quantity(found["event_shift_s"], 1.0, "s", 2),
                        "missing": ", ".join(found["events_missing"]),
                        "verdict": found["verdict"],
                    }
                )
    verdicts: dict[str, Counter] = {}
    for row in rows:
        kind = row["verdict"].partition(" (")[0]
        verdicts.setdefault(row["against"], Counter())[kind] += 1
    return {
        "figure": svg_uri(physics_pictures.convergence(study)),
        "rows": rows,
        "counted": [
            f"{counted(counts.total(), 'comparison')} with {against}: "
            + ", ".join(f"{count} {kind}" for kind, count in counts.most_common())
            for against, counts in verdicts.items()
        ],
        "settings": study["settings"],
        "demand": quantity(study["settings"]["convergence"]["mean_distance_m"], 1e3, "mm", 2),
        "missing": study.get("missing", []),
        "other_settings": studied_settings_that_differ(study["settings"], _simulated_with(results)),
    }


def _simulated_with(results: Results) -> SimulationSettings:
    """The configured settings, with those that the calibration chose."""
    chosen = (results.calibration() or {}).get("settings", {})
    return results.config.simulation.model_copy(update=chosen)


def _refinement(kind: str, finest: str) -> str:
    """Description of the finest run of a kind, from its id such as m05_f0300_n61_h0."""
    side, _, halvings = finest.partition("_n")[2].partition("_h")
    if not halvings:
        return f"finest {kind}"
    return f"{side} vertices per side" if kind == "mesh" else f"time step over {2 ** int(halvings)}"
