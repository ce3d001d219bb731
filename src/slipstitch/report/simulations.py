"""Simulations section of the report: side views, tails, contact sheets."""

import io
from collections.abc import Sequence
from typing import Any

from PIL import Image

from slipstitch.base.errors import BadInput
from slipstitch.base.page.figures import data_uri, svg_uri
from slipstitch.base.page.wording import evenly
from slipstitch.design.grid import Simulation, simulations
from slipstitch.report import physics_pictures
from slipstitch.report.results import Results, SimulationSummary

# A page that a browser opens at once, at the paper's scale too.
MOST_FRICTIONS_SHOWN = 6
MOST_SHEETS_SHOWN = 6
SHEET_WIDTH = 1000
FILM_BYTES_MAX = 3_000_000


def simulation_section(results: Results) -> dict[str, Any]:
    config = results.config
    planned = simulations(config)
    done = results.simulated()
    frictions = evenly(config.grid.frictions, MOST_FRICTIONS_SHOWN)
    shown = [simulation for simulation in done if simulation.friction in frictions]
    trajectories: list[SimulationSummary] = list(results.trajectories(shown))
    residual, tolerance = results.largest_residual()
    first: dict[tuple[str, float], SimulationSummary] = {}
    for run in trajectories:
        first.setdefault((run.simulation.material, run.simulation.friction), run)
    return {
        "planned": len(planned),
        "done": len(done),
        "missing": [simulation.id for simulation in planned if simulation not in done],
        "frictions": frictions,
        "all_frictions": len(frictions) == len(config.grid.frictions),
        "profiles": svg_uri(physics_pictures.profiles(list(first.values()))),
        "tails": svg_uri(physics_pictures.tails(trajectories)),
        "residual": residual,
        "tolerance": tolerance,
        # The table of costs has the same number.
        "cpu_median": next(
            (one.cpu_median_s for one in results.benchmarks() if one.stage == "simulate"), None
        ),
        "duration": max((float(run.time_s[-1]) for run in trajectories), default=None),
        "sheets": _sheets(results, done),
        "film": _film(results, done),
    }


def _film(results: Results, done: Sequence[Simulation]) -> dict[str, str] | None:
    """The film of the simulation in the middle of those that have one, if it is small."""
    films = [(one, results.preview(one, ".mp4")) for one in done]
    there = [(one, path) for one, path in films if path and path.stat().st_size <= FILM_BYTES_MAX]
    if not there:
        return None
    simulation, path = there[len(there) // 2]
    return {
        "title": f"{simulation.material}, µ = {simulation.friction:g}",
        "video": data_uri(results.content(path), "video/mp4"),
    }


def _sheets(results: Results, done: Sequence[Simulation]) -> list[dict[str, str]]:
    """Contact sheets of some simulations, made small."""
    having = [
        simulation
        for simulation in done
        if simulation.replicate_id == "r00" and results.preview(simulation)
    ]
    ends = (min(results.config.grid.frictions), max(results.config.grid.frictions))
    having.sort(key=lambda shown: (shown.friction not in ends, shown.material_id, shown.friction))
    chosen = [simulation for simulation in having if simulation.friction in ends] or having
    sheets = []
    for simulation in evenly(chosen, MOST_SHEETS_SHOWN):
        path = results.preview(simulation)
        assert path is not None  # of such alone is `having` made
        try:
            with Image.open(io.BytesIO(results.content(path))) as image:
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
                "id": simulation.id,
                "title": f"{simulation.material}, µ = {simulation.friction:g}",
                "image": data_uri(buffer.getvalue(), "image/webp"),
            }
        )
    return sheets
