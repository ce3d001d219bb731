"""The instrument that comes with Slipstitch, and the video to try it on."""

import json
import shutil
import tomllib
from pathlib import Path

import pytest
from support.refusal import refused

from slipstitch.base.provenance import file_digest
from slipstitch.cli.main import main
from slipstitch.config import load_config
from slipstitch.film.measure import EXAMPLE_FOLDER, SHIPPED
from slipstitch.learning.instrument.measuring import load_instrument

ROOT = Path(__file__).parents[2]
PUBLISHED = ROOT / "results/published/instrument"


def test_it_is_the_published_one_and_small():
    models = PUBLISHED / "models/by_simulation/instrument/ensemble"
    for name in ("instrument.safetensors", "instrument.json"):
        assert (SHIPPED / name).read_bytes() == (models / name).read_bytes(), name
    assert (SHIPPED / "config.json").read_bytes() == (PUBLISHED / "config.json").read_bytes()
    assert sum(path.stat().st_size for path in SHIPPED.iterdir()) < 4e6


def test_its_card_and_its_list_of_digests_are_of_these_files():
    names = ("config.json", "instrument.json", "instrument.safetensors")
    digests = {name: file_digest(SHIPPED / name) for name in names}
    listed = "".join(f"{digest}  {name}\n" for name, digest in digests.items())
    assert (SHIPPED / "SHA256SUMS").read_text() == listed
    card = (SHIPPED / "MODEL_CARD.md").read_text()
    assert digests["instrument.safetensors"] in card
    assert load_instrument(SHIPPED).card["dataset_digest"] in card
    packaged = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert "shipped/*" in packaged["tool"]["setuptools"]["package-data"]["slipstitch.film.measure"]


def test_an_audit_of_it_is_sent_to_the_folder_that_holds_its_chain(capsys):
    assert "results/published/instrument of the repository: audit that folder" in refused(
        capsys, ["audit", str(SHIPPED)]
    )


@pytest.mark.parametrize("name", ["config.json", "instrument.json", "instrument.safetensors"])
def test_an_altered_one_is_refused_in_one_line(name, tmp_path, capsys):
    model = shutil.copytree(SHIPPED, tmp_path / "model")
    content = (model / name).read_bytes()
    (model / name).write_bytes(content.replace(b"0", b"1", 1))
    assert f"{model / name}: altered" in refused(
        capsys, ["measure", "--example", "--model", str(model)]
    )


def test_it_is_what_its_configuration_trains():
    shipped = load_config(SHIPPED / "config.json")
    now = load_config(
        *(ROOT / name for name in ("config.yaml", "config/paper.yaml", "config/instrument.yaml"))
    )
    for section in ("seed", "grid", "simulation", "sample", "instrument"):
        assert getattr(shipped, section) == getattr(now, section), section
    card = load_instrument(SHIPPED).card
    # The tenth fabric only calibrates the error bars, so that they allow for an unseen one.
    (unseen,) = now.sample.validation_materials
    assert {*card["materials"], unseen} == set(now.grid.materials)
    assert len(now.grid.materials) == 10
    # The largest only trains, so that it is for coefficients up to 1.5.
    assert (min(card["frictions"]), max(card["frictions"])) == (0.0, 1.75)
    assert now.sample.train_only_frictions == [1.75]
    # Its own pairs that do not train, and other benches by what it read of them before.
    assert card["calibration_simulations"] == 100
    read = ROOT / "results/published/camera/drawn_fabrics.json"
    (elsewhere,) = card["calibration_readings"]
    assert elsewhere == {"digest": file_digest(read), "videos": 1200, "simulations": 50}
    assert card["split"] == "by_simulation"
    low, high = card["pose_range"]["yaw_deg"]
    assert low < -10 < 10 < high


def test_the_example_is_measured_without_any_other_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["--json", "numbers.json", "--out", "page.html"]
    assert main(["measure", "--example", *words]) == 0
    said = capsys.readouterr().out
    assert "the example is simulated, not real" in said
    known = json.loads((EXAMPLE_FOLDER / "example.json").read_text())
    told = json.loads((tmp_path / "numbers.json").read_text())
    low, high = told["interval_90"]
    assert low <= known["friction"] <= high
    # ± and interval are stretched alike: of a normal distribution they would be as 1 to 1.64.
    assert 1.2 < (high - low) / 2 / told["uncertainty"] < 2.1
    assert not told["alarm"]
    # The page says what this instrument knows: seven floors that reflect are among its floors.
    page = (tmp_path / "page.html").read_text()
    assert f"True value: <b>{known['friction']:.3f}</b>. This example was simulated" in page
    assert "° from the calibrated viewpoint<br>rotation about the vertical +2 degrees" in page
    assert "roll +0.1 degrees (trained on -2.1 ... +2.1)" in page
    config = load_config(SHIPPED / "config.json")
    assert f"floors other than {', '.join(sorted(config.render.floors))};" in page
    fabrics = load_instrument(SHIPPED).card["materials"]
    assert f"fabrics other than {', '.join(sorted(fabrics))};" in page
    assert "a reflective floor" not in page and "training viewpoint" not in page


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ([], "no video: give one, or --example"),
        (["film.mp4"], "--camera FILE is required"),
        (["--example", "film.mp4"], "--example has its own video and camera: give neither with it"),
        (["--example", "--camera", "c.json"], "--example has its own video and camera"),
    ],
)
def test_a_video_with_its_camera_or_the_example(words, problem, capsys):
    assert problem in refused(capsys, ["measure", *words])
