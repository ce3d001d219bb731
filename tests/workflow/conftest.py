"""The workflow run in a folder of its own, from a copy of the project that tests may edit."""

import os
import shutil
from pathlib import Path

import pytest
from support import equal_results, kills
from support.workflow_copy import Workflow


@pytest.fixture(scope="module")  # another file may have made results in its own
def workflow(tmp_path_factory) -> Workflow:
    """The workflow at the default scale, nothing made yet."""
    return Workflow(tmp_path_factory.mktemp("workflow"))


@pytest.fixture(scope="session")
def chain(tmp_path_factory) -> Workflow:
    """The whole chain at smoke scale, made once for the session, or as SLIPSTITCH_CHAIN has it.

    That is the folder of a fixture of an earlier session, which is used and changed.
    """
    kept = os.environ.get("SLIPSTITCH_CHAIN")
    folder = Path(kept) if kept else tmp_path_factory.mktemp("chain")
    workflow = Workflow(folder, scale="config/smoke.yaml")
    answer = workflow.snakemake("all")
    assert answer.returncode == 0, answer.stderr[-20000:]
    if not (folder / "plan.json").exists():  # later runs, of parts, write their own over it
        shutil.copy2(workflow.folder / "results/status/plan.json", folder / "plan.json")
    return workflow


@pytest.fixture(scope="module")
def pristine(chain, tmp_path_factory):
    """The folder of the undisturbed run."""
    folder = tmp_path_factory.mktemp("pristine") / "run"
    kills.copy_run(chain.folder, folder)
    shutil.copy2(chain.folder.parent / "plan.json", folder / "results/status/plan.json")
    return folder


@pytest.fixture(scope="module")
def reference(pristine):
    return equal_results.digests(pristine / "results")


@pytest.fixture
def undisturbed(chain, pristine):
    """The chain, undisturbed again after every test."""
    kills.copy_run(pristine, chain.folder)
    yield chain
    kills.copy_run(pristine, chain.folder)
