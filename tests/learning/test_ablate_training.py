"""A question is trained at equal budgets, goes on where it was killed, and fails for no variant."""

import json

import pytest
from support import synthetic_videos

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import read_sidecar
from slipstitch.cli.main import main
from slipstitch.config import write_config
from slipstitch.dataset.dataset import write_dataset
from slipstitch.learning.ablation import answering
from slipstitch.learning.ablation.answering import answer, lrcn_settings, phases
from slipstitch.learning.lrcn_model import LrcnModel, load_model
from slipstitch.learning.trainer import DivergedError

GRID = {"materials": ["gray-interlock", "ivory-rib-knit"], "frictions": [0.1, 0.6]}


def configuration(**ablate):
    return synthetic_videos.config(
        grid={**GRID, "replicates": 3},
        train={"fine_tuning_epochs": 1, "channels": [16, 32], "lstm_units": 32},
        instrument={"pixels": 32, "channels": [8, 16], "draws": 1, "precision": "float32"},
        sample={"validation_fraction": 0.0, "test_fraction": 0.2},
        ablate={"passes": 2, "instrument_passes": 2, **ablate},
    )


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset")
    config = configuration()
    write_dataset(
        config, synthetic_videos.write_shards(config, folder / "render"), folder / "sample"
    )
    return folder / "sample"


def passes(schedule):
    return sum(one.epochs * len(one.viewpoints) for one in schedule)


@pytest.mark.parametrize("views", [1, 2, 3, 4, 9])
@pytest.mark.parametrize("count", [1, 7, 30])
def test_joint_and_progressive_show_equally_many_videos(views, count):
    names = [f"v{number}" for number in range(views)]
    progressive, joint = (phases(names, count, 4, how) for how in (False, True))
    assert passes(progressive) == passes(joint)
    assert progressive[-1] == joint[-1]
    if count == 30:
        without = passes(progressive) - (4 if views > 1 else 0)
        assert without == pytest.approx(count * views, rel=0.2)
    if views > 1:
        assert progressive[0].viewpoints == ("v0",) and joint[0].viewpoints == tuple(names)


def test_both_networks_answer_with_as_many_videos(dataset, tmp_path):
    found = answer(configuration(), dataset, "diversity", 0, tmp_path)
    assert [(one["network"], one["variant"]) for one in found["variants"]] == [
        ("lrcn", "replicates"),
        ("lrcn", "textures"),
        ("instrument", "replicates"),
        ("instrument", "textures"),
    ]
    assert {one["training_videos"] for one in found["variants"]} == {8}
    assert [one["training_simulations"] for one in found["variants"]] == [8, 4, 8, 4]
    assert len(found["predictions"]) == 4 * 4 * 2  # variants, test simulations, textures
    for one in found["predictions"]:
        assert one["simulation"].endswith("r02")  # the last replicate is held out
        assert one["true"] in GRID["frictions"]
        assert 0 <= one["predicted"] <= 1.5


def test_conditions_are_none_predicted_and_true(dataset, tmp_path):
    found = answer(configuration(networks=["lrcn"]), dataset, "conditioning", 0, tmp_path)
    assert [one["variant"] for one in found["variants"]] == ["none", "predicted", "true"]
    cards = {
        name: load_model(tmp_path / f"lrcn_{name}" / "friction").card
        for name in ("none", "predicted", "true")
    }
    material = load_model(tmp_path / "lrcn_predicted" / "material").card
    assert cards["none"]["network"] == "friction_baseline"
    assert cards["predicted"]["condition_sha256"] == material["weights_sha256"]
    assert cards["true"]["true_materials"] and not cards["predicted"]["true_materials"]
    assert len({card["training_videos"] for card in cards.values()} | {8}) == 1
    assert len({card["epochs"] for card in cards.values()}) == 1


def test_the_true_material_is_what_the_test_videos_are_made_of(dataset, tmp_path, monkeypatch):
    told = []

    def watched(model, videos, condition=None, batch_size=8):
        told.append(condition)
        return original(model, videos, condition, batch_size)

    original = LrcnModel.probabilities
    monkeypatch.setattr(LrcnModel, "probabilities", watched)
    config = configuration(networks=["lrcn"])
    found = answer(config, dataset, "conditioning", 0, tmp_path)
    videos = sorted({one["video"] for one in found["predictions"]})
    classes = load_model(tmp_path / "lrcn_true" / "friction").card["condition_classes"]
    numbers = [[one["id"] for one in classes].index(video.split("_")[0]) for video in videos]
    assert told[0] is None and told[2].tolist() == numbers
    assert set(numbers) == {0, 1}


def test_a_run_that_stays_at_chance_or_diverges_is_a_row(dataset, tmp_path):
    stuck = configuration(networks=["lrcn"], train={"learning_rate": 1e-9})
    found = answer(stuck, dataset, "initialisation", 0, tmp_path / "stuck")
    assert [one["stayed_at_chance"] for one in found["variants"]] == [True] * 3
    assert len(found["predictions"]) == 3 * 4 * 2  # it answers all the same
    wild = configuration(networks=["lrcn"], train={"learning_rate": 1e38})
    found = answer(wild, dataset, "initialisation", 0, tmp_path / "wild")
    assert "the loss became" in found["variants"][0]["failure"]
    assert found["predictions"] == []


def test_a_finished_variant_is_not_trained_again(dataset, tmp_path, monkeypatch):
    config = configuration(networks=["lrcn"])
    trained = []

    def killed_at_the_third(settings, *words, **options):
        trained.append(settings.initialisation)
        if len(trained) == 3:
            raise KeyboardInterrupt
        return original(settings, *words, **options)

    original = answering.train_network
    monkeypatch.setattr(answering, "train_network", killed_at_the_third)
    with pytest.raises(KeyboardInterrupt):
        answer(config, dataset, "initialisation", 0, tmp_path / "killed")
    found = answer(config, dataset, "initialisation", 0, tmp_path / "killed")
    assert trained == ["he", "glorot", "pytorch", "pytorch"]
    assert found == answer(config, dataset, "initialisation", 0, tmp_path / "undisturbed")
    assert len(trained) == 4 + 3

    longer = configuration(networks=["lrcn"], passes=1)  # another budget is another training
    answer(longer, dataset, "initialisation", 0, tmp_path / "killed")
    assert len(trained) == 4 + 3 + 3


def test_divergence_is_remembered_too(dataset, tmp_path, monkeypatch):
    def diverges(*words, **options):
        calls.append(1)
        raise DivergedError("the loss became nan")

    calls = []
    monkeypatch.setattr(answering, "train_network", diverges)
    config = configuration(networks=["lrcn"])
    first = answer(config, dataset, "initialisation", 0, tmp_path)
    assert answer(config, dataset, "initialisation", 0, tmp_path) == first and len(calls) == 3


def test_what_the_ablation_changes_in_the_training():
    config = configuration(train={"dropout": 0.5})
    settings = lrcn_settings(config, {"initialisation": "glorot"})
    assert (settings.dropout, settings.initialisation) == (0.5, "glorot")
    assert settings.plateau_margin is None and settings.channels == [16, 32]


def test_a_question_without_answer_is_left_out_but_refused_when_named(dataset, tmp_path):
    found = answer(configuration(), dataset, "floors", 0, tmp_path)
    assert found["left_out"].startswith("floors: 2 friction coefficients") and not found["variants"]
    with pytest.raises(BadInput, match="floors: 2 friction coefficients"):
        answer(configuration(questions=["floors"]), dataset, "floors", 0, tmp_path)


def test_the_command_answers_sums_up_and_refuses_in_one_line(dataset, tmp_path, capsys):
    config = configuration(questions=["diversity"], networks=["instrument"], seeds=[3])
    write_config(config, tmp_path / "config.json")
    start = ["ablate", "--config", str(tmp_path / "config.json")]
    out = tmp_path / "ablate" / "diversity" / "seed3.json"
    words = ["--dataset", str(dataset), "--question", "diversity", "--seed", "3"]
    assert main([*start, *words, "--out", str(out)]) == 0
    assert "diversity seed 3: instrument textures: 8 videos of 4" in capsys.readouterr().out
    assert read_sidecar(out)["seed"] == 3

    summary, page = tmp_path / "ablate.json", tmp_path / "index.html"
    sums = [*start, "--summary", str(tmp_path / "ablate"), "--out", str(summary)]
    assert main([*sums, "--page", str(page)]) == 0
    said = capsys.readouterr().out
    assert said.startswith("diversity: instrument: ") and "one replicate in 2 textures" in said
    assert json.loads(summary.read_text())["questions"]["diversity"]["rows"][0]["n"] == 8
    assert "one replicate in 2 textures" in page.read_text()

    out.rename(out.with_name("seed4.json"))
    for words, problem in (
        (sums, "seed3.json: no such file"),
        ([*sums, "--seed", "1"], "--seed cannot be combined with --summary"),
        ([*start, "--out", "x.json"], "--dataset, --question and --seed are required"),
    ):
        assert main(words) == 2
        message = capsys.readouterr().err
        assert message.count("\n") == 1 and problem in message
