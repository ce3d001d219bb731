"""The scores mean what the paper's tables mean."""

import numpy as np
import pytest

from slipstitch.base.errors import BadInput
from slipstitch.base.page.wording import number, percent, seeds_in_words
from slipstitch.learning.evaluation.metrics import (
    FIELDS,
    chance,
    confusion,
    constant_error,
    entry,
    friction_scores,
    material_scores,
    mean_over_seeds,
    spread_over_seeds,
    steps_off,
)

GRID = np.arange(16) * 0.1


def certain(predicted, classes):
    """Probabilities that leave no doubt."""
    return np.eye(classes)[predicted]


def test_on_the_papers_grid_below_0_1_is_the_class_and_below_0_2_a_neighbour_at_most():
    for true in range(16):
        off = steps_off(GRID, np.full(16, GRID[true]), 0.1)
        assert off.tolist() == [abs(true - predicted) for predicted in range(16)]


def test_friction_scores_of_known_answers():
    truth = np.array([0, 5, 5, 10])
    scores = friction_scores(GRID[[0, 6, 8, 10]], GRID[truth], 0.1)
    assert scores == {
        "friction_lt_0.1": 0.5,
        "friction_lt_0.2": 0.75,
        "mean_absolute_error": pytest.approx(0.1),
    }


def test_a_coarse_grid_counts_only_the_exact_class():
    coefficients = np.array([0.1, 0.3, 0.6])
    scores = friction_scores(coefficients, coefficients[[0, 0, 2]], 0.1)
    assert scores["friction_lt_0.1"] == scores["friction_lt_0.2"] == pytest.approx(2 / 3)


def test_top_1_and_top_2():
    shares = np.array([[0.5, 0.3, 0.2], [0.1, 0.3, 0.6], [0.4, 0.35, 0.25]])
    truth = np.array([0, 1, 2])
    assert material_scores(shares, truth) == {
        "material_top1": pytest.approx(1 / 3),
        "material_top2": pytest.approx(2 / 3),
    }


def test_chance_and_the_best_constant():
    truth = np.array([0, 0, 0, 1, 2])
    assert chance(truth, 4) == {"uniform": 0.25, "majority": 0.6}
    coefficients = np.array([0.1, 0.3, 0.6, 1.0])
    assert constant_error(coefficients[truth]) == pytest.approx((0.2 + 0.5) / 5)


def test_confusion_has_true_classes_in_rows():
    assert confusion(certain([1, 1, 0], 2), np.array([0, 1, 1])) == [[0, 1], [1, 1]]


def test_an_entry_has_every_field_and_null_where_nothing_is_known():
    one = entry(7, [0, 1], {"friction_lt_0.1": 0.5})
    assert tuple(one) == FIELDS
    assert one["n"] == 7 and one["seeds"] == [0, 1] and one["coverage_90"] is None


@pytest.mark.parametrize(
    ("shares", "truth"),
    [
        (np.array([[0.5, 0.6]]), np.array([0])),
        (np.array([[np.nan, 1.0]]), np.array([0])),
        (np.array([[0.5, 0.5]]), np.array([2])),
        (np.array([[0.5, 0.5]]), np.array([0, 1])),
        (np.zeros((0, 2)), np.zeros(0, int)),
    ],
)
def test_what_is_no_prediction_is_refused(shares, truth):
    with pytest.raises(BadInput):
        material_scores(shares, truth)


def test_seeds_give_a_mean_and_their_standard_deviation():
    seeds = [{"right": 0.5, "fabric": 0.1}, {"right": 0.7}, {"right": 0.9}]
    assert mean_over_seeds(seeds) == {"right": pytest.approx(0.7)}
    assert spread_over_seeds(seeds) == {"right": pytest.approx(0.2)}
    assert spread_over_seeds(seeds[:1]) is None


def test_a_score_is_written_with_its_spread_and_nothing_with_a_dash():
    assert percent(0.9876, 0.0123) == "98.8 ± 1.2 %"
    assert percent(0.9876) == "98.8 %"
    assert percent(None, 0.1) == number(None) == "–"
    assert number(0.05, 0.005) == "0.050 ± 0.005"
    assert (seeds_in_words(1), seeds_in_words(3)) == ("one seed only", "3 seeds")
