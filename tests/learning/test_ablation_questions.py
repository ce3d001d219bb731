"""Which videos train the variants of a question, and the sentences that follow from the results."""

import math
import re
from collections import Counter
from itertools import product

import numpy as np
import pytest

from slipstitch.base.errors import BadInput
from slipstitch.config import resolve_config
from slipstitch.config.train import QUESTIONS, AblateSettings
from slipstitch.dataset.videos import ROLES
from slipstitch.learning.ablation.questions import QUESTIONS as ASKED
from slipstitch.learning.ablation.questions import selected
from slipstitch.learning.ablation.summary import ablations_page, interval, summarise

VIEWS = ["calibrated", "side"]


def manifest(replicates=4, textures=3, mirrors=(1, 3)):
    """2 materials, 3 coefficients; the last replicate of each pair is held out.

    Replicates in `mirrors` lie on a mirroring floor; so do the held-out ones of the first material.
    """
    rows = []
    for m, f, r, t, v in product(range(2), range(3), range(replicates), range(textures), range(2)):
        simulation = f"m{m:02d}_f{100 + 300 * f:04d}_r{r:02d}"
        held = r == replicates - 1
        names = ("material_id", "friction_id", "replicate_id")
        row = dict(zip(names, simulation.split("_"), strict=True))
        row |= {f"{kind}_role": "train" for kind in ROLES}
        row |= {"video": f"{simulation}_t{t:02d}_v{v:02d}", "simulation": simulation}
        row |= {"texture_id": f"t{t:02d}", "viewpoint": VIEWS[v], "friction": 0.1 + 0.3 * f}
        row["floor_reflectance"] = 0.5 * ((m == 0) if held else (r in mirrors))
        row["split_by_simulation"] = "test" if held else "train"
        rows.append(row)
    return rows


ROWS = manifest()


def planned(question, rows=ROWS, seed=0, views=VIEWS, **settings):
    return selected(question, rows, views, AblateSettings(**settings), seed)[1]


def chosen(ids, rows=ROWS):
    return [row for row in rows if row["video"] in ids]


def counted(ids, *names, rows=ROWS):
    """How many videos there are of each combination of values."""
    return Counter(tuple(row[name] for name in names) for row in chosen(ids, rows))


@pytest.mark.parametrize("question", QUESTIONS)
def test_variants_train_on_equally_many_videos_and_test_on_none_of_their_simulations(question):
    for seed in range(3):
        found = planned(question, seed=seed)
        assert len({len(videos) for videos in found.training.values()}) == 1
        tested = set().union(*found.tests.values())
        assert set(found.training) == set(ASKED[question].variants)
        for videos in found.training.values():
            trained = counted(videos, "simulation")
            assert trained and not trained.keys() & counted(tested, "simulation").keys()
            of_friction = counted(videos, "friction_id")
            assert len(of_friction) == 3 and len(set(of_friction.values())) == 1
        views = {view for (view,) in counted(tested, "viewpoint")}
        assert views == set(VIEWS if question == "schedule" else VIEWS[:1])


def test_diversity_is_three_replicates_in_one_texture_against_one_in_three():
    many, one = planned("diversity").training.values()
    for videos, simulations, each in ((many, 6 * 3, 1), (one, 6, 3)):
        by_simulation = counted(videos, "simulation")
        assert len(by_simulation) == simulations and set(by_simulation.values()) == {each}
    # No texture is rarer in the one than in the other.
    names = ("friction_id", "texture_id")
    assert counted(many, *names) == counted(one, *names)
    # With fewer replicates than textures both get as many as there are replicates.
    rows = manifest(replicates=3, textures=4)
    found = planned("diversity", rows)
    assert all(len(videos) == 6 * 2 for videos in found.training.values())
    textures = counted(found.tests["held-out"], "texture_id", rows=rows)
    assert set(textures) == {("t00",), ("t01",)}  # none that has not been trained on
    # Seeds draw other videos, and the same seed the same.
    first, again, other = (
        planned("diversity", seed=seed).training["textures"] for seed in (0, 0, 1)
    )
    assert first == again != other


def test_textures_are_dealt_evenly_among_the_simulations_of_a_coefficient():
    videos = planned("initialisation").training["he"]
    assert len(videos) == 6 * 3  # a video a training simulation
    assert set(counted(videos, "friction_id", "texture_id").values()) == {2}


def test_the_floors_exchange_mirrors_for_matte_simulations_of_the_same_coefficient():
    found = planned("floors")
    matte, mixed = (
        [row["floor_reflectance"] > 0 for row in chosen(videos)]
        for videos in found.training.values()
    )
    assert not any(matte) and sum(mixed) == 6 == len(mixed) / 2
    phrase = ASKED["floors"].variants["mixed"].phrase.format(**found.numbers)
    assert phrase == "training with 6 reflective floors out of 12"
    for videos in found.training.values():
        assert set(counted(videos, "material_id", "friction_id").values()) == {2}
    for name, reflecting in (("matte floors", False), ("mirroring floors", True)):
        tested = chosen(found.tests[name])
        assert {row["floor_reflectance"] > 0 for row in tested} == {reflecting}
    # A coefficient without mirrors is left out.
    dull = {"floor_reflectance": 0.0}
    rows = [row | (dull if row["friction_id"] == "f0400" else {}) for row in ROWS]
    found = planned("floors", rows)
    ids = set().union(*found.training.values(), *found.tests.values())
    assert {friction for (friction,) in counted(ids, "friction_id")} == {"f0100", "f0700"}


ONE_MATERIAL = [row for row in ROWS if row["material_id"] == "m00"]


@pytest.mark.parametrize(
    ("question", "rows", "views", "needed"),
    [
        ("diversity", manifest(replicates=2), VIEWS, "2 training replicates of every pair"),
        ("diversity", manifest(textures=1), VIEWS, "and 2 training textures are required, not 3"),
        ("floors", manifest(mirrors=()), VIEWS, "floors: 2 friction coefficients with 2 matte"),
        ("schedule", ROWS, VIEWS[:1], "schedule: 2 training viewpoints are required, not 1"),
        ("initialisation", ROWS, ["frontal"], "seen from frontal is required"),
        ("conditioning", ONE_MATERIAL, VIEWS, "2 training materials are required, not 1"),
    ],
)
def test_a_question_that_the_dataset_cannot_answer_says_what_is_needed(
    question, rows, views, needed
):
    with pytest.raises(BadInput, match=needed):
        planned(question, rows, views=views)


def test_the_network_that_is_asked_after_must_be_trained():
    assert planned("diversity", networks=["instrument"]).training
    with pytest.raises(BadInput, match=r"network lrcn, which is not in ablate\.networks"):
        planned("initialisation", networks=["instrument"])


@pytest.mark.parametrize(
    ("section", "problem"),
    [
        ({"questions": ["divers"]}, "ablate.questions.0"),
        ({"seeds": [0, 0]}, "seeds must be distinct"),
        ({"train": {"widht": 0.1}}, "ablate.train: widht"),
        ({"train": {"epochs_per_cycle": 3}}, "epochs_per_cycle is set by the ablation itself"),
        ({"instrument": {"epochs": 3}}, "epochs is set by the ablation itself"),
        ({"networks": ["lrcn", "lrcn"]}, "named twice: lrcn, lrcn"),
    ],
)
def test_settings_that_cannot_be_are_refused(section, problem):
    with pytest.raises(BadInput, match=problem):
        resolve_config({"ablate": section})


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
            predictions += [row | {"video": f"s{number}_t{texture}"} for texture in range(3)]
        one = {"question": "diversity", "network": "lrcn", "variant": name, "seed": seed}
        one |= {"phrase": phrase, "left_out": None, "dataset_digest": "d", "passes": 30.0}
        one |= {"training_videos": 12, "training_simulations": 6, "predictions": predictions}
        one |= {"failure": "the loss became nan" if failed else None}
        one |= {"stayed_at_chance": not failed and seed < at_chance}
        found.append(one | {"material_stayed_at_chance": False})
    return found


def summed(*words, **options):
    return summarise(answers(*words, **options))["questions"]["diversity"]


def test_a_planted_difference_is_found_and_said():
    (found,) = summed(0.04)["comparisons"]
    assert found["low"] < -0.04 < found["high"] < 0
    assert re.fullmatch(
        r"lrcn: the second way is better than the first way: mean error smaller by 0\.0[34]\d "
        r"\(0\.0[23]\d \.\.\. 0\.0[45]\d\), 20 simulations and 3 seeds\.",
        found["sentence"],
    )
    first, second = summed(0.04)["rows"]
    assert (first["n"], first["simulations"], first["seeds"]) == (60, 20, 3)
    assert second["mean"]["mean_absolute_error"] < first["mean"]["mean_absolute_error"]
    assert 0 < first["spread"]["mean_absolute_error"] < 0.02
    assert first["constant_error"] == pytest.approx(0.12)
    assert summed(0.04, seeds=1)["rows"][0]["spread"] is None
    found = summed(0.04, at_chance=1)
    assert [row["stayed_at_chance"] for row in found["rows"]] == [1, 1]


@pytest.mark.parametrize(
    ("gain", "options", "verdict", "said"),
    [
        (0.04, {}, "better", "is better than the first way: mean error smaller by 0.0"),
        (-0.04, {}, "worse", "is worse than the first way: mean error larger by 0.0"),
        (0.0, {}, "no significant difference", "with 20 simulations and 3 seeds: difference"),
        (0.04, {"at_chance": 1}, "better", "second way stayed at chance with 1 of 3 seeds"),
        (0.04, {"at_chance": 3}, "nothing learnt", "both stayed at chance at this budget"),
        (0.04, {"failures": 1}, "better", "20 simulations and 2 seeds; the second way diverged"),
        (0.04, {"failures": 3}, "not compared", "in no seed did both train without diverging"),
        (0.04, {"seeds": 1}, "better", "the interval does not cover other seeds"),
        (0.04, {"simulations": 1}, "not compared", "does not generalise to others"),
        (0.04, {"tested_on": "mirrors"}, "better", "lrcn, tested on mirrors: the second way is"),
    ],
)
def test_a_conclusion_says_what_it_rests_on(gain, options, verdict, said):
    (found,) = summed(gain, **options)["comparisons"]
    assert found["verdict"] == verdict and said in found["sentence"]
    assert (found["low"] is None) == (verdict == "not compared")
    if verdict == "no significant difference":
        assert found["low"] < 0 < found["high"]


def test_videos_of_one_simulation_are_not_independent():
    """Copies of every video leave the interval as it is."""
    (few,) = summed(0.01)["comparisons"]
    tripled = answers(0.01)
    for one in tripled:
        one["predictions"] *= 3
    (many,) = summarise(tripled)["questions"]["diversity"]["comparisons"]
    assert (few["low"], few["high"]) == pytest.approx((many["low"], many["high"]))


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
    asked = "Diversity: Which additional video helps more"
    for text in (found["sentence"], left_out["left_out"], asked, "Of 1 comparison, about 0.1"):
        assert text in page
    assert page.count("data:image/svg+xml") == 1
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
    assert interval(np.full((3, 5), 0.02)) == (0.02, 0.02, 0.02)
    assert interval(np.zeros((3, 1))) == (0, -math.inf, math.inf)
