"""Assignment of videos to training, validation and test.

Two ways, because they answer different questions. `split_by_video` is the paper's: videos at
random, so that the simulation of a test video is in the training set too, seen from another
side or in another cloth. `split_by_simulation` keeps whole simulations from training; only it tells
what a network is worth on a cloth that it has never watched move.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.config.model import Config
from slipstitch.design.grid import simulations

SIDES = ("train", "validation", "test")


def split_by_video(
    videos: Sequence[str], validation_fraction: float, test_fraction: float, seed: int
) -> dict[str, str]:
    """Every video's side, drawn at random; at least one video tests and one trains."""
    if len(videos) < 2:
        raise BadInput(f"{len(videos)} video(s): a split by video requires at least 2")
    tests = min(max(1, round(len(videos) * test_fraction)), len(videos) - 1)
    validations = min(round(len(videos) * validation_fraction), len(videos) - 1 - tests)
    order = np.random.default_rng(seed).permutation(sorted(videos))
    sides = ["test"] * tests + ["validation"] * validations
    sides += ["train"] * (len(videos) - len(sides))
    return dict(zip(map(str, order), sides, strict=True))


def sides_of_simulations(config: Config) -> dict[str, str]:
    """Every simulation's id -> its side where whole simulations are held out.

    Those of a test-only fabric or coefficient test, those of a fabric for validation only validate,
    and others of a coefficient that is never held out train. BadInput if the grid has no valid
    split.
    """
    grid = simulations(config)
    tested = [one.id for one in grid if "test" in (one.material_role, one.friction_role)]
    apart = dict.fromkeys(tested, "test")
    for simulation in grid:
        if simulation.material in config.sample.validation_materials:
            apart.setdefault(simulation.id, "validation")
        elif simulation.friction in config.sample.train_only_frictions:
            apart.setdefault(simulation.id, "train")
    triples = {
        one.id: (one.material_id, one.friction_id, one.replicate_id)
        for one in grid
        if one.id not in apart
    }
    sample = config.sample
    shares = sample.validation_fraction, sample.test_fraction
    sides = split_by_simulation(triples.values(), *shares, config.seed, sample.hold_out)
    return {one.id: apart.get(one.id) or sides[triples[one.id]] for one in grid}


def split_by_simulation(
    simulations: Iterable[tuple[str, str, str]],
    validation_fraction: float,
    test_fraction: float,
    seed: int,
    hold_out: str = "auto",
) -> dict[tuple[str, str, str], str]:
    """Every simulation's side; no class goes untrained, no friction is tested more than another.

    With replicates (auto: if every pair has two at least), the last ones of every (material,
    friction) pair are held out. Otherwise whole pairs are, in diagonals of the table of materials
    and frictions, divided between validation and test for each friction separately, cycling through
    the materials from one that the seed gives. Of shares at least one is held out and one trains;
    BadInput if a class would be left without training.
    """
    everything = sorted(set(simulations))
    materials = sorted({material for material, _, _ in everything})
    frictions = sorted({friction for _, friction, _ in everything})
    replicates: dict[tuple[str, str], list[str]] = defaultdict(list)
    for material, friction, replicate in everything:
        replicates[material, friction].append(replicate)
    fewest = min(map(len, replicates.values()), default=0)
    if hold_out == "auto":
        hold_out = "replicate" if fewest >= 2 else "pair"
    if hold_out == "replicate" and fewest < 2:
        raise BadInput(
            "by_simulation cannot hold out replicates: a (material, friction) pair has only "
            f"{fewest} (grid.replicates must be at least 2)"
        )

    held_fraction = validation_fraction + test_fraction
    first = int(np.random.default_rng(seed).integers(max(1, len(materials))))
    sides = dict.fromkeys(everything, "train")
    for row, friction in enumerate(frictions):
        of_material = {material: replicates[material, friction] for material in materials}
        pool = _held_pool(of_material, row, first, held_fraction, hold_out)
        validations = int(len(pool) * validation_fraction / held_fraction + 1e-9)
        for place, group in enumerate(pool):
            for material, replicate in group:
                side = "validation" if place < validations else "test"
                sides[material, friction, replicate] = side
    _check_every_class_trains(sides)
    return sides


def _held_pool(
    replicates: Mapping[str, Sequence[str]], row: int, first: int, fraction: float, hold_out: str
) -> list[list[tuple[str, str]]]:
    """Groups of (material, replicate) that friction coefficient number `row` holds out, in turn."""
    materials = list(replicates)
    held = _held(len(materials), fraction) if hold_out == "pair" else len(materials)
    turn = first + row * (held if hold_out == "pair" else 1)
    around = [materials[(turn + step) % len(materials)] for step in range(held)]
    if hold_out == "pair":
        return [[(material, name) for name in replicates[material]] for material in around]
    by_age: dict[int, list] = defaultdict(list)  # all pairs' last but one, then their last
    for material in around:
        names = replicates[material]
        for age, name in enumerate(names[-_held(len(names), fraction) :]):
            by_age[age].append([(material, name)])
    return [group for age in sorted(by_age) for group in by_age[age]]


def _check_every_class_trains(sides: Mapping[tuple[str, str, str], str]) -> None:
    """Refuse a split by simulation that tests nothing, or leaves a class without training."""
    classes = [sorted({simulation[place] for simulation in sides}) for place in (0, 1)]
    if "test" not in sides.values():
        raise BadInput(
            f"by_simulation has nothing to hold out in {len(classes[0])} material(s) with one "
            "replicate each: at least 2 replicates are needed, or 2 materials"
        )
    trained = [simulation for simulation, side in sides.items() if side == "train"]
    for position, kind in enumerate(("material", "friction")):
        untrained = sorted(set(classes[position]) - {one[position] for one in trained})
        if untrained:
            raise BadInput(
                f"by_simulation would leave {kind} {untrained[0]} without any training simulation: "
                "at least 2 replicates are needed, or 2 materials with 2 friction coefficients"
            )


def _held(count: int, fraction: float) -> int:
    """Number of held-out items of `count`: at least one, never all."""
    return min(max(1, round(count * fraction)), max(0, count - 1))


def check_no_simulation_on_both_sides(simulations: Sequence[str], sides: Sequence[str]) -> None:
    """Refuse a split that tests (or validates) on a simulation that it trains on."""
    found: dict[str, set[str]] = defaultdict(set)
    for simulation, side in zip(simulations, sides, strict=True):
        found[simulation].add(side)
    leaking = sorted(name for name, where in found.items() if len(where) > 1)
    if leaking:
        where = " and ".join(side for side in SIDES if side in found[leaking[0]])
        raise BadInput(
            f"the split by simulation leaks: {leaking[0]} is in {where} "
            f"({len(leaking)} of {len(found)} simulations on more than one side)"
        )
