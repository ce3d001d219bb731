"""A variant is trained at an equal budget, and fails for nothing that a comparison can say."""

import json
from itertools import product

import pytest
from support import synthetic_videos
from support.refusal import refused, run

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import read_sidecar
from slipstitch.config import write_config
from slipstitch.config.train import VARIANTS, TrainSettings
from slipstitch.learning.ablation.questions import QUESTIONS
from slipstitch.learning.ablation.run import Case, lrcn_settings, phases, run_case
from slipstitch.learning.lrcn import load_model

GRID = {"materials": ["gray-interlock", "ivory-rib-knit"], "frictions": [0.1, 0.6]}


def configuration(**ablate):
    return synthetic_videos.config(
        grid={**GRID, "replicates": 3},
        train={"fine_tuning_epochs": 1, "channels": [16, 32]},
        instrument={"pixels": 32, "channels": [8, 16], "draws": 1, "precision": "float32"},
        sample={"validation_fraction": 0.0, "test_fraction": 0.2},
        ablate={"passes": 2, "instrument_passes": 2, **ablate},
    )


CONFIG = configuration()


def passes(schedule):
    return sum(one.epochs * len(one.viewpoints) for one in schedule)


def test_joint_and_progressive_show_equally_many_videos():
    settings = TrainSettings(fine_tuning_epochs=4)
    for views, count in product((1, 2, 3, 9), (1, 7, 30)):
        names = [f"v{number}" for number in range(views)]
        progressive, joint = (phases(settings, names, count, how) for how in (False, True))
        assert passes(progressive) == passes(joint)
        assert progressive[-1] == joint[-1]
        if count == 30:
            without = passes(progressive) - (4 if views > 1 else 0)
            assert without == pytest.approx(count * views, rel=0.2)
        if views > 1:
            assert progressive[0].viewpoints == ("v0",) and joint[0].viewpoints == tuple(names)


def test_the_configuration_lists_every_variant_and_the_ablation_changes_the_training():
    assert list(VARIANTS) == list(QUESTIONS)
    for name, of_network in VARIANTS.items():
        assert set(of_network.values()) == {tuple(QUESTIONS[name].variants)}
    config = configuration(train={"width": 0.5})
    settings = lrcn_settings(config, {"initialisation": "glorot"})
    assert (settings.width, settings.initialisation) == (0.5, "glorot")
    assert settings.plateau_margin is None and settings.channels == [16, 32]


@pytest.mark.parametrize("network", ["lrcn", "instrument"])
@pytest.mark.parametrize(("variant", "simulations"), [("replicates", 8), ("textures", 4)])
def test_both_networks_train_on_as_many_videos(dataset, tmp_path, network, variant, simulations):
    found = run_case(CONFIG, dataset, Case("diversity", network, variant, 0), tmp_path)
    assert (found["training_videos"], found["training_simulations"]) == (8, simulations)
    assert len(found["predictions"]) == 4 * 2  # test simulations, textures
    for one in found["predictions"]:
        assert one["simulation"].endswith("r02")  # the last replicate is held out
        assert one["true"] in GRID["frictions"]
        assert 0 <= one["predicted"] <= 1.5


def test_conditions_are_none_predicted_and_true(dataset, tmp_path):
    cards = {}
    for name in ("none", "predicted", "true"):
        case = Case("conditioning", "lrcn", name, 0)
        found = run_case(CONFIG, dataset, case, tmp_path / name)
        assert len(found["predictions"]) == 4 * 2
        cards[name] = load_model(tmp_path / name / "friction").card
    material = load_model(tmp_path / "predicted" / "material").card
    assert cards["none"]["network"] == "friction_baseline"
    assert cards["predicted"]["condition_sha256"] == material["weights_sha256"]
    assert cards["true"]["true_materials"] and not cards["predicted"]["true_materials"]
    assert cards["true"]["condition_sha256"] is None
    assert {one["name"] for one in cards["true"]["condition_classes"]} == set(GRID["materials"])
    assert len({card["training_videos"] for card in cards.values()} | {8}) == 1
    assert len({card["epochs"] for card in cards.values()}) == 1


def test_a_run_that_stays_at_chance_or_diverges_is_a_result(dataset, tmp_path):
    case = Case("initialisation", "lrcn", "he", 0)
    stuck, wild = (
        run_case(configuration(train={"learning_rate": rate}), dataset, case, tmp_path / f"{rate}")
        for rate in (1e-9, 1e38)
    )
    assert stuck["stayed_at_chance"] and len(stuck["predictions"]) == 4 * 2
    assert "the loss became" in wild["failure"]
    assert wild["predictions"] == [] and wild["passes"] == 2


def test_a_question_without_answer_is_left_out_but_refused_when_named(dataset, tmp_path):
    case = Case("floors", "lrcn", "matte", 0)
    found = run_case(CONFIG, dataset, case, tmp_path)
    assert found["left_out"].startswith("floors: 2 friction coefficients")
    assert not found["predictions"]
    with pytest.raises(BadInput, match="floors: 2 friction coefficients"):
        run_case(configuration(questions=["floors"]), dataset, case, tmp_path)


def test_the_command_trains_sums_up_and_refuses_in_one_line(dataset, tmp_path, capsys):
    config = configuration(questions=["diversity"], networks=["instrument"], seeds=[3])
    write_config(config, tmp_path / "c.json")
    start = f"ablate --config {tmp_path}/c.json"
    one = f"{start} --dataset {dataset} --seed 3 --question"
    for variant in ("replicates", "textures"):
        out = tmp_path / "ablate" / "diversity" / f"instrument_{variant}_seed3.json"
        assert run(f"{one} diversity --network instrument --variant {variant} --out {out}") == 0
    assert "diversity seed 3: instrument textures: 8 videos of 4" in capsys.readouterr().out
    assert read_sidecar(out)["seed"] == 3

    summary, page = tmp_path / "ablate.json", tmp_path / "index.html"
    sums = f"{start} --summary {tmp_path}/ablate --out {summary}"
    assert run(f"{sums} --page {page}") == 0
    said = capsys.readouterr().out
    assert said.startswith("diversity: instrument: ") and "one replicate in 2 textures" in said
    assert json.loads(summary.read_text())["questions"]["diversity"]["rows"][0]["n"] == 8
    assert "one replicate in 2 textures" in page.read_text()

    out.rename(out.with_name("moved.json"))
    lrcn = f"{one} schedule --network lrcn --variant he --out x.json"
    for command, problem in (
        (sums, "instrument_textures_seed3.json: no such file"),
        (f"{sums} --seed 1", "--seed cannot be combined with --summary"),
        (f"{start} --out x.json", "--question, --network, --variant and --seed are required"),
        (lrcn, "no variant lrcn he"),
    ):
        assert problem in refused(capsys, command)
