"""The report's page: what the results folder holds, put into words, tables and pictures."""

import base64
import io
import os
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import jinja2
import yaml
from PIL import Image

from slipstitch import __version__
from slipstitch.calibrate.choice import describe
from slipstitch.config import Config
from slipstitch.config.grid import Simulation, simulations, textures, viewpoints
from slipstitch.errors import BadInput
from slipstitch.provenance import atomic_path, provenance_record, start_clock, write_sidecar
from slipstitch.report import paper, pictures
from slipstitch.report.results import Benchmark, Results, Trajectory
from slipstitch.status.runs import Failure

# A page that a browser opens at once, at the paper's scale too.
MOST_FRICTIONS_SHOWN = 6
MOST_SHEETS_SHOWN = 6
SHEET_WIDTH = 1000
# The middle of the first forward stroke (paper, Sec. 4.1: 7 s down, then 31 s a stroke).
MID_STROKE_S = 22.5

SPLIT_TITLES = {
    "by_video": "videos held out (the paper’s split)",
    "by_simulation": "whole simulations held out",
    "off_grid": "friction off the grid",
    "unseen_texture": "texture never trained on",
    "unseen_fabric": "fabric never trained on",
}
MODEL_TITLES = {
    "lrcn_baseline": "baseline network",
    "lrcn_conditional": "network given the material",
    "instrument": "instrument",
}


def data_uri(content: bytes | str, kind: str) -> str:
    """A picture as a ``data:`` address, so that the page needs no other file."""
    raw = content.encode() if isinstance(content, str) else content
    return f"data:{kind};base64,{base64.b64encode(raw).decode()}"


def _svg(content: str | None) -> str | None:
    return None if content is None else data_uri(content, "image/svg+xml")


def spread(items: Sequence[Any], most: int) -> list[Any]:
    """At most that many items, evenly from first to last.

    Parameters
    ----------
    items : sequence
    most : int
        At least 2 if there are more items than that.
    """
    if len(items) <= most:
        return list(items)
    return [items[round(index * (len(items) - 1) / (most - 1))] for index in range(most)]


def percent(share: float | None) -> str:
    """A share as the tables show it; a dash where there is none."""
    return "–" if share is None else f"{100 * share:.1f} %"


def duration(seconds: float | None) -> str:
    """A time in the unit that reads best."""
    if seconds is None or seconds != seconds:
        return "–"
    if seconds < 100:
        return f"{seconds:.1f} s"
    if seconds < 100 * 60:
        return f"{seconds / 60:.1f} min"
    return f"{seconds / 3600:.1f} h"


def scale_in_words(config: Config) -> str:
    """What the grid holds, in one line."""
    grid = config.grid
    names = len(config.render.textures) + len(config.render.test_textures)
    views = len(config.render.viewpoints) + len(config.render.test_viewpoints)
    count = len(grid.materials) * len(grid.frictions) * grid.replicates
    return (
        f"{_count(len(grid.materials), 'fabric')} × "
        f"{_count(len(grid.frictions), 'friction coefficient')} × "
        f"{_count(grid.replicates, 'replicate')} = {_count(count, 'simulation')}; "
        f"{_count(names, 'texture')} × {_count(views, 'viewpoint')} = "
        f"{_count(count * names * views, 'video')} of {config.sample.frames} frames at "
        f"{config.render.pixels} × {config.render.pixels} pixels"
    )


def _count(number: int, word: str) -> str:
    return f"{number:,} {word}{'' if number == 1 else 's'}".replace(",", "\u202f")


def _headline(config: Config, metrics, details) -> dict[str, Any] | None:
    """The result that counts: friction on simulations that no network has seen."""
    for split in ("by_simulation", "by_video"):
        rows = (metrics or {}).get(split, {})
        scored = {name: row for name, row in rows.items() if row.get("friction_lt_0.1") is not None}
        if not scored:
            continue
        best = max(scored, key=lambda name: scored[name]["friction_lt_0.1"])
        detail = details.get(split, {}).get(_NETWORKS.get(best, best), {})
        chance = detail.get("chance", {})
        return {
            "split": SPLIT_TITLES[split],
            "model": MODEL_TITLES.get(best, best),
            "share": scored[best]["friction_lt_0.1"],
            "error": scored[best].get("mean_absolute_error"),
            "chance": chance.get("uniform", 1.0 / len(config.grid.frictions)),
            "majority": chance.get("majority"),
            "chance_error": chance.get("mean_absolute_error"),
            "n": scored[best]["n"],
            "simulations": detail.get("simulations"),
            "classes": len(config.grid.frictions),
        }
    return None


def _table_2(metrics) -> list[dict[str, Any]]:
    """The paper's Table 2 with ours for both splits."""
    rows = []
    for network, model, measure, title in (
        ("material_baseline", "lrcn_baseline", "material_top1", "Material, first guess"),
        ("material_baseline", "lrcn_baseline", "material_top2", "Material, first two guesses"),
        (
            "friction_baseline",
            "lrcn_baseline",
            "friction_lt_0.1",
            "Friction, error < 0.1, baseline",
        ),
        (
            "friction_baseline",
            "lrcn_baseline",
            "friction_lt_0.2",
            "Friction, error < 0.2, baseline",
        ),
        (
            "friction_conditional",
            "lrcn_conditional",
            "friction_lt_0.1",
            "Friction, error < 0.1, given the material",
        ),
        (
            "friction_conditional",
            "lrcn_conditional",
            "friction_lt_0.2",
            "Friction, error < 0.2, given the material",
        ),
    ):
        rows.append(
            {
                "title": title,
                "paper": paper.TABLE_2.get((network, measure)),
                **{
                    split: ((metrics or {}).get(split, {}).get(model) or {}).get(measure)
                    for split in ("by_video", "by_simulation")
                },
            }
        )
    return rows


_NETWORKS = {"lrcn_baseline": "friction_baseline", "lrcn_conditional": "friction_conditional"}


def _alarms(details) -> list[dict[str, Any]]:
    """How often the instruments' alarm is raised, a row an instrument."""
    return [
        {"split": SPLIT_TITLES[split], "seed": seed, "shares": shares}
        for split in ("by_simulation", "by_video")
        for seed, shares in details.get(split, {}).get("instrument", {}).get("alarms", {}).items()
    ]


def _test_sets(metrics, details) -> list[dict[str, Any]]:
    """Every test set of metrics.json with its models, and what chance would give."""
    groups = []
    for split, models in (metrics or {}).items():
        rows = []
        trained_on = None
        for model, row in models.items():
            network = _NETWORKS.get(model, model)
            detail = details.get(split, {}).get(network, {})
            trained_on = detail.get("trained_on")
            quoted = paper.UNSEEN_TEXTURE if split == "unseen_texture" else {}
            rows.append(
                {
                    "model": MODEL_TITLES.get(model, model).replace("network", "").strip(),
                    **row,
                    "simulations": detail.get("simulations"),
                    "seeds": len(row.get("seeds") or []) or None,
                    "chance": detail.get("chance", {}),
                    "paper": {
                        measure: quoted.get((network, measure))
                        for measure in ("friction_lt_0.1", "friction_lt_0.2")
                    },
                }
            )
        groups.append(
            {
                "split": SPLIT_TITLES.get(split, split.replace("_", " ")),
                "trained_on": trained_on.replace("_", " ")
                if trained_on and trained_on != split
                else None,
                "rows": rows,
            }
        )
    return groups


def _simulations(results: Results) -> dict[str, Any]:
    config = results.config
    planned = simulations(config)
    done = results.simulated()
    frictions = spread(config.grid.frictions, MOST_FRICTIONS_SHOWN)
    shown = [one for one in done if one.friction in frictions]
    trajectories: list[Trajectory] = list(results.trajectories(shown))
    first = {}
    for one in trajectories:
        first.setdefault((one.simulation.material, one.simulation.friction), one)
    cpu = sorted(one.cpu_s for one in trajectories if one.cpu_s is not None)
    return {
        "planned": len(planned),
        "done": len(done),
        "missing": [one.id for one in planned if one not in done],
        "frictions": frictions,
        "all_frictions": len(frictions) == len(config.grid.frictions),
        "profiles": _svg(pictures.profiles(list(first.values()))),
        "tails": _svg(pictures.tails(trajectories)),
        "residual": max((one.residual for one in trajectories), default=None),
        "tolerance": max(
            (one.tolerance for one in trajectories if one.tolerance is not None), default=None
        ),
        "cpu_median": cpu[len(cpu) // 2] if cpu else None,
        "cpu_largest": cpu[-1] if cpu else None,
        "duration": max((float(one.time_s[-1]) for one in trajectories), default=None),
        "sheets": _sheets(results, done),
    }


def _sheets(results: Results, done: Sequence[Simulation]) -> list[dict[str, str]]:
    """Contact sheets of some simulations, made small."""
    having = [one for one in done if one.replicate_id == "r00" and results.preview(one)]
    ends = (min(results.config.grid.frictions), max(results.config.grid.frictions))
    having.sort(key=lambda one: (one.friction not in ends, one.material_id, one.friction))
    chosen = [one for one in having if one.friction in ends] or having
    sheets = []
    for one in spread(chosen, MOST_SHEETS_SHOWN):
        path = results.preview(one)
        try:
            with Image.open(path) as image:
                small = image.convert("RGB")
                if small.width > SHEET_WIDTH:
                    height = round(small.height * SHEET_WIDTH / small.width)
                    small = small.resize((SHEET_WIDTH, height), Image.Resampling.LANCZOS)
                buffer = io.BytesIO()
                small.save(buffer, "WEBP", quality=82, method=6)
        except OSError as error:
            raise BadInput(f"{path}: not an image: {error}") from None
        sheets.append(
            {
                "id": one.id,
                "title": f"{one.material}, µ = {one.friction:g}",
                "image": data_uri(buffer.getvalue(), "image/webp"),
            }
        )
    return sheets


def _physics(results: Results) -> dict[str, Any] | None:
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
                "measured": _yes_no(check["measured"])
                if yes_no
                else _quantity(check["measured"], scale, shown),
                "theory": _yes_no(check["theory"])
                if yes_no
                else _quantity(check["theory"], scale, shown),
                "error": "" if yes_no else _quantity(check["error"], error_scale, error_unit, 2),
                "demand": "" if yes_no else _quantity(check["demand"], error_scale, error_unit, 2),
                "met": check["met"],
            }
        )
    return {
        "checks": checks,
        "met": sum(check["met"] for check in checks),
        "settings": calibration.get("settings", {}),
        "figure": _svg(pictures.calibration(calibration))
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
            "strain": _quantity(trial["strain_error"], 1.0, "", 2),
            "friction": _quantity(trial["friction_error"], 1.0, "", 2),
            "wrong": f"{trial['wrong_regimes']} of {len(trial['runs'])}",
            "cpu": f"{trial['cpu_s']:.0f} s",
            "meets": trial["meets"],
            "chosen": trial["settings"] == strip["chosen"]["settings"],
            "may_be_chosen": trial["may_be_chosen"],
        }
        for trial in strip["trials"]
    ]
    return {
        "figure": _svg(pictures.strip(calibration)),
        "settings_figure": _svg(pictures.settings(calibration)),
        "rows": rows,
        "demand": strip["demand"],
        "not_told": strip["not_told"],
    }


def _convergence(results: Results) -> dict[str, Any] | None:
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
                        "mean": _quantity(found["mean_m"], 1e3, "mm", 2),
                        "moment": _quantity(found["mean_largest_m"], 1e3, "mm", 2),
                        "worst": _quantity(found["worst_m"], 1e3, "mm", 2),
                        "shifted": _quantity(found["shifted_mean_m"], 1e3, "mm", 2),
                        "shift": _quantity(found["event_shift_s"], 1.0, "s", 2),
                        "missing": ", ".join(found["events_missing"]),
                        "met": found["mean_largest_m"]
                        <= study["settings"]["convergence"]["mean_distance_m"],
                    }
                )
    return {
        "figure": _svg(pictures.convergence(study)),
        "rows": rows,
        "settings": study["settings"],
        "demand": _quantity(study["settings"]["convergence"]["mean_distance_m"], 1e3, "mm", 2),
        "missing": study.get("missing", []),
    }


def _refinement(kind: str, finest: str) -> str:
    """What the finest run of a kind was, from its id such as m05_f01_n61_h0."""
    side, _, halvings = finest.partition("_n")[2].partition("_h")
    if not halvings:
        return f"finest {kind}"
    return f"{side} vertices a side" if kind == "mesh" else f"time step over {2 ** int(halvings)}"


_OPTION_NAMES = {
    "friction": "µ",
    "slope_deg": "slope in degrees",
    "gravity_length_m": "gravity length in m",
}


def _yes_no(value: float | None) -> str:
    return "–" if value is None else ("yes" if value else "no")


def _quantity(value: float | None, scale: float, unit: str, digits: int = 5) -> str:
    if value is None:
        return "–"
    return f"{value * scale:.{digits}g}{' ' + unit if unit else ''}"


def _dataset(results: Results) -> dict[str, Any] | None:
    """Sampled images: by material and friction, by viewpoint and texture, and two whole videos."""
    rows = results.manifest()
    if rows is None:
        return None
    config = results.config
    by_name = {row["video"]: row for row in rows}
    grid = [one for one in simulations(config) if one.replicate_id == "r00"]
    frames = config.sample.frames
    recorded_s = (config.simulation.frames - 1) / config.simulation.frame_rate_hz
    mid_stroke = [min(frames - 1, round(MID_STROKE_S / recorded_s * (frames - 1)))]
    view = viewpoints(config)[0]
    texture = textures(config)[0]

    def cell(simulation: Simulation, texture_id: str, view_id: str, position: list[int]):
        row = by_name.get(f"{simulation.id}_{texture_id}_{view_id}")
        images = results.images(row, position) if row else []
        return data_uri(images[0], "image/png") if images else None

    frictions = spread(config.grid.frictions, MOST_FRICTIONS_SHOWN)
    materials = {
        material: [
            cell(one, texture["id"], view["id"], mid_stroke)
            for one in grid
            if one.material == material and one.friction in frictions
        ]
        for material in config.grid.materials
    }
    same = [one for one in grid if one.material == grid[0].material]
    middle = same[len(same) // 2]
    views = {
        item["name"]: [
            cell(middle, kind["id"], item["id"], mid_stroke) for kind in textures(config)
        ]
        for item in viewpoints(config)
    }
    strips = []
    for one in dict.fromkeys((same[0], same[-1])):
        row = by_name.get(f"{one.id}_{texture['id']}_{view['id']}")
        positions = spread(range(frames), 10)
        images = results.images(row, list(positions)) if row else []
        if images:
            strips.append(
                {
                    "title": f"{one.material}, µ = {one.friction:g}",
                    "images": [data_uri(image, "image/png") for image in images],
                }
            )
    sides = {
        split: {
            side: sum(row[f"split_{split}"] == side for row in rows)
            for side in ("train", "validation", "test")
        }
        for split in ("by_video", "by_simulation")
    }
    held_out = {row["simulation"] for row in rows if row["split_by_simulation"] == "test"}
    return {
        "videos": len(rows),
        "images": sum(row["frames"] for row in rows),
        "frictions": frictions,
        "materials": materials,
        "view": view["name"],
        "texture": texture["name"],
        "textures": [item["name"] + _role(item) for item in textures(config)],
        "views": views,
        "middle": f"{middle.material}, µ = {middle.friction:g}",
        "strips": strips,
        "sides": sides,
        "held_out": len(held_out),
    }


def _role(item: Mapping[str, str]) -> str:
    return " (test only)" if item["role"] == "test" else ""


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
        "headline": _headline(config, metrics, details),
        "simulations": _simulations(results),
        "physics": _physics(results),
        "convergence": _convergence(results),
        "rendered": results.rendered(),
        "shards": len(simulations(config)) * len(viewpoints(config)),
        "dataset": _dataset(results),
        "training": _svg(pictures.training(histories)),
        "networks": len(histories),
        "table_2": _table_2(metrics) if metrics else None,
        "test_sets": _test_sets(metrics, details),
        "alarms": _alarms(details),
        "paper": paper,
        "coarse_grid": step is not None and step > 0.1 + 1e-9,
        "step": step,
        "confusion": _svg(pictures.confusions(predictions, frictions)),
        "cumulative": _svg(pictures.cumulative(predictions, frictions)),
        "costs": _cost_rows(benchmarks),
        "runs": len(results.runs()),
        "failures": _failure_rows(results.failures()),
        "cost_figure": _svg(pictures.costs(benchmarks)),
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
        )
        if path.exists()
    ]
    write_sidecar(out, provenance_record("report", inputs=inputs, config=config, started=started))
    return context
