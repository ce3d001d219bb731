"""Which videos train the variants of each question: as many, never a held-out simulation's."""

from collections import Counter
from itertools import product

import pytest

from slipstitch.base.errors import BadInput
from slipstitch.config import resolve_config
from slipstitch.config.train import QUESTIONS, AblateSettings
from slipstitch.dataset.videos import ROLES
from slipstitch.learning.ablation.questions import QUESTIONS as ASKED
from slipstitch.learning.ablation.questions import selected

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


def planned(question, rows=None, seed=0, views=VIEWS, **settings):
    return selected(question, rows or manifest(), views, AblateSettings(**settings), seed)[1]


def chosen(rows, ids):
    return [row for row in rows if row["video"] in ids]


@pytest.mark.parametrize("question", QUESTIONS)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_variants_train_on_equally_many_videos_and_test_on_none_of_their_simulations(
    question, seed
):
    rows = manifest()
    found = planned(question, rows, seed)
    assert len({len(videos) for videos in found.training.values()}) == 1
    tested = set().union(*found.tests.values())
    assert set(found.training) == set(ASKED[question].variants)
    for videos in found.training.values():
        trained = {row["simulation"] for row in chosen(rows, videos)}
        assert trained and not trained & {row["simulation"] for row in chosen(rows, tested)}
        of_friction = Counter(row["friction_id"] for row in chosen(rows, videos))
        assert len(of_friction) == 3 and len(set(of_friction.values())) == 1
    views = {row["viewpoint"] for row in chosen(rows, tested)}
    assert views == set(VIEWS if question == "schedule" else VIEWS[:1])


def test_diversity_is_three_replicates_in_one_texture_against_one_in_three():
    rows = manifest()
    many, one = planned("diversity", rows).training.values()
    by_simulation = Counter(row["simulation"] for row in chosen(rows, many))
    assert len(by_simulation) == 6 * 3 and set(by_simulation.values()) == {1}
    by_simulation = Counter(row["simulation"] for row in chosen(rows, one))
    assert len(by_simulation) == 6 and set(by_simulation.values()) == {3}
    # No texture is rarer in the one than in the other.
    textures = [
        Counter((row["friction_id"], row["texture_id"]) for row in chosen(rows, videos))
        for videos in (many, one)
    ]
    assert textures[0] == textures[1]


def test_with_fewer_replicates_than_textures_both_get_as_many_as_there_are_replicates():
    rows = manifest(replicates=3, textures=4)
    found = planned("diversity", rows)
    assert all(len(videos) == 6 * 2 for videos in found.training.values())
    textures = {row["texture_id"] for row in chosen(rows, found.tests["held-out"])}
    assert textures == {"t00", "t01"}  # none that has not been trained on


def test_seeds_draw_other_videos_and_the_same_seed_the_same():
    first, again, other = (
        planned("diversity", seed=seed).training["textures"] for seed in (0, 0, 1)
    )
    assert first == again != other


def test_textures_are_dealt_evenly_among_the_simulations_of_a_coefficient():
    rows = manifest()
    found = planned("initialisation", rows)
    videos = chosen(rows, found.training["he"])
    assert len(videos) == 6 * 3  # a video a training simulation
    counts = Counter((row["friction_id"], row["texture_id"]) for row in videos)
    assert set(counts.values()) == {2}


def test_the_floors_exchange_mirrors_for_matte_simulations_of_the_same_coefficient():
    rows = manifest()
    found = planned("floors", rows)
    matte, mixed = (chosen(rows, videos) for videos in found.training.values())
    assert not any(row["floor_reflectance"] for row in matte)
    assert sum(row["floor_reflectance"] > 0 for row in mixed) == 6 == len(mixed) / 2
    phrase = ASKED["floors"].variants["mixed"].phrase.format(**found.numbers)
    assert phrase == "training with 6 reflective floors out of 12"
    for part in (matte, mixed):
        assert set(Counter((r["material_id"], r["friction_id"]) for r in part).values()) == {2}
    for name, reflecting in (("matte floors", False), ("mirroring floors", True)):
        tested = chosen(rows, found.tests[name])
        assert {row["floor_reflectance"] > 0 for row in tested} == {reflecting}


def test_floors_leave_out_a_coefficient_without_mirrors():
    rows = manifest()
    for row in rows:
        if row["friction_id"] == "f0400":
            row["floor_reflectance"] = 0.0
    found = planned("floors", rows)
    ids = set().union(*found.training.values(), *found.tests.values())
    assert {row["friction_id"] for row in chosen(rows, ids)} == {"f0100", "f0700"}


@pytest.mark.parametrize(
    ("question", "rows", "views", "needed"),
    [
        ("diversity", manifest(replicates=2), VIEWS, "2 training replicates of every pair"),
        ("diversity", manifest(textures=1), VIEWS, "and 2 training textures are required, not 3"),
        ("floors", manifest(mirrors=()), VIEWS, "floors: 2 friction coefficients with 2 matte"),
        ("schedule", manifest(), VIEWS[:1], "schedule: 2 training viewpoints are required, not 1"),
        ("initialisation", manifest(), ["frontal"], "seen from frontal is required"),
        (
            "conditioning",
            [row for row in manifest() if row["material_id"] == "m00"],
            VIEWS,
            "conditioning: 2 training materials are required, not 1",
        ),
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
