"""What the workflow would do, and what it says to a configuration that cannot be."""

import os
import re
import time
from collections.abc import Sequence

import pytest
from support.workflow_copy import Workflow

from slipstitch.config import load_config
from slipstitch.design.cost import estimate, estimate_line


def planned(workflow, target: str, *overrides: str, scale: str | None = None) -> dict[str, int]:
    """How many jobs of each rule a dry run of the target names."""
    config = ("--config", *overrides) if overrides else ()
    answer = workflow.plan("-n", "--quiet", "rules", *config, "--", target, scale=scale)
    assert answer.returncode == 0, answer.stderr
    counts = re.findall(r"^(\w+)\s+(\d+)$", answer.stdout, re.M)
    return {name: int(count) for name, count in counts}


@pytest.mark.slow
def test_paper_scale_has_the_jobs_that_its_estimate_says(workflow):
    answer = workflow.plan("-n", "--quiet", "rules", "--", "all", scale="config/paper.yaml")
    counts = planned(workflow, "all", scale="config/paper.yaml")
    per_simulation = ("simulate_one", "render_shading", "render_images", "preview_one")
    assert {counts[rule] for rule in per_simulation} == {10 * 16}
    # Of rotated cameras 20 videos each, some of one motion.
    assert 100 < counts["render_images_drawn"] == counts["render_shading_drawn"] <= 6 * 20
    config = load_config(workflow.project / "config.yaml", workflow.project / "config/paper.yaml")
    stages = {one.stage: one for one in estimate(config)}
    assert counts["total"] == sum(one.jobs for one in stages.values()) + 1  # the rule `all`
    assert counts["train_one"] == stages["train"].jobs == 2 * 3 * 3  # splits, networks, seeds
    assert answer.stderr.count(estimate_line(config)) == 1


def test_demo_scale_is_small_and_a_dry_run_writes_no_results(workflow):
    counts = planned(workflow, "all")
    assert counts["simulate_one"] == 2 * 6 * 1
    assert counts["total"] < 200
    assert not (workflow.folder / "results").exists()


ONE_PAIR = "grid={materials: [gray-interlock], frictions: [0.3], replicates: 1}"
ONE_FABRIC = "grid={materials: [gray-interlock], replicates: 2}"
BENCHES = (
    "render={viewpoints: [bench_1], interpolation: {share: 1.0}}",
    "train={splits: [by_simulation]}",
)
#: Target, overrides -> so many jobs of rules, and the rules whose jobs are not needed.
TARGETS = [
    ("calibrate", [], {}, "simulate_one"),
    ("simulate", [], {}, "render_images"),
    ("render", [], {"render_images": 12}, "sample_all"),
    ("sample", [], {"sample_all": 1}, "train_one"),
    ("train", [], {}, "instrument_one evaluate_all"),
    ("instrument", [], {"instrument_one": 1}, "evaluate_all"),
    ("evaluate", [], {"evaluate_all": 1}, "report_page"),
    ("report", [], {"report_page": 1}, ""),
    ("instrument", ["instrument={seeds: [0, 1]}"],
     {"instrument_one": 2, "instrument_ensemble": 1}, ""),
    ("release", [], {"simulate_one": 12, "sample_all": 1, "release_folder": 1},
     "train_one report_page"),
    # A job a run: thirty pairs, each with finer steps and a finer mesh.
    ("convergence", [], {"convergence_run": 10 * 3 * (1 + 1 + 1)}, "simulate_one"),
    # A job a variant and seed, and one that sums up; only the questions that are named.
    ("ablate", [], {"ablate_one": (4 + 3 + 2 + 3 + 4) * 3, "ablate_summary": 1, "sample_all": 1},
     "train_one instrument_one evaluate_all report_page"),
    ("ablate", ["ablate={questions: [diversity, floors], seeds: [4]}"],
     {"ablate_one": (4 + 4) * 1}, ""),
    ("simulate", ["grid={frictions: [0.2, 4e-1], replicates: 1}"], {"simulate_one": 2 * 2 * 1}, ""),
    # Four pairs, five films each; then their references, their dataset, and the networks.
    ("captures", [], {"surrogate_film": 4 * 5, "surrogate_bench": 1, "captures_reference": 1,
                      "captures_ingest": 1, "captures_evaluate": 1}, "report_page evaluate_all"),
    ("criticise", [], {"criticise_one": 4, "total": 5}, "simulate_one"),
    # A single pair can be simulated and filmed.
    ("simulate", [ONE_PAIR, *BENCHES], {"simulate_one": 1}, ""),
    ("render", [ONE_PAIR], {"simulate_one": 1}, ""),
    # What no network can learn may still be a dataset or an instrument.
    ("sample", ["grid={frictions: [0.5, 2.0]}"], {"sample_all": 1}, ""),
    ("instrument", [ONE_FABRIC], {"instrument_one": 1}, ""),
]  # fmt: skip


@pytest.mark.parametrize(("target", "overrides", "jobs", "absent"), TARGETS)
def test_a_target_has_its_jobs_and_no_others(workflow, target, overrides, jobs, absent):
    counts = planned(workflow, target, *overrides)
    assert {rule: counts.get(rule) for rule in jobs} == jobs
    assert counts and not {*absent.split()} & set(counts)


# What the instrument takes from elsewhere: settings, their key, the file, the rule that takes it.
TAKEN = [
    ("seeds: [0, 1], calibration_datasets: [{}]", "calibration_datasets", "manifest.parquet",
     "instrument_ensemble"),
    ("starts_from: {}", "starts_from", "instrument.safetensors", "instrument_one"),
]  # fmt: skip


@pytest.mark.parametrize(("settings", "key", "file", "rule"), TAKEN)
def test_what_an_instrument_takes_from_elsewhere_is_there_before(
    workflow, tmp_path, settings, key, file, rule
):
    override = f"instrument={{{settings.format(tmp_path)}}}"
    answer = workflow.plan("-n", "--config", override, "--", "instrument")
    assert answer.returncode == 2
    assert f"instrument.{key}: {tmp_path}: no {file}" in answer.stderr
    (tmp_path / file).touch()
    assert planned(workflow, "instrument", override)[rule] == 1


REPLICATE = ["grid={replicates: 1}", "sample={hold_out: replicate}"]
# Target, overrides, and what is wrong with these.
REFUSED = [
    ("all", ["grid={frictions: [-0.1]}"], "grid.frictions.0: must be at least 0, not -0.1"),
    ("all", ["seed=soon"], "seed: must be a whole number, not 'soon'"),
    ("sample", [ONE_PAIR], "nothing to hold out in 1 material(s) with one replicate each"),
    ("release", REPLICATE, "grid.replicates must be at least 2"),
    ("render", [ONE_PAIR, *BENCHES], "nothing to hold out in 1 material(s)"),
    ("all", [ONE_FABRIC], "grid.materials: has 1; the material"),
    ("all", ["grid={frictions: [0.5, 2.0]}"], "grid.frictions: 2 is above what the instrument"),
    ("criticise", ["criticise={cases: [gone]}"], "criticise.cases: gone: no such folder"),
]


@pytest.mark.parametrize(("target", "overrides", "problem"), REFUSED)
def test_what_cannot_be_made_is_refused_in_one_line_before_anything_runs(
    workflow, target, overrides, problem
):
    answer = workflow.plan("-n", "--config", *overrides, "--", target)
    assert answer.returncode == 2
    (said,) = (line for line in answer.stderr.splitlines() if "error" in line.lower())
    assert said.startswith("snakemake: error: ") and problem in said
    assert "Traceback" not in answer.stdout + answer.stderr


def test_a_case_is_looked_for_in_the_working_folder_first(workflow):
    (workflow.folder / "mine" / "linen").mkdir(parents=True)
    overrides = ("--config", "criticise={cases: [mine/linen, data/cases/paper_on_paper]}")
    answer = workflow.plan("-n", "--printshellcmds", *overrides, "--", "criticise")
    assert answer.returncode == 0, answer.stderr
    assert "slipstitch criticise mine/linen " in answer.stdout
    shipped = workflow.project / "data/cases/paper_on_paper"
    assert f"slipstitch criticise {shipped} " in answer.stdout


def test_real_captures_need_no_surrogates(workflow):
    table = workflow.folder / "bench" / "captures.csv"
    table.parent.mkdir(exist_ok=True)
    table.write_text("")
    counts = planned(workflow, "captures", f"captures={{table: {table}}}")
    assert counts["captures_ingest"] == 1
    assert not {"surrogate_film", "surrogate_bench", "captures_reference"} & set(counts)


def made_again(workflow, changed: str, overrides: list[str], outputs: Sequence[str]) -> bool:
    """Whether a file that is newer than the outputs, all there, has them made again."""
    others = [path for path in workflow.folder.rglob("*") if path.is_file()]
    for age_s, paths in ((200, others), (100, map(workflow.folder.joinpath, outputs))):
        for path in paths:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
            os.utime(path, (time.time() - age_s,) * 2)
    words = ("-n", "--rerun-triggers", "mtime", "--config", *overrides, "--", *outputs)
    assert "Nothing to be done" in workflow.plan(*words).stdout
    (workflow.folder / changed).touch()
    answer = workflow.plan(*words)
    assert answer.returncode == 0, answer.stderr
    return "Nothing to be done" not in answer.stdout


DATASET = ("results/captures/dataset/manifest.parquet", "results/captures/dataset/captures.parquet")


@pytest.mark.parametrize("changed", ["a.mp4", "b.json"])
def test_a_replaced_video_or_camera_file_of_a_bench_is_ingested_again(tmp_path, changed):
    workflow = Workflow(tmp_path)
    bench = workflow.folder / "bench"
    bench.mkdir()
    for name in ("a.mp4", "b.mp4", "a.json", "b.json"):
        (bench / name).write_text(name)
    rows = ["video,camera", "a.mp4,a.json", "b.mp4,b.json", "gone.mp4,a.json"]
    (bench / "captures.csv").write_text("\n".join(rows))
    overrides = ["captures={table: bench/captures.csv}"]
    assert made_again(workflow, f"bench/{changed}", overrides, DATASET)


BENCH = [f"results/captures/bench/{name}" for name in ("camera.json", "captures.csv")]


@pytest.mark.default_cases(1)
@pytest.mark.parametrize(
    ("table", "outputs"),
    [
        ("captures.csv", DATASET),
        ("null", [*BENCH, "results/captures/bench/slip_angles.csv"]),
        ("null", ["results/captures/bench/c00_r01.mp4"]),
    ],
    ids=["ingest", "surrogate bench", "surrogate film"],
)
def test_captures_follow_the_content_of_the_calibrated_camera(tmp_path, table, outputs):
    workflow = Workflow(tmp_path)
    for name in ("mine.json", "captures.csv"):
        (workflow.folder / name).write_text("")
    overrides = [f"captures={{table: {table}}}", "render={camera: mine.json}"]
    assert made_again(workflow, "mine.json", overrides, outputs)


def test_the_linter_says_nothing_that_is_not_answered(workflow):
    """docs/develop.md has the answers."""
    answer = workflow.plan("--lint", "text")
    complaints = re.findall(r"^    \* (.*?)[:.]?$", answer.stdout + answer.stderr, re.M)
    answered = (
        "Specify a conda environment or container for each rule",
        "Mixed rules and functions in same snakefile",
        'Environment variable PATH"]',
        "Environment variable SLIPSTITCH_CPU_TIME used",
    )
    assert complaints and not [one for one in complaints if not one.startswith(answered)]
