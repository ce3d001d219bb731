"""Films of cloths between the simulated ones: of which simulations, with which weights.

Where it is dragged behind its clamps, a cloth changes smoothly with the friction coefficient: the
weighted mean of two trajectories is nearly the trajectory of a coefficient between theirs. The
weights follow the tail of a dragged flexible strip, which theory gives; weights linear in friction
put the mean five times as far off. Only films that train show such cloths, and only simulations
that train are their parents: what is tested and calibrated with is simulated.
"""

import itertools
import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.config.model import Config
from slipstitch.design.grid import Simulation, digest, simulations, viewpoint_ids
from slipstitch.design.splits import sides_of_simulations
from slipstitch.design.stage_path import SIDE_M, StagePath

# Below, a cloth is pushed ahead, or falls to this side or the other, and nothing is smooth.
FROM_FRICTION = 0.4


@dataclass(frozen=True)
class Interpolation:
    """The cloth of a film: a weighted mean of simulated ones."""

    friction: float  # coefficient that the film shows
    # Simulation id -> weight; they add up to 1; all are of the film's fabric
    weights: dict[str, float]


def interpolations(config: Config) -> dict[tuple[str, str], Interpolation]:
    """Ids of simulation and viewpoint -> the cloth of that film, for films that are interpolated.

    A share, of every camera of the family ``bench_1`` ... and every simulation that trains, from
    `FROM_FRICTION` on. Coefficients are drawn between the middles of the intervals to the next at
    which the fabric trains, so that its films cover all of them.
    """
    settings = config.render.interpolation
    names = viewpoint_ids(config.render).items()
    family = [(identity, name) for identity, name in names if VIEWPOINTS[name].drawn]
    if not settings.share or not family:
        return {}
    height_m = StagePath(**dict(config.simulation.stage)).lowered_height_m
    sides = sides_of_simulations(config)
    trained: dict[tuple[str, str], list[Simulation]] = defaultdict(list)
    for simulation in simulations(config):
        if sides[simulation.id] == "train" and simulation.friction >= FROM_FRICTION:
            trained[simulation.replicate_id, simulation.material].append(simulation)
    result = {}
    for row in trained.values():
        for place, simulation in enumerate(row):
            for identity, name in family:
                draw = _drawn(config.seed, simulation.id, name)
                if next(draw) >= settings.share:
                    continue
                near = [one.friction for one in row[max(place - 1, 0) : place + 2]]
                low, high = ((simulation.friction + end) / 2 for end in (min(near), max(near)))
                friction = round(low + next(draw) * (high - low), 4)
                weights = between(row, friction, height_m)
                result[simulation.id, identity] = Interpolation(friction, weights)
    return result


def filmed_friction(simulation: Simulation, shown: Interpolation | None) -> float:
    """Coefficient that a film of a simulation shows: its own, unless its cloth is interpolated."""
    return simulation.friction if shown is None else shown.friction


def between(row: Sequence[Simulation], friction: float, height_m: float) -> dict[str, float]:
    """Weights of a fabric's simulations on either side of a coefficient, or of the one at it."""
    for below, above in itertools.pairwise(row):
        if friction <= above.friction:
            first, at, last = (
                _ahead_of_tail_m(each, SIDE_M, height_m)
                for each in (below.friction, friction, above.friction)
            )
            part = (at - first) / (last - first)
            both = {below.id: 1 - part, above.id: part}
            return {name: weight for name, weight in both.items() if weight > 0}
    return {row[-1].id: 1.0}


def _ahead_of_tail_m(friction: float, length_m: float, height_m: float) -> float:
    """From the tail's end of a dragged flexible strip to its holder, as theory gives it."""
    if height_m >= length_m:  # it hangs clear of the floor
        return 0.0
    reach = length_m + friction * height_m
    root = math.sqrt(reach**2 - length_m**2 + height_m**2)
    tail = (length_m**2 - height_m**2) / (reach + root)
    pull = friction * tail
    return tail + pull * float(np.arcsinh((length_m - tail) / pull)) if pull else tail


def _drawn(*words: object) -> Iterator[float]:
    """Numbers in 0 ... 1 that depend on the words only."""
    for count in itertools.count():
        yield int.from_bytes(digest(*words, "interpolation", count)[:8], "big") / 2**64
