"""What the data do not tell is marked, said and not exported."""

import json

import numpy as np
import pytest
import yaml
from support.criticised import verdict_on
from support.departures import planted

from slipstitch.cli.main import main
from slipstitch.criticise.case import read_case
from slipstitch.criticise.inference.intervals import AT_BOUND, TOO_WIDE, not_identified
from slipstitch.criticise.verdict_data import extended_model, verdict_of


@pytest.mark.parametrize(
    "name, estimate, interval, why",
    [
        ("mu_face", 0.3, [0.28, 0.32], None),
        ("mu_face", 0.44, [0.13, 1.5], TOO_WIDE),
        ("mu_edge", 3.0, [2.5, 3.5], AT_BOUND),
        ("mu_face", 6.0, [4.0, 9.0], AT_BOUND),
        ("anisotropy", 0.2, [0.1, 0.3], None),
        ("anisotropy", -0.2, [-0.3, -0.1], None),
        ("anisotropy", -0.2, [-0.35, -0.05], TOO_WIDE),
        ("anisotropy", 0.7, [0.45, 0.95], AT_BOUND),
        ("static_kinetic", 0.02, [0.01, 0.03], None),  # near no effect, which is no bound
        ("static_kinetic", 0.1, [-0.1, 0.3], TOO_WIDE),
        ("camera_scale", 1.05, [1.02, 1.08], None),
        ("camera_scale", 1.05, [1.01, 1.09], TOO_WIDE),
        ("wear_r0", 3.0, [1.5, 4.5], None),  # its null is no zero
        ("wear_r0", 3.0, [0.1, 5.9], AT_BOUND),
        ("tilt", 2.0, [0.5, 3.5], TOO_WIDE),
    ],
)
def test_a_parameter_is_known_to_a_factor_and_off_its_bounds(name, estimate, interval, why):
    found = not_identified({name: {"estimate": estimate, "ci95": interval}})
    assert found == ({name: why} if why else {})


def test_a_tilt_is_at_its_bound_with_one_of_its_components():
    entries = {
        "tilt_along": {"estimate": 19.95, "ci95": [19.0, 19.99]},
        "tilt_across": {"estimate": 0.1, "ci95": [-0.4, 0.6]},
        "tilt": {"estimate": 19.95, "ci95": [19.0, 20.9]},
    }
    assert not_identified(entries) == {"tilt": AT_BOUND}
    entries["tilt_along"] = {"estimate": 15.0, "ci95": [14.0, 16.0]}
    assert not_identified(entries) == {}  # a component may be small


def test_a_cause_that_is_hardly_known_is_named_and_marked_but_not_exported(tmp_path, capsys):
    planted(19, tmp_path, {"wear": {"wear": 0.6, "wear_r0": 45.0}}, "incline")
    model, names = tmp_path / "m.yaml", ("p.md", "p.html")
    words = ["criticise", str(tmp_path), "--out", str(tmp_path / "v.json"), "--replicates", "100"]
    for name in names:
        assert not main([*words, "--report", str(tmp_path / name), "--model", str(model)])
    said = capsys.readouterr().out
    verdict = json.loads((tmp_path / "v.json").read_text())
    assert verdict["causes"] == ["wear"]
    assert set(verdict["not_identified"]) == {"wear", "wear_r0"}
    assert set(verdict["not_exported"]) == {"wear"}
    assert "A model exported from this leaves out wear" in said
    exported = yaml.safe_load(model.read_text())
    assert (exported["causes"], set(exported["not_exported"])) == ([], {"wear"})
    law = exported["friction_law"]["face"]
    # Without its cause it is plain Coulomb friction, with the coefficient of that.
    assert law["mechanisms"] == {}
    assert law["coefficient"] == pytest.approx(np.exp(verdict["models"]["null"]["values"][0]))
    for name in names:
        page = (tmp_path / name).read_text()
        assert page.count("not identified") == 2
        assert "A model exported from this leaves out wear" in page


def test_a_tilt_that_is_known_is_exported_with_an_azimuth_within_a_turn(tmp_path):
    planted(19, tmp_path, {"tilt": {"tilt": 2.5, "tilt_azimuth": 30.0}}, "incline")
    verdict, analysis = verdict_on(tmp_path)
    assert verdict["not_exported"] == {}
    assert set(extended_model(verdict)["bench"]) == {"tilt_along_rad", "tilt_across_rad"}
    # With errors far larger than the tilt, any azimuth will do.
    analysis.chosen.fitted.covariance[:] *= 1e6
    blurred = verdict_of(read_case(tmp_path), analysis, 1, "test")
    azimuth = blurred["parameters"]["tilt_azimuth"]
    assert np.ptp(azimuth["ci95"]) == pytest.approx(360.0, abs=1e-2)
    assert set(blurred["not_exported"]) == {"tilt"}
    assert extended_model(blurred)["bench"] == {}
