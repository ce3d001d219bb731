"""``slipstitch protocol``: pass or fail, in the words of the command line."""

import json

import pytest

from slipstitch.cli import calibrate
from slipstitch.cli.main import main
from slipstitch.physics.experiments.registry import PROTOCOLS


def test_every_experiment_is_listed_and_has_demands():
    assert set(calibrate.NAMES) == set(PROTOCOLS)


@pytest.mark.parametrize(
    ("name", "measured", "theory", "passed"),
    [
        ("capstan", {"tension_ratio": 1.51}, [1.5], True),
        ("capstan", {"tension_ratio": 1.54}, [1.5], False),
        ("incline", {"acceleration_m_s2": 1e-9}, [0.0], True),
        ("incline", {"acceleration_m_s2": 1e-2}, [0.0], False),
        ("strip", {"regime": "slipped", "slip_strain": 0.101}, ["slipped", 0.0969], True),
        ("strip", {"regime": "slipped", "slip_strain": 0.104}, ["slipped", 0.0969], False),
        ("strip", {"regime": None, "slip_strain": None}, ["slipped", 0.0969], False),
    ],
)
def test_a_result_meets_its_demands_or_does_not(name, measured, theory, passed):
    expected = {f"theory_{key}": value for key, value in zip(measured, theory, strict=True)}
    judged = PROTOCOLS[name].verdict(measured | expected)
    assert judged["passed"] is passed
    json.dumps(judged, allow_nan=False)


def test_pass_and_fail_are_said_and_are_the_exit_code(monkeypatch, tmp_path, capsys):
    out = tmp_path / "x.json"
    words = ["protocol", "incline", "--friction", "0.3", "--slope-deg", "20", "--out", str(out)]
    assert main(words) == 0
    said = capsys.readouterr()
    assert "passed: acceleration_m_s2 differs from theory by " in said.err
    result = json.loads(out.read_text())
    assert result["passed"] is True
    assert json.loads(said.out) == result
    wrong = {"acceleration_m_s2": 9.0, "theory_acceleration_m_s2": 1.0}
    monkeypatch.setattr("slipstitch.physics.experiments.registry.run_protocol", lambda *_: wrong)
    assert main(words) == 1
    assert "FAILED: acceleration_m_s2 differs from theory by 8e+02 %, allowed 1 %" in (
        capsys.readouterr().err
    )


def test_messages_name_the_options_as_they_are_given(tmp_path, capsys):
    words = ["protocol", "incline", "--friction", "0.3", "--out", str(tmp_path / "x.json")]
    assert main(words) == 2
    assert capsys.readouterr().err == (
        "slipstitch protocol: error: protocol incline: --slope-deg is missing\n"
    )
