"""What the page shows of the simulations: side views, tails, contact sheets."""

import io
from collections.abc import Sequence
from typing import Any

from PIL import Image

from slipstitch.config.grid import Simulation, simulations
from slipstitch.errors import BadInput
from slipstitch.report import pictures
from slipstitch.report.results import Results, Trajectory
from slipstitch.report.wording import data_uri, evenly, svg_uri

# A page that a browser opens at once, at the paper's scale too.
MOST_FRICTIONS_SHOWN = 6
MOST_SHEETS_SHOWN = 6
SHEET_WIDTH = 1000


def simulation_section(results: Results) -> dict[str, Any]:
    config = results.config
    planned = simulations(config)
    done = results.simulated()
    frictions = evenly(config.grid.frictions, MOST_FRICTIONS_SHOWN)
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
        "profiles": svg_uri(pictures.profiles(list(first.values()))),
        "tails": svg_uri(pictures.tails(trajectories)),
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
    for one in evenly(chosen, MOST_SHEETS_SHOWN):
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
