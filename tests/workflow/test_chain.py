"""The whole chain at smoke scale: it runs, and makes again what a change concerns, nothing else."""

import contextlib
import json
import re
import shutil

import pytest

from slipstitch.base.provenance import file_digest, read_provenance
from slipstitch.config import load_config
from slipstitch.design.grid import friction_id, simulations, viewpoint_ids
from slipstitch.report.cost import read_benchmark

pytestmark = pytest.mark.slow

LEARNT = ("train", "instrument", "evaluate", "report")
STAGES = ("criticise", "calibrate", "simulate", "render", "sample", *LEARNT)
# The release is a folder, not a file below one: its audit stands for it.
AFTER_SIMULATE = {"render", "sample", "audit", *LEARNT}


@pytest.fixture(scope="module")
def results(chain):
    return chain.folder / "results"


@pytest.fixture(scope="module")
def config(results):
    return load_config(results / "config.json")


def stages(files) -> set[str]:
    return {file.split("/")[0] for file in files if "/" in file}


def test_every_artefact_says_what_made_it(results):
    there = [path for stage in STAGES for path in (results / stage).rglob("*") if path.is_file()]
    artefacts = [path for path in there if not path.name.endswith(".provenance.json")]
    assert len(artefacts) > 30
    for path in artefacts:
        assert {"inputs", "code_digest", "versions", "wall_s"} <= set(read_provenance(path)), path


def test_no_result_names_a_place_on_this_machine(chain, results):
    for path in results.rglob("*"):
        if path.suffix in (".json", ".html", ".csv"):
            text = path.read_text(encoding="utf-8")
            assert str(chain.folder.parent) not in text, path
            assert not re.search(r"/(home|root|Users)/", text), path


def test_time_and_memory_of_every_job_are_kept(results):
    for stage in STAGES:
        measured = [read_benchmark(path) for path in (results / "benchmarks" / stage).glob("*.tsv")]
        assert measured and all(one.wall_s > 0 for one in measured), stage


def test_second_run_does_nothing(chain, results):
    before = {path: path.stat().st_mtime_ns for path in results.rglob("*")}
    answer = chain.snakemake("all")
    assert answer.returncode == 0
    assert "Nothing to be done" in answer.stdout + answer.stderr
    assert {path: path.stat().st_mtime_ns for path in results.rglob("*")} == before


ALL = {"calibrate", "simulate"} | AFTER_SIMULATE
#: What is changed, a source or a setting -> the stages that are run again.
RERUN = {
    "learning/lrcn_training.py": {"train", "evaluate", "report"},
    "report/page.py": {"report"},
    "report/report.css": {"report"},
    "cli/main.py": set(),  # no result depends on it
    "images/image_shards.py": AFTER_SIMULATE,
    "learning/trainer.py": {*LEARNT},
    "physics/simulation/drop_and_drag.py": {"simulate"} | AFTER_SIMULATE,
    "design/cost.py": {"report"},  # the page reads the state of the run with it
    "report/machine_checks.py": set(),
    "render={pixels: 48}": AFTER_SIMULATE,
    "publish={name: other}": {"report"},  # it shows the whole configuration
    "sample={frames: 7}": AFTER_SIMULATE,
    "train={learning_rate: 0.5}": {"train", "evaluate", "report"},
    "simulation={damping_s: 0.003}": ALL,
    "calibrate={strip_vertices: 31}": ALL,
    "seed=2": {"simulate"} | AFTER_SIMULATE,
}


@pytest.mark.parametrize("change", RERUN)
def test_a_change_reruns_the_stages_that_use_it(chain, change):
    setting = ("--config", change) if "=" in change else ()
    with contextlib.nullcontext() if setting else chain.edited(change):
        assert stages(chain.pending(*setting)) == RERUN[change]


def test_deleted_simulation_reruns_it_and_its_descendants_only(chain, config):
    gone, *others = (one.id for one in simulations(config))
    with chain.without(f"simulate/{gone}.parquet"):
        pending = chain.pending()
    made_from_it = {f"simulate/{gone}.parquet"}
    made_from_it |= {f"render/preview/{gone}.{kind}" for kind in ("png", "mp4")}
    for view in viewpoint_ids(config.render):
        made_from_it |= {f"render/{part}{gone}_{view}.parquet" for part in ("", "shading/")}
    assert made_from_it <= pending
    # What follows is made from all simulations together.
    pending_after = pending - made_from_it - {"render/verification.json"}
    assert stages(pending_after) == AFTER_SIMULATE - {"render"}
    kept = [file for file in pending if file.startswith(("simulate/", "render/"))]
    assert not [file for file in kept if any(other in file for other in others)]
    shard = f"render/{gone}_v00.parquet"
    with chain.without(shard):
        pending = chain.pending()
    assert shard in pending and not stages(pending) & {"calibrate", "simulate"}


def test_a_deleted_picture_of_the_calibration_reruns_nothing_but_pictures(chain):
    with chain.without("calibrate/calibration.png"):
        pending = chain.pending()
    pictures = {f"calibrate/{name}.png" for name in ("calibration", "strip", "settings")}
    assert pending == pictures | {"report/index.html"}  # which shows them


@pytest.mark.parametrize(
    "override", ["render={test_textures: [chevron]}", "render={augmentation: {noise: 0.02}}"]
)
def test_another_texture_or_camera_never_starts_blender(chain, override):
    pending = chain.pending("--config", override)
    assert [file for file in pending if file.startswith("render/m")]
    assert not [file for file in pending if file.startswith("render/shading/")]


def test_viewpoints_in_another_order_are_rendered_again(chain, config):
    """Their ids are numbers of the order."""
    swapped = ", ".join(reversed(config.render.viewpoints))
    pending = chain.pending("--config", f"render={{viewpoints: [{swapped}]}}")
    shaded = {file for file in pending if file.startswith("render/shading/")}
    assert len(shaded) == len(simulations(config)) * len(config.render.viewpoints)


def test_changed_friction_reruns_its_simulations_only(chain, config):
    first, *rest = config.grid.frictions
    changed = [first, *(round(friction + 0.05, 2) for friction in rest)]
    fresh = {friction_id(friction) for friction in changed[1:]}
    pending = chain.pending("--config", f"grid={{frictions: {changed}}}")
    made = {file for file in pending if file.startswith("simulate/")}
    assert len(made) == len(simulations(config)) - len(config.grid.materials)
    assert {file.split("_")[1] for file in made} == fresh
    assert not [file for file in pending if file.startswith("render/") and "_f0100_" in file]


def test_one_more_setting_to_try_keeps_the_pushes_of_the_strip(chain):
    pending = chain.pending("--config", "calibrate={sweep_damping_s: [0.1]}")
    assert "calibrate/calibration.json" in pending
    sweeps = {file for file in pending if file.startswith("calibrate/sweep/")}
    assert sweeps == {"calibrate/sweep/damping_s.json"}


def test_one_more_replicate_keeps_the_simulations_there_are(chain, config):
    more = config.grid.replicates + 1
    pending = chain.pending("--config", f"grid={{replicates: {more}}}")
    simulated = {file for file in pending if file.startswith("simulate/")}
    assert simulated
    assert all(f"_r{more - 1:02d}" in file for file in simulated)


def test_the_release_is_protected_and_intact_and_the_report_shows_its_audit(results):
    page = (results / "report/index.html").read_text(encoding="utf-8")
    audit = json.loads((results / "audit/audit.json").read_text())
    assert audit["verdict"] == "intact", audit["findings"]
    assert audit["sums_sha256"] == file_digest(results / "release/SHA256SUMS")
    assert audit["sums_sha256"] in page and "Not run." not in page
    assert "results/criticise/block_on_other_board/index.html" in page
    assert "16 videos, 96 images" in (results / "logs/release/release.log").read_text()
    files = [path for path in (results / "release").rglob("[!.]*") if path.is_file()]
    assert files and all(path.stat().st_mode & 0o222 == 0 for path in files)


def test_audit_of_the_release_finds_nothing_and_a_clip_can_be_made_again(chain, config):
    clip = f"{simulations(config)[0].id}_t01_v01"
    for words in (("--config", "results/config.json"), ("--rebuild", clip)):
        answer = chain.run("slipstitch", "audit", "results/release", *words)
        assert answer.returncode == 0, answer.stdout + answer.stderr
    assert "the same motion, bit by bit; all 6 images have equal pixels" in answer.stdout


def test_the_anisotropy_hidden_in_shapes_of_cloth_is_named_and_simulated_again(workflow):
    """The surrogate case of the demo: its runs, simulated with the law found, are closer."""
    target = "results/criticise/surrogate_anisotropic/verdict.json"
    answer = workflow.snakemake("--quiet", "all", "--", target)
    assert answer.returncode == 0, answer.stderr[-5000:]
    folder = (workflow.folder / target).parent
    verdict, again = (
        json.loads((folder / name).read_text()) for name in ("verdict.json", "resimulation.json")
    )
    assert (verdict["verdict"], verdict["causes"]) == ("cause", ["anisotropy"])
    assert again["all"]["gain_ci95"][0] > 0.3


def fabrics_file(chain) -> str:
    path = chain.project / "src/slipstitch/config/fabrics.json"
    return path.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("vertices per side of the 20 cm square", "vertices along one side"),
        ("id in the configured grid: m05", "id of the configured grid: m05"),
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


@pytest.mark.parametrize(
    "file",
    [
        *("convergence/convergence.json", "published/convergence/convergence.json"),
        *("captures/metrics.json", "captures/predictions.parquet"),
    ],
)
def test_the_page_is_made_again_for_an_optional_file_that_it_shows(chain, file):
    path = chain.folder / "results" / file
    path.parent.mkdir(parents=True)
    path.write_text("{}", encoding="utf-8")
    try:
        assert chain.pending() == {"report/index.html"}
    finally:
        shutil.rmtree(path.parent)


def test_the_reason_names_the_changed_setting(chain):
    answer = chain.plan("-n", "--config", "train={learning_rate: 0.5}", "--", "train")
    assert "train.learning_rate: 0.5" in answer.stdout + answer.stderr
