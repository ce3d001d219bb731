"""Films of cloths between simulated ones: whose, with which weights, at which coefficient."""

import numpy as np
import pytest

from slipstitch.base.errors import BadInput
from slipstitch.config import resolve_config
from slipstitch.design import interpolation
from slipstitch.design.grid import find_simulation, simulations
from slipstitch.design.interpolation import between, filmed_friction, interpolations
from slipstitch.design.splits import sides_of_simulations
from slipstitch.physics.experiments.strip_drag import flexible_strip_drag

FABRICS = ["ivory-rib-knit", "pink-ribbon-brown", "white-dots-on-blk", "navy-sparkle-sweat"]
FRICTIONS = [0.0, 0.1, 0.2, 0.4, 0.8, 1.5]


@pytest.fixture(autouse=True)
def of_all_coefficients(monkeypatch):
    monkeypatch.setattr(interpolation, "FROM_FRICTION", 0.0)


def config(share=1.0, seed=1, viewpoints=("bench_1", "bench_2", "bench_3")):
    return resolve_config(
        {
            "seed": seed,
            "grid": {"materials": FABRICS, "frictions": FRICTIONS, "replicates": 1},
            "render": {"viewpoints": [*viewpoints], "interpolation": {"share": share}},
            "train": {"splits": ["by_simulation"]},
        }
    )


def tail_m(friction):
    """Of a flexible strip as long as the cloth, dragged from the clamps' height after the drop."""
    return flexible_strip_drag(friction, 0.20, 0.15).holder_ahead_of_tail_m


def test_films_that_train_show_the_cloth_of_theory_s_tail_between_their_own_and_another():
    settings = config()
    sides = sides_of_simulations(settings)
    assert {"train", "test"} <= set(sides.values())
    found = interpolations(settings)
    # Each of three cameras, of each simulation that trains.
    assert len(found) == 3 * list(sides.values()).count("train")
    for (simulation, _), shown in found.items():
        assert simulation in shown.weights and len(shown.weights) <= 2
        assert {sides[name] for name in (simulation, *shown.weights)} == {"train"}
        assert {name[:3] for name in shown.weights} == {simulation[:3]}
        assert sum(shown.weights.values()) == pytest.approx(1, abs=1e-12)
        assert min(shown.weights.values()) > 0
        mean_m = sum(
            weight * tail_m(find_simulation(settings, name).friction)
            for name, weight in shown.weights.items()
        )
        assert mean_m == pytest.approx(tail_m(shown.friction), abs=1e-9)
        own = find_simulation(settings, simulation)
        assert filmed_friction(own, shown) == shown.friction
        assert filmed_friction(own, None) == own.friction


def test_the_films_of_a_fabric_cover_all_coefficients_between_its_first_and_last():
    settings = config()
    sides = sides_of_simulations(settings)
    for fabric in FABRICS:
        own = {one.id: one.friction for one in simulations(settings) if one.material == fabric}
        trained = [friction for name, friction in own.items() if sides[name] == "train"]
        found = interpolations(settings).items()
        shown = [one.friction for (name, _), one in found if name in own]
        assert min(trained) <= min(shown) and max(shown) <= max(trained)
        cells = np.unique(np.digitize(shown, trained), return_counts=True)[1]
        assert len(cells) == len(trained) - 1


def test_the_share_says_how_many_and_adding_cameras_changes_no_other():
    some = interpolations(config(share=0.5))
    every = interpolations(config())
    assert 0.3 < len(some) / len(every) < 0.7
    assert all(every[film] == shown for film, shown in some.items())
    fewer = interpolations(config(viewpoints=["bench_1", "bench_2"]))
    assert fewer == {film: every[film] for film in fewer}
    assert interpolations(config(share=0.0)) == {}
    assert interpolations(config(seed=2)) != every


def test_between_two_coefficients_both_weigh_and_at_one_it_alone():
    row = [one for one in simulations(config()) if one.material == FABRICS[0]]
    part = (tail_m(0.125) - tail_m(0.1)) / (tail_m(0.2) - tail_m(0.1))
    assert 0.25 < part < 0.3  # the tail gains less and less
    assert between(row, 0.125, 0.15) == pytest.approx({row[1].id: 1 - part, row[2].id: part})
    assert between(row, 0.1, 0.15) == {row[1].id: 1.0}
    assert between(row, 1.5, 0.15) == {row[-1].id: 1.0}


def test_nothing_is_interpolated_below_where_a_cloth_is_dragged_or_for_other_cameras(monkeypatch):
    monkeypatch.undo()
    settings = config()
    for (simulation, _), shown in interpolations(settings).items():
        names = {simulation, *shown.weights}
        assert min(find_simulation(settings, name).friction for name in names) >= 0.4
    with pytest.raises(BadInput, match=r"render\.interpolation\.share: only films of the family"):
        config(viewpoints=["calibrated"])
