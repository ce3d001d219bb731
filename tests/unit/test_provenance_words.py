"""What an edit of the project's own sources reruns: nothing if it only words, else what uses it."""

import ast
import json
import re
import shutil
from pathlib import Path

import pytest
from support.workflow_copy import source_with

from slipstitch.provenance import code_digest, code_sources
from slipstitch.provenance.code import QUOTED

ROOT = Path(__file__).parents[2]
SOURCES = ROOT / "src"
# What the rules compare.
STAGES = sorted(
    {
        stage
        for rules in (ROOT / "rules").glob("*.smk")
        for stage in re.findall(r'code_of\("([\w.]+)"\)', rules.read_text(encoding="utf-8"))
    }
)
# An audit computes again what the records and the pages of a release say.
OF_SHADING = {"render", "render.packing", "capture", "audit"}
OF_CALIBRATION = {"calibrate.sweep", "calibrate.calibration"}
OF_INTERPOLATED_FILMS = {"render", "render.packing", "sample", "capture"}
OF_CLOTH = OF_CALIBRATION | {"simulate", "capture", "criticise", "audit"}
OF_CLOTH |= {"convergence", "convergence.case_run"}
OF_EVERY_PAGE = {"ablate", "audit", "criticise", "evaluate.capture_evaluation", "release", "report"}


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sources") / "src"
    shutil.copytree(SOURCES, folder, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
    return folder


def digests(tree):
    code_digest.cache_clear()
    return {stage: code_digest(stage, tree) for stage in STAGES}


@pytest.fixture(scope="module")
def before(tree):
    return digests(tree)


@pytest.fixture
def changed(tree, before):
    """Stages whose digest another text in the place of one that is there changes."""
    files = {}

    def change(old: str, new: str) -> set[str]:
        file, content = source_with(tree, old)
        files[file] = content
        file.write_text(content.replace(old, new, 1), encoding="utf-8")
        after = digests(tree)
        return {stage for stage in STAGES if after[stage] != before[stage]}

    yield change
    for file, content in files.items():
        file.write_text(content, encoding="utf-8")


def test_the_rules_name_their_stages():
    assert {"simulate", "render", "train", "report"} <= set(STAGES)


def test_every_rule_that_runs_a_command_compares_its_code_and_says_what_it_needs_and_took():
    rules = [
        rule
        for file in (ROOT / "rules").glob("*.smk")
        for rule in re.split(r"^ *rule\b", file.read_text(encoding="utf-8"), flags=re.M)[1:]
        if "shell:" in rule
    ]
    assert len(rules) > 20
    for rule in rules:
        lacking = [
            word
            for word in ("code=code_of(", "log:", "benchmark:", "threads:", "mem_mb=", "runtime=")
            if word not in rule
        ]
        assert not lacking, rule.splitlines()[0]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("vertices per side of the 20 cm square", "vertices along one side"),
        ("41, ge=5, le=401,", "41, ge=6, le=500,"),
        (
            "    frame_rate_hz: float = Field(2.4",
            "    more: int = 1\n    frame_rate_hz: float = Field(2.4",
        ),
        ("in the configured grid, e.g. m05", "of the configured grid, e.g. m05"),
        ("{run.friction:g}: must lie between 0", "{run.friction:g}: must be between 0"),
        ("\n# The cloth hangs still for this long", "\n# For so long the cloth hangs still"),
        ('    "side": Viewpoint(', '    "new": Viewpoint(1.0, 2.0, 3.0),\n    "side": Viewpoint('),
        ('    "ceramic": Floor(', '    "new": Floor((0.1, 0.2)),\n    "ceramic": Floor('),
        ('    "chevron": 109,', '    "chevron": 109,\n    "new": 110,'),
        ('"sample: ", unit="simulation"', '"dataset: ", unit="run"'),
        ("must be left to {purpose}", "must remain to {purpose}"),
    ],
)
def test_other_words_settings_and_entries_change_no_digest(changed, old, new):
    assert changed(old, new) == set()


def test_one_more_fabric_changes_no_digest(tree, before):
    path = tree / "slipstitch/material/fabrics.json"
    text = path.read_text(encoding="utf-8")
    content = json.loads(text)
    content["fabrics"]["eleventh"] = content["fabrics"]["gray-interlock"]
    path.write_text(json.dumps(content), encoding="utf-8")
    try:
        assert digests(tree) == before
    finally:
        path.write_text(text, encoding="utf-8")


def test_a_newly_published_convergence_study_changes_no_digest(changed):
    """Else its own runs and every simulation would be made again to quote it."""
    assert changed('{\n "studied": {', '{\n "new": 1, "studied": {') == set()


def test_neither_layout_nor_comments_change_a_digest(before, tmp_path):
    for source in SOURCES.rglob("*.py"):
        bare = ast.unparse(ast.parse(source.read_text(encoding="utf-8")))
        target = tmp_path / source.relative_to(SOURCES)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(bare, encoding="utf-8")
    for file in SOURCES.rglob("*"):
        if file.is_file() and not (tmp_path / file.relative_to(SOURCES)).exists():
            (tmp_path / file.relative_to(SOURCES)).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, tmp_path / file.relative_to(SOURCES))
    assert digests(tmp_path) == before


@pytest.mark.parametrize(
    ("old", "new", "using", "others"),
    [
        ("wp.max(tangent, wp.float64(0.1) * ke[0] * viscous)", "tangent", OF_CLOTH, ...),
        ("_PLANE_STIFFNESS = 0.3", "_PLANE_STIFFNESS = 0.4", OF_SHADING, ...),
        ("& 0x7FFFFFFF", "& 0x7FFFFFFE", {"simulate", "sample"}, OF_CALIBRATION),
        ('[:8], "big"))', '[:7], "big"))', {"render", "render.packing"}, {"simulate", "train"}),
        (
            '\nFINER = ("vertices_per_side", ',
            "\nFINER = (",
            {"simulate", "calibrate.calibration", "convergence", "publish", "audit"},
            {"render", "train"},
        ),
        ('f"t{i:02d}"', 'f"t{i:03d}"', {"render"}, {"render.packing", "train", "simulate"}),
        # What the configuration computes the weights of interpolated films with.
        (
            "scale = friction * tail",
            "scale = friction + tail",
            OF_INTERPOLATED_FILMS | {"calibrate.calibration"},
            {"simulate", "train", "instrument", "evaluate.evaluation", "config.grid_table"},
        ),
        (
            "SIDE_M = 0.20",
            "SIDE_M = 0.21",
            OF_INTERPOLATED_FILMS | {"simulate"},
            {"train", "instrument", "evaluate.evaluation", "config.grid_table"},
        ),
        # In the same package, and used by none of them.
        (
            "brentq(lambda x: _shape",
            "root(lambda x: _shape",
            {"calibrate.calibration"},
            OF_INTERPOLATED_FILMS,
        ),
        # The study's own settings of a run, and its comparison, which simulates nothing again.
        (
            "step_s = chosen.time_step_s / 2**case.halvings",
            "step_s = chosen.time_step_s / 3**case.halvings",
            {"convergence.case_run", "convergence"},
            {"simulate"},
        ),
        ("SHIFT_MAX_S = 2.0", "SHIFT_MAX_S = 3.0", {"convergence"}, {"convergence.case_run"}),
        ('text = ["kind", ', 'text = ["sort", ', {"config.grid_table"}, {"sample"}),
        (
            "def load_fabric(name: str)",
            "def load_fabric(name: str = None)",
            {"simulate"},
            {"render"},
        ),
    ],
)
def test_what_computes_changes_the_stages_that_use_it(changed, old, new, using, others):
    found = changed(old, new)
    assert using <= found
    assert not found & (set(STAGES) - using if others is ... else others)


@pytest.mark.parametrize(
    ("old", "new", "using"),
    [
        # A plot, in both of its modules: else another line width simulates the grid again.
        ("ratio, theory, color=THEORY, lw=1.2", "ratio, theory, color=THEORY", {"pictures"}),
        ("*points.T, color=THEORY, lw=1.3", "*points.T, color=THEORY, lw=1.2", {"pictures"}),
        ("STEPS_OF_SHAPE = 4", "STEPS_OF_SHAPE = 5", {"sweep", "calibration"}),
        ("\nLARGEST_STRAIN = 0.345", "\nLARGEST_STRAIN = 0.344", {"sweep", "calibration"}),
        ('\nFREE = ("newton_iterations_max",)', "\nFREE = ()", {"calibration"}),
    ],
)  # fmt: skip
def test_plots_pushes_and_choice_of_the_calibration_are_made_again_apart(changed, old, new, using):
    found = changed(old, new)
    parts = {stage for stage in STAGES if stage.startswith("calibrate.")}
    assert parts == {f"calibrate.{part}" for part in ("pictures", "sweep", "calibration")}
    assert found & parts == {f"calibrate.{part}" for part in using}
    if using == {"pictures"}:
        assert found == {"calibrate.pictures", "report"}


@pytest.mark.parametrize(
    ("name", "stages"),
    [
        ("report.css", {"report"}),
        ("style.css", OF_EVERY_PAGE),
        ("captures.html.j2", {"evaluate.capture_evaluation"}),
        ("ablations.html.j2", {"ablate"}),
        ("card.md.j2", {"release", "audit"}),
    ],
)
def test_a_template_counts_for_its_page_only(name, stages):
    (path,) = SOURCES.rglob(name)
    assert {stage for stage in STAGES if path in code_sources(stage)} == stages


def test_every_table_and_template_counts_in_its_own_package_or_is_a_catalogue_or_quoted():
    others = {SOURCES / name for name in ("slipstitch/material/fabrics.json", *QUOTED)}
    assert all(path.is_file() for path in others)
    for path in SOURCES.rglob("*"):
        if path.suffix in (".json", ".j2", ".css") and path not in others:
            package = path.relative_to(SOURCES / "slipstitch").parts[0]
            assert path in code_sources(package), path
