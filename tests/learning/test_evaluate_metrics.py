"""The scores mean what the paper's tables mean."""

import subprocess
import sys

import numpy as np
import pytest

from slipstitch.base.page.wording import number, percent, seeds_in_words
from slipstitch.learning.evaluation.metrics import (
    FIELDS,
    covered,
    entry,
    friction_scores,
    mean_over_seeds,
    spread_over_seeds,
    steps_off,
)
from slipstitch.learning.evaluation.scores import SCHEMA, details_of_table, metrics_of_table, scores

GRID = np.arange(16) * 0.1


def test_on_the_papers_grid_below_0_1_is_the_class_and_below_0_2_a_neighbour_at_most():
    off = [steps_off(GRID, np.full(16, true)).tolist() for true in GRID]
    assert off == [[abs(true - predicted) for predicted in range(16)] for true in range(16)]
    truth = GRID[[0, 5, 5, 10]]
    found = friction_scores(GRID[[0, 6, 8, 10]], truth)
    error = pytest.approx(0.1)
    assert found == {"friction_lt_0.1": 0.5, "friction_lt_0.2": 0.75, "mean_absolute_error": error}
    # A coarse grid counts only the exact class.
    coefficients = np.array([0.1, 0.3, 0.6])
    found = friction_scores(coefficients, coefficients[[0, 0, 2]])
    assert found["friction_lt_0.1"] == found["friction_lt_0.2"] == pytest.approx(2 / 3)


def table(network, true, predicted, fabrics=()):
    """Rows of a table of predictions of one seed, their ids being letters."""
    return [
        {
            **dict.fromkeys(SCHEMA.names),
            **{"video": f"v{k}", "simulation": f"s{k}", "viewpoint": "calibrated", "seed": 0},
            **{"split": "by_video", "trained_on": "by_video", "network": network},
            **{"true": one, "predicted": other, "material": one},
            **{"true_value": VALUES.get(one), "predicted_value": VALUES.get(other)},
            "fabrics": list(fabrics[k]) if fabrics else [],
        }
        for k, (one, other) in enumerate(zip(true, predicted, strict=True))
    ]


VALUES = {"a": 0.1, "b": 0.3, "c": 0.6, "d": 1.0}
CLASSES = [{"id": name, "value": value} for name, value in VALUES.items()]


def test_top_1_and_top_2_count_the_fabrics_from_the_likeliest_on():
    found = scores(table("material_baseline", "abc", "aca", ["abc", "cba", "abc"]))
    assert found == {"material_top1": pytest.approx(1 / 3), "material_top2": pytest.approx(2 / 3)}
    assert scores(table("material_baseline", "abd", "aca", ["abc", "cba", "abc"])) == {}


def test_chance_the_best_constant_and_confusion_with_true_classes_in_rows():
    rows = table("friction_baseline", "aaabc", "aabbb")
    models = {"by_video": {"friction_baseline": {"classes": CLASSES}}}
    found = details_of_table(rows, models, {})["by_video"]["friction_baseline"]
    error = pytest.approx((0.2 + 0.5) / 5)
    assert found["chance"] == {"uniform": 0.25, "majority": 0.6, "mean_absolute_error": error}
    assert found["confusion"] == [[2, 1, 0, 0], [0, 1, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0]]


def test_scores_need_no_torch():
    code = "import slipstitch.learning.evaluation.scores, sys; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_table_gives_an_entry_with_every_field_and_null_where_nothing_is_known():
    rows = table("friction_baseline", "ab", "ab")
    for answer, share in (({}, 1.0), ({"predicted_value": 0.6}, 0.5)):
        (one,) = metrics_of_table([rows[0], rows[1] | answer], {})["by_video"].values()
        assert one["friction_lt_0.1"] == share
    assert tuple(one) == tuple(entry(7, [0, 1], {})) == FIELDS
    assert (one["n"], one["seeds"], one["coverage_90"]) == (2, [0], None)


def test_seeds_give_a_mean_and_a_spread_and_every_simulation_counts_once():
    seeds = [{"right": 0.5, "fabric": 0.1}, {"right": 0.7}, {"right": 0.9}]
    assert mean_over_seeds(seeds) == {"right": pytest.approx(0.7)}
    assert spread_over_seeds(seeds) == {"right": pytest.approx(0.2)}
    assert spread_over_seeds(seeds[:1]) is None
    truth = np.array([0.5, 0.5, 0.5, 0.5, 2.0])
    assert covered(np.zeros(5), np.ones(5), truth, ["a"] * 4 + ["b"]) == (0.5, 0.5)


def test_a_score_is_written_with_its_spread_and_nothing_with_a_dash():
    assert percent(0.9876, 0.0123) == "98.8 ± 1.2 %"
    assert percent(0.9876) == "98.8 %"
    assert percent(None, 0.1) == number(None) == "–"
    assert number(0.05, 0.005) == "0.050 ± 0.005"
    assert (seeds_in_words(1), seeds_in_words(3)) == ("one seed only", "3 seeds")
