"""The sentences follow from the predictions: a planted difference is found, none is not."""

import math
import re
from itertools import product

import numpy as np
import pytest

from slipstitch.base.errors import BadInput
from slipstitch.learning.ablation.summary import ablations_page, interval, summarise

TEXTURES = 3


def answers(
    gain, seeds=3, simulations=20, at_chance=0, failures=0, tested_on="held-out", noise=0.02
):
    """A question with two variants; the second one's errors are smaller by `gain`."""
    generator = np.random.default_rng(7)
    hard = generator.uniform(0.05, 0.15, simulations)  # errors go by simulation
    variants = (("replicates", "the first way", 0.0), ("textures", "the second way", gain))
    found = []
    for seed, (name, phrase, less) in product(range(seeds), variants):
        failed = name == "textures" and seed < failures
        predictions = []
        for number in range(0 if failed else simulations):
            error = max(0.0, hard[number] - less + generator.normal(0, noise))
            true = 0.1 + 0.1 * (number % 5)
            row = {"tested_on": tested_on, "simulation": f"s{number}"}
            row |= {"true": true, "predicted": true + error}
            videos = [f"s{number}_t{texture}" for texture in range(TEXTURES)]
            predictions += [row | {"video": video} for video in videos]
        one = {"question": "diversity", "network": "lrcn", "variant": name, "seed": seed}
        one |= {"phrase": phrase, "left_out": None, "dataset_digest": "d", "passes": 30.0}
        one |= {"training_videos": 12, "training_simulations": 6, "predictions": predictions}
        one |= {"failure": "the loss became nan" if failed else None}
        one |= {"stayed_at_chance": not failed and seed < at_chance}
        found.append(one | {"material_stayed_at_chance": False})
    return found


def summed(*words, **options):
    return summarise(answers(*words, **options))["questions"]["diversity"]


def concluded(*words, **options):
    (found,) = summed(*words, **options)["comparisons"]
    return found


def test_a_planted_difference_is_found_and_said():
    found = concluded(0.04)
    assert found["verdict"] == "better"
    assert found["low"] < -0.04 < found["high"] < 0
    assert re.fullmatch(
        r"lrcn: the second way is better than the first way: mean error smaller by 0\.0[34]\d "
        r"\(0\.0[23]\d \.\.\. 0\.0[45]\d\), 20 simulations and 3 seeds\.",
        found["sentence"],
    )
    assert concluded(-0.04)["verdict"] == "worse"
    assert "is worse than the first way: mean error larger by 0.0" in concluded(-0.04)["sentence"]


def test_equal_variants_cannot_be_told_apart():
    found = concluded(0.0)
    assert found["verdict"] == "no significant difference" and found["low"] < 0 < found["high"]
    assert "no significant difference" in found["sentence"]
    assert "with 20 simulations and 3 seeds: difference" in found["sentence"]


def test_the_rows_are_scores_with_their_spread_over_seeds():
    first, second = summed(0.04)["rows"]
    assert (first["n"], first["simulations"], first["seeds"]) == (60, 20, 3)
    assert second["mean"]["mean_absolute_error"] < first["mean"]["mean_absolute_error"]
    assert 0 < first["spread"]["mean_absolute_error"] < 0.02
    assert first["constant_error"] == pytest.approx(0.12)
    assert summed(0.04, seeds=1)["rows"][0]["spread"] is None


def test_videos_of_one_simulation_are_not_independent():
    """Copies of every video leave the interval as it is."""
    few = concluded(0.01)
    tripled = answers(0.01)
    for one in tripled:
        one["predictions"] *= 3
    (many,) = summarise(tripled)["questions"]["diversity"]["comparisons"]
    assert (few["low"], few["high"]) == pytest.approx((many["low"], many["high"]))


def test_runs_at_chance_and_diverged_ones_are_in_the_row_and_the_sentence():
    found = summed(0.04, at_chance=1)
    assert [row["stayed_at_chance"] for row in found["rows"]] == [1, 1]
    assert (
        "the second way stayed at chance with 1 of 3 seeds" in found["comparisons"][0]["sentence"]
    )
    found = concluded(0.04, at_chance=3)
    assert found["verdict"] == "nothing learnt"
    assert "both stayed at chance at this budget" in found["sentence"]
    found = concluded(0.04, failures=1)
    assert found["seeds"] == 2 and "the second way diverged with 1 of 3 seeds" in found["sentence"]
    found = concluded(0.04, failures=3)
    assert (found["verdict"], found["low"]) == ("not compared", None)
    assert "in no seed did both train without diverging" in found["sentence"]


def test_one_seed_one_simulation_and_the_test_set_are_said():
    assert "the interval does not cover other seeds" in concluded(0.04, seeds=1)["sentence"]
    found = concluded(0.04, simulations=1)
    assert found["verdict"] == "not compared" and found["difference"] is not None
    assert "one test simulation does not generalise to others" in found["sentence"]
    sentence = concluded(0.04, tested_on="mirroring floors")["sentence"]
    assert sentence.startswith("lrcn, tested on mirroring floors: ")


def test_answers_of_different_datasets_are_refused():
    mixed = answers(0.0)
    mixed[1]["dataset_digest"] = "another"
    with pytest.raises(BadInput, match="from different datasets"):
        summarise(mixed)


def test_the_page_has_every_sentence_picture_and_reason():
    left_out = {**answers(0.0)[0], "question": "floors", "left_out": "floors: mirrors are needed"}
    left_out |= {"predictions": []}
    summary = summarise([*answers(0.04), left_out])
    page = ablations_page(summary)
    (found,) = summary["questions"]["diversity"]["comparisons"]
    for text in (
        found["sentence"],
        "floors: mirrors are needed",
        "Diversity: Which additional video helps more",
    ):
        assert text in page
    assert page.count("data:image/svg+xml") == 1
    assert "Of 1 comparison, about 0.1" in page
    assert "–" in ablations_page(summarise(answers(0.04, failures=3)))


@pytest.mark.parametrize(
    ("seed_sd", "simulation_sd", "noise"),
    [(0, 1, 1), (0, 0, 1), (0.3, 1, 1), (1, 1, 1), (1, 0, 0.3)],
)
def test_the_interval_holds_as_often_as_it_says(seed_sd, simulation_sd, noise):
    """The true mean, 0, of crossed random effects of three seeds and twenty simulations."""
    generator = np.random.default_rng(0)
    hits = 0
    parts = ((seed_sd, (3, 1)), (simulation_sd, (1, 20)), (noise, (3, 20)))
    for _ in range(600):
        drawn = sum(sd * generator.normal(size=shape) for sd, shape in parts)
        _, low, high = interval(drawn)
        hits += low <= 0 <= high
    assert 0.85 <= hits / 600 <= 0.99


def test_an_interval_of_equal_differences_is_a_point():
    assert interval(np.full((3, 5), 0.02)) == (0.02, 0.02, 0.02)
    mean, low, high = interval(np.zeros((3, 1)))
    assert mean == 0 and math.isinf(low) and math.isinf(high)
