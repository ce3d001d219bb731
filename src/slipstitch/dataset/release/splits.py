"""The named splits of a release: training, validation and test videos for each question.

Every split is a column ``split_<name>`` of the manifest; a video that a split does not use has no
side in it. The videos that have the same side in every split form a *part*: shards hold whole
parts, so that a split is a list of files and no image is stored twice.
"""

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from slipstitch.config import Config
from slipstitch.design.grid import Simulation, simulations
from slipstitch.design.interpolation import interpolations
from slipstitch.design.splits import SIDES

PREFIX = "split_"
Row = Mapping[str, Any]

QUESTIONS = {
    "by_video": "videos at random, as in the paper: the simulation of a test video is also in "
    "the training set, with another texture or view",
    "by_simulation": "generalisation to unseen simulations: whole simulations held out",
    "unseen_friction": "whole friction coefficients held out, between the lowest and the highest "
    "unless the grid has test-only ones; videos interpolated from or across them are left out",
    "unseen_fabric": "whole fabrics held out; videos interpolated from them are left out",
}


def question(name: str) -> str:
    """The question of a split, in words."""
    if name in QUESTIONS:
        return QUESTIONS[name]
    kind = name.removeprefix("unseen_")
    return (
        f"trained as by_video, tested with test-only {kind}s under training conditions: the "
        f"{kind} is unseen, the motion of the cloth is not"
    )


def _roles(row: Row) -> dict[str, str]:
    """Kind of variation -> train or test, from the columns ``<kind>_role``."""
    return {name.removesuffix("_role"): row[name] for name in row if name.endswith("_role")}


def may_train(row: Row) -> bool:
    """Whether nothing in a video is for testing only."""
    return "test" not in _roles(row).values()


def unseen_frictions(frictions: Sequence[float], share: float) -> list[float]:
    """Coefficients that unseen_friction tests: evenly spread between the lowest and the highest.

    Empty for fewer than three coefficients.
    """
    inner = sorted(set(frictions))[1:-1]
    if not inner:
        return []
    count = min(max(1, round(share * len(inner))), max(1, len(inner) - 1))
    places = (np.arange(count) + 0.5) * len(inner) / count
    return [inner[int(place)] for place in places]


def unseen_fabrics(materials: Sequence[str], share: float, seed: int) -> list[str]:
    """Fabrics that unseen_fabric tests, drawn at random; empty for fewer than two."""
    names = sorted(set(materials))
    if len(names) < 2:
        return []
    count = min(max(1, round(share * len(names))), len(names) - 1)
    drawn = np.random.default_rng([seed, len(names)]).permutation(names)[:count]
    return sorted(map(str, drawn))


def split_columns(rows: Sequence[Row], config: Config) -> dict[str, list[str | None]]:
    """Every named split's side of every video.

    The coefficients and fabrics that are held out are simulated ones. A video whose cloth is
    interpolated never tests them. It trains unless a held-out fabric is in its cloth, or a held-out
    coefficient is one of its simulations' or lies between these.

    Parameters
    ----------
    rows : sequence of mappings
        The sample stage's manifest: ids, columns ``split_*`` (sides), ``*_role`` (train or test),
        ``material`` and ``friction``.
    config : Config
        Its grid and interpolated films; ``release.unseen_share`` is the share of fabrics and inner
        friction coefficients that are kept for testing, the seed draws the fabrics.

    Returns
    -------
    dict
        Name of the split -> train, validation, test or None (not used), in the order of `rows`.
        Splits that have no test video or none to train on are left out.
    """
    splits: dict[str, list[str | None]] = {}
    trains = [may_train(row) for row in rows]
    for column in (name for name in rows[0] if name.startswith(PREFIX)):
        splits[column.removeprefix(PREFIX)] = [
            row[column] if trained else None for row, trained in zip(rows, trains, strict=True)
        ]
    grid = {simulation.id: simulation for simulation in simulations(config)}
    parents_of = {
        film: [grid[name] for name in shown.weights]
        for film, shown in interpolations(config).items()
    }
    parents = [parents_of.get((row["simulation"], row["viewpoint_id"]), ()) for row in rows]
    simulated = [
        row for row, of, trained in zip(rows, parents, trains, strict=True) if trained and not of
    ]
    share = config.release.unseen_share
    frictions = unseen_frictions([row["friction"] for row in simulated], share)
    fabrics = unseen_fabrics([row["material"] for row in simulated], share, config.seed)
    for name, shows in (
        ("unseen_friction", lambda row, of: _shows_friction(row, of, frictions)),
        ("unseen_fabric", lambda row, of: _shows_fabric(row, of, fabrics)),
    ):
        splits[name] = [
            _held_out(row, bool(of), shows(row, of)) if trained else None
            for row, of, trained in zip(rows, parents, trains, strict=True)
        ]
    for kind in _roles(rows[0]):
        # Where the grid itself keeps some for testing, those are the unseen ones.
        if any(row[f"{kind}_role"] == "test" for row in rows):
            name = "unseen_fabric" if kind == "material" else f"unseen_{kind}"
            splits[name] = [_unseen_kind(row, kind) for row in rows]
    return {name: sides for name, sides in splits.items() if {"train", "test"} <= set(sides)}


def _shows_friction(row: Row, parents: Sequence[Simulation], held: Collection[float]) -> bool:
    """Whether a video shows one of these coefficients, or lies between simulations around one."""
    ends = [parent.friction for parent in parents] or [row["friction"]]
    return any(min(ends) <= friction <= max(ends) for friction in held)


def _shows_fabric(row: Row, parents: Sequence[Simulation], held: Collection[str]) -> bool:
    """Whether one of these fabrics is in a video's cloth."""
    return not {row["material"], *(parent.material for parent in parents)}.isdisjoint(held)


def _held_out(row: Row, interpolated: bool, held: bool) -> str | None:
    """Side in unseen_friction or unseen_fabric; only simulated cloths test."""
    if held:
        return None if interpolated else "test"
    return "validation" if row[f"{PREFIX}by_simulation"] == "validation" else "train"


def _unseen_kind(row: Row, kind: str) -> str | None:
    """Side in unseen_<kind>: trained by video, tested on the videos whose `kind` alone is new."""
    new = [name for name, role in _roles(row).items() if role == "test"]
    if new == [kind]:
        return "test"
    side = row[f"{PREFIX}by_video"]
    return side if not new and side != "test" else None


def parts(splits: Mapping[str, Sequence[str | None]]) -> list[str]:
    """Every video's part: part00, part01, ...; equal for videos with equal sides everywhere."""
    order = {side: place for place, side in enumerate((*SIDES, None))}
    cells = list(zip(*splits.values(), strict=True))
    known = sorted(set(cells), key=lambda cell: [order[side] for side in cell])
    names = {cell: f"part{place:02d}" for place, cell in enumerate(known)}
    return [names[cell] for cell in cells]


def parts_of_splits(
    splits: Mapping[str, Sequence[str | None]], names: Sequence[str]
) -> dict[str, dict[str, list[str]]]:
    """Split -> side -> parts that make it up."""
    found: dict[str, dict[str, list[str]]] = {}
    for split, sides in splits.items():
        of_side: dict[str, set[str]] = defaultdict(set)
        for side, part in zip(sides, names, strict=True):
            if side is not None:
                of_side[side].add(part)
        found[split] = {side: sorted(of_side[side]) for side in SIDES if side in of_side}
    return found
