"""The workflow run in a folder of its own, from a copy of the project that tests may edit."""

import os
from pathlib import Path

import pytest
from workflow_copy import Workflow


@pytest.fixture(scope="session")
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
    return workflow


def pytest_terminal_summary(terminalreporter):
    """Show what a test found worth telling, also when it ran in another process."""
    for report in terminalreporter.getreports("passed"):
        for name, value in report.user_properties:
            if report.when == "call" and name == "told":
                terminalreporter.write_line(f"{report.nodeid.split('::')[-1]}: {value}")
