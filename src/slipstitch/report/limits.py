"""What a run cannot tell: said before what it can."""

from collections.abc import Mapping
from typing import Any

from slipstitch.base.page.wording import counted
from slipstitch.config import Config

FEW_SIMULATIONS = 10


def limits(
    config: Config, headline: Mapping[str, Any] | None, captures: Mapping[str, Any] | None
) -> list[str]:
    """Sentences on what the run does not show.

    Parameters
    ----------
    config : Config
    headline, captures : mapping or None
        What the page says of them.
    """
    if captures is None:
        real = "No video of a real cloth was measured: every score is for simulated videos."
    elif not captures["real"]:
        real = "No video of a real cloth was measured: the captures are surrogates, simulated too."
    else:
        real = (
            "All real videos are from one bench; scores for simulated videos do not apply to them."
        )
    grid = config.grid
    said = [
        real,
        f"The networks know {counted(len(grid.materials), 'fabric')} and friction from "
        f"{grid.frictions[0]:g} to {grid.frictions[-1]:g}, in one protocol; nothing else was "
        "tested unless a table says so.",
        "Every simulation obeys Coulomb friction with one coefficient; the section on what "
        "the simulation gets wrong shows what measured data say against that.",
    ]
    simulations = (headline or {}).get("simulations")
    if simulations and simulations < FEW_SIMULATIONS:
        said.append(
            f"With only {counted(simulations, 'test simulation')} the scores are uncertain: "
            "predictions for videos of one simulation are correlated, whatever their texture."
        )
    if len(config.train.seeds) == 1:
        said.append(
            "Every network was trained once: the spread of its scores over seeds is unknown."
        )
    return said
