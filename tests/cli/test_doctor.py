"""``slipstitch doctor``: finds what is missing and says how to get it."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from support.refusal import refused, run

from slipstitch.base.errors import SlipstitchError
from slipstitch.base.project import pinned_versions
from slipstitch.images.blender import ClothScene
from slipstitch.report import machine_checks as checks
from slipstitch.report.machine_checks import Diagnosis, Standing

ROOT = Path(__file__).parents[2]


def test_here_where_the_tests_run_nothing_is_missing(capsys):
    assert run("doctor") == 0
    shown = capsys.readouterr().out
    assert "MISSING" not in shown
    assert "All requirements of Slipstitch are met." in shown
    assert len(shown.splitlines()) <= 24  # one screen


def test_before_anything_is_installed_it_says_what_is_missing():
    words = [sys.executable, "-S", "-m", "slipstitch", "doctor"]  # -S: no site-packages
    env = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    answer = subprocess.run(words, capture_output=True, text=True, env=env)
    assert (answer.returncode, answer.stderr) == (1, "")
    assert "MISSING packages" in answer.stdout


def test_something_missing_is_exit_code_1_with_its_remedy_and_a_note_is_none(monkeypatch, capsys):
    note = Diagnosis("GPU", Standing.NOTE, "none")
    monkeypatch.setattr(checks, "examine", lambda: [note])
    assert run("doctor") == 0
    finding = Diagnosis("Blender", Standing.MISSING, "import bpy: no such module", "make setup")
    monkeypatch.setattr(checks, "examine", lambda: [note, finding])
    assert run("doctor") == 1
    shown = capsys.readouterr().out
    assert "MISSING Blender" in shown and "Blender: make setup" in shown


def test_absent_package_is_missing_and_other_version_is_noted(monkeypatch, tmp_path):
    file = tmp_path / "requirements.txt"
    file.write_text("# comment\nnumpy==1.0.0  # old\nno-such-package==1.0\n")
    finding = checks.check_packages(file)
    assert finding.state is Standing.MISSING
    assert "no-such-package (needs 1.0)" in finding.found
    assert "(pinned 1.0.0)" in finding.found
    file.write_text("numpy==1.0.0\n")
    assert checks.check_packages(file).state is Standing.NOTE
    # The local part of a version does not count.
    monkeypatch.setattr(checks, "installed_version", lambda package: "1.0.0+cpu")
    assert checks.check_packages(file).state is Standing.GOOD


def test_process_that_crashes_or_hangs_is_no_answer():
    assert checks._in_a_process("-c", "import os; os.abort()")[0] is False
    assert checks._in_a_process("-c", "import time; time.sleep(9)", seconds=0.3)[0] is False
    assert checks._in_a_process("-c", "print('fine')") == (True, "fine")


def test_failing_import_of_blender_and_a_missing_library_are_named(monkeypatch):
    failed = False, "ImportError: libSM.so.6: cannot open"
    monkeypatch.setattr(checks, "_in_a_process", lambda *words: failed)
    linked = "libSM.so.6 => not found\nlibc.so.6 => /lib/libc.so.6 (0x0)\n"
    answer = SimpleNamespace(stdout=linked)
    monkeypatch.setattr(checks.subprocess, "run", lambda *words, **options: answer)
    found = (checks.check_blender(), "make"), (checks.check_system_libraries(), "libsm6")
    for finding, remedy in found:
        assert finding.state is Standing.MISSING
        assert "libSM.so.6" in finding.found and remedy in finding.remedy


def test_without_blender_a_job_says_whom_to_ask(monkeypatch):
    monkeypatch.setitem(sys.modules, "bpy", None)
    with pytest.raises(SlipstitchError, match=r"^Blender cannot be loaded: .*; slipstitch doctor"):
        ClothScene(np.array([[0, 1, 2]]), np.zeros((3, 2)))


@pytest.mark.parametrize("flags", ["avx2", "avx2 avx512f avx512_bf16"])
def test_processor_says_whether_training_is_fast(tmp_path, flags):
    (tmp_path / "cpuinfo").write_text(f"processor\t: 0\nflags\t\t: fpu {flags}\n")
    finding = checks.check_processor(tmp_path / "cpuinfo")
    fast = "bf16" in flags
    assert (finding.state is Standing.GOOD, "bfloat16 training" in finding.found) == (fast, fast)


def test_full_disk_and_other_python_are_missing(monkeypatch, tmp_path):
    assert checks.check_disk(tmp_path, needed_bytes=1e30).state is Standing.MISSING
    assert checks.check_disk(tmp_path, needed_bytes=1).state is Standing.GOOD
    monkeypatch.setattr(sys, "version_info", (3, 12, 0))
    assert checks.check_python().state is Standing.MISSING


def test_requirements_are_those_of_the_lock():
    direct, more, locked = (
        pinned_versions(ROOT / f"envs/{name}")
        for name in ("requirements.txt", "development.txt", "requirements.lock")
    )
    lock = {name.lower(): version for name, version in locked.items()}
    assert len(direct) > 15
    for package, version in (direct | more).items():
        assert lock.get(package.lower()) == version, package


def test_estimate_of_a_scale(tmp_path, capsys):
    assert run(f"doctor --estimate {ROOT}/config.yaml {ROOT}/config/paper.yaml") == 0
    shown = capsys.readouterr().out
    for word in ("simulate", "render", "train", "jobs", "CPU h", "of disk"):
        assert word in shown
    (tmp_path / "bad.yaml").write_text("grid: {frictions: [-1]}\n")
    assert "grid.frictions.0" in refused(capsys, f"doctor --estimate {tmp_path}/bad.yaml")
