"""What an edit of the sources makes again in a finished run: nothing that it leaves as it was."""

import json

import pytest

pytestmark = pytest.mark.slow


def fabrics_file(chain) -> str:
    path = chain.project / "src/slipstitch/config/fabrics.json"
    return path.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("vertices per side of the 20 cm square", "vertices along one side"),
        ("in the configured grid, e.g. m05", "of the configured grid, e.g. m05"),
        ('    "side": Viewpoint(', '    "new": Viewpoint(1.0, 2.0, 3.0),\n    "side": Viewpoint('),
        ('    "ceramic": Floor(', '    "new": Floor((0.1, 0.2)),\n    "ceramic": Floor('),
    ],
)
def test_words_and_further_entries_leave_a_finished_run_as_it_is(chain, old, new):
    with chain.reworded(old, new):
        assert chain.pending(reloaded=True) == set()


def test_an_eleventh_fabric_simulates_nothing_again(chain):
    before = fabrics_file(chain)
    content = json.loads(before)
    content["fabrics"]["eleventh"] = content["fabrics"]["royal-target"]
    with chain.reworded(before, json.dumps(content)):
        assert chain.pending(reloaded=True) == set()


def test_another_fabric_reruns_its_own_simulations_and_what_is_made_from_them(chain):
    fabrics = json.loads(fabrics_file(chain))["fabrics"]
    density = f'"areal_density_kg_m2": {fabrics["gray-interlock"]["areal_density_kg_m2"]}'
    with chain.reworded(density, '"areal_density_kg_m2": 0.2'):
        pending = chain.pending(reloaded=True)
    made = {file for file in pending if file.startswith(("calibrate/", "simulate/", "render/m"))}
    assert {file.split("/")[0] for file in made} == {"simulate", "render"}
    assert {file.split("/")[1][:3] for file in made} == {"m05"}


def test_another_number_of_a_formula_reruns_the_stages_that_use_it(chain):
    with chain.reworded("wp.max(tangent, wp.float64(0.1) * ke[0] * viscous)", "tangent"):
        pending = chain.pending()
    assert {"calibrate/calibration.json", "report/index.html"} <= pending
    assert [file for file in pending if file.startswith("simulate/")]


def test_a_page_alone_is_written_again_with_its_template(chain):
    with chain.edited("report/report.css", "\nbody { margin: 0 }\n"):
        assert chain.pending() == {"report/index.html"}


@pytest.mark.parametrize(
    "file",
    [
        "convergence/convergence.json",
        "published/convergence/convergence.json",
        "captures/metrics.json",
        "captures/predictions.parquet",
    ],
)
def test_the_page_is_made_again_for_an_optional_file_that_it_shows(chain, file):
    path = chain.folder / "results" / file
    path.parent.mkdir(parents=True)
    path.write_text("{}", encoding="utf-8")
    try:
        assert chain.pending() == {"report/index.html"}
    finally:
        path.unlink()
        path.parent.rmdir()


def test_the_reason_names_the_changed_setting(chain):
    answer = chain.plan("-n", "--config", "train={learning_rate: 0.5}", "--", "train")
    assert answer.returncode == 0, answer.stderr
    assert "train.learning_rate: 0.5" in answer.stdout + answer.stderr
