"""The wheel, in an empty environment and an empty folder: it brings the workflow with it."""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from support.workflow_copy import PARTS, ROOT

from slipstitch.base.project import pinned_versions
from slipstitch.config import load_config
from slipstitch.design.cost import estimate_line

pytestmark = pytest.mark.slow

# What a build reads.
SOURCES = (*PARTS, "MANIFEST.in", "README.md", "envs", "pyproject.toml", "setup.py", "workflow")


class Environment:
    """A virtual environment that holds the wheel and nothing else, and an empty folder."""

    def __init__(self, folder: Path):
        source = folder / "source"
        for part in SOURCES:
            target = source / part
            target.parent.mkdir(parents=True, exist_ok=True)
            copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy2
            copy(ROOT / part, target)
        self.python = folder / "venv/bin/python"
        pip = f"{sys.executable} -m pip --disable-pip-version-check"
        for command in (
            f"{pip} wheel --quiet --no-deps --no-build-isolation -w {folder} {source}",
            f"{sys.executable} -m venv --without-pip {folder}/venv",
            f"{pip} --python {self.python} install --quiet --no-deps {folder}/*.whl",
        ):
            subprocess.run(command, shell=True, check=True)
        self.folder = folder / "empty"
        self.folder.mkdir()

    def run(self, *module: str, folder: str = ".") -> subprocess.CompletedProcess:
        """Run Python there, without a way back to the checkout."""
        words = [self.python, "-m", *module]
        clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
        return subprocess.run(
            words, cwd=self.folder / folder, env=clean, capture_output=True, text=True
        )

    def add_dependencies(self) -> None:
        """Every package but Slipstitch, as those of the tests' own environment."""
        path = self.python.parents[1] / "lib/python3.11/site-packages/dependencies.pth"
        path.write_text(sysconfig.get_path("purelib") + "\n")


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    return Environment(tmp_path_factory.mktemp("wheel"))


def test_it_says_what_is_missing_and_lays_the_workflow_out_on_the_standard_library(environment):
    answer = environment.run("slipstitch", "doctor")
    assert (answer.returncode, answer.stderr) == (1, "")
    direct = pinned_versions(ROOT / "envs/requirements.txt")
    assert f"0 of {len(direct)} at their pinned versions; not: numpy (" in answer.stdout
    answer = environment.run("slipstitch", "init", "here")
    assert (answer.returncode, answer.stderr) == (0, "")
    for file in ("Snakefile", "config/paper.yaml", "data/cases/paper_on_paper/meta.json"):
        there = environment.folder / "here" / file
        assert there.read_bytes() == (ROOT / file).read_bytes(), file
    again = environment.run("slipstitch", "init", "here")
    problem = "error: here/Snakefile: already exists; nothing is overwritten"
    assert (again.returncode, again.stderr) == (2, f"slipstitch init: {problem}\n")


def test_the_whole_chain_is_planned_from_there(environment):
    """Runs after the one above."""
    environment.add_dependencies()
    answer = environment.run("slipstitch", "doctor")
    assert answer.returncode == 0, answer.stdout
    smoke = ("--configfile", "config/smoke.yaml")
    answer = environment.run("snakemake", "-n", "--quiet", "rules", "all", *smoke, folder="here")
    assert answer.returncode == 0, answer.stdout + answer.stderr
    config = load_config(ROOT / "config.yaml", ROOT / "config/smoke.yaml")
    assert estimate_line(config) in answer.stderr
    words = ("snakemake", "--cores", "1", "results/grid.parquet", *smoke)
    answer = environment.run(*words, folder="here")
    assert answer.returncode == 0, answer.stderr


def test_the_example_is_measured_from_there(environment):
    """Runs after the one above: video, camera and instrument come with the wheel."""
    answer = environment.run("slipstitch", "measure", "--example", "--json", "measured.json")
    assert answer.returncode == 0, answer.stdout + answer.stderr
    measured = json.loads((environment.folder / "measured.json").read_text())
    low, high = measured["interval_90"]
    assert low <= measured["friction_coefficient"] <= high
